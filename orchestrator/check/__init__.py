"""harvester check: what is wrong with an FMU, and which tool will refuse it."""
