"""Mechanics of the manipulator: swing column, boom, stick and processing head."""

from fmus.manipulator.model import MANIPULATOR

__all__ = ["MANIPULATOR"]
