"""A machine that runs in real time in a separate process, and takes commands while it runs."""
