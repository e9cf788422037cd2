"""Hydraulics of the boom and stick cylinders."""

from fmus.boom_stick.model import BOOM_STICK

__all__ = ["BOOM_STICK"]
