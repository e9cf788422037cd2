"""The levers: a program of lever strokes."""

from fmus.levers.model import LEVERS

__all__ = ["LEVERS"]
