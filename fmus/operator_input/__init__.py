"""Operator input: a program of lever strokes over time."""

from fmus.operator_input.model import OPERATOR

__all__ = ["OPERATOR"]
