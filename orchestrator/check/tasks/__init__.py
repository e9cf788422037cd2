"""Tasks that load and run the FMU in a child process; each task yields findings as (severity, text)."""
