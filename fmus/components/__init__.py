"""Physics of single parts: no numbers, no FMI, no files."""
