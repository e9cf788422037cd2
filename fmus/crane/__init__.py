"""Cranes from files: description, check, manipulator, and the machine with drives, supply and operator."""
