"""Validation and comparison of results: metrics, reports, figures."""
