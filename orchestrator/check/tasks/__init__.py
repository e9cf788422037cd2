"""Tasks that load and run the FMU in a child process; each task yields findings as (severity, text).

They need only the standard library, so a child process starts within a tenth of a second.
"""
