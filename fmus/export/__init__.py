"""Export of a `Subsystem` as an FMU: FMI 2.0 and 3.0 in C. A user's `Model` in Python: `python.build`."""
