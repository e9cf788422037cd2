"""The operator: plays a program of lever strokes."""

from fmus.operator_input.model import OPERATOR

__all__ = ["OPERATOR"]
