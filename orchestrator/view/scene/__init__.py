"""The drawing of the machine: geometry, pose, bodies and colours; `canvas` sends them to the browser."""
