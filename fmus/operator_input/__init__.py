"""Operator input: a program of lever strokes over time. `OPERATOR` is the subsystem, without variants."""

from fmus.operator_input.work_cycle import OPERATOR

__all__ = ["OPERATOR"]
