"""The operator: plays a program of lever strokes."""

from fmus.operator.model import OPERATOR

__all__ = ["OPERATOR"]
