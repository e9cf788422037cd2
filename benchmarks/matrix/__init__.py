"""Every FMU and SSP in every tool that is present: what ran, how near it came, how long it took."""
