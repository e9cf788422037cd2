"""Cranes from files: description, check, manipulator, and the machine with its drives, supply and operator."""
