"""Hydraulics of the benchmark: a pump at constant pressure, a valve and a symmetrical cylinder."""

from hydraulics.model import HYDRAULICS

__all__ = ["HYDRAULICS"]
