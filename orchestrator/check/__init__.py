"""`harvester check`: finds faults of an FMU, and tools that cannot use it."""
