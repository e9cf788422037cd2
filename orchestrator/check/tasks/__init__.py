"""What the probes do, in the child process: each task yields findings as (severity, text).

Needs the standard library only and so starts within a tenth of a second; a check starts some forty processes.
"""
