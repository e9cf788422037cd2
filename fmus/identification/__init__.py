"""Identification: recordings of a test rig or a machine become parameters with error bars."""
