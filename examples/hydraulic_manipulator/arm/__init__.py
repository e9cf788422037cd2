"""Mechanics of the benchmark: a planar arm of two links."""

from arm.model import ARM

__all__ = ["ARM"]
