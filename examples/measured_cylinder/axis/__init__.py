"""The axis: servo valve, lines, cylinder and a mass."""

from axis.model import AXIS

__all__ = ["AXIS"]
