"""Any `Subsystem` as an .fmu file (build.py: FMI 2.0, native), connected .fmu files as an .ssp (ssp.py)."""
