"""Physics of single parts: no FMI, no files, no number of a machine.

The few constants here shape a smooth stand-in (rounding, the cavity); each says so where it stands.
"""
