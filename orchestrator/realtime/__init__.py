"""A machine that runs in real time in a process of its own, driven while it runs."""
