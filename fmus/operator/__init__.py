"""The levers: a program of lever strokes."""

from fmus.operator.model import LEVERS

__all__ = ["LEVERS"]
