"""Export of a `Subsystem` as an FMU: FMI 2.0 and 3.0 in C (`build`), FMI 2.0 in Python (`python.build`)."""
