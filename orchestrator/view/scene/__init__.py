"""The drawing of the machine in the page of `view`: `canvas` sends it to the browser."""
