"""Operator input: a program of lever strokes over time. `OPERATOR` is the subsystem, without variants."""

from fmus.operator_input.model import OPERATOR

__all__ = ["OPERATOR"]
