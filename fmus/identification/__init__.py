"""Identification: parameters with confidence intervals from recordings of a test bench or a machine."""
