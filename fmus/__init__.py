"""The harvester's equations, and how they become .fmu files."""
