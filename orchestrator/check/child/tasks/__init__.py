"""What the probes do, in the child process: each task yields (severity, text)."""
