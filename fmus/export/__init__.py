"""Any `Subsystem` as an .fmu file: `build` for FMI 2.0 and 3.0 in C, `python` for FMI 2.0 in Python."""
