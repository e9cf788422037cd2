"""Validation and comparison of results: references, metrics, reports."""
