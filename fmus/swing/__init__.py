"""Hydraulics of the swing motor."""

from fmus.swing.model import SWING

__all__ = ["SWING"]
