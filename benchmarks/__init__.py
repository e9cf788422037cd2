"""Measurements that are repeated by hand, never in a timed test."""
