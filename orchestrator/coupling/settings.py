"""How a system is coupled: which master, how it extrapolates and repeats, how long its steps are."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from orchestrator.errors import Problem

MASTERS = ("jacobi", "gauss-seidel", "hermite")
ORDERS = {"jacobi": 0, "gauss-seidel": 0, "hermite": 2}  # of extrapolation, where the user says nothing


@dataclass(frozen=True)
class Coupling:
    """All choices about the coupling of a run.

    master      one of MASTERS
    order       of extrapolation of inputs over a step: 0, 1 or 2; default: that of ORDERS
    passes      hermite: how often a step is computed at most
    tolerance   hermite: a step is computed again while that changes a signal by more, as a share of its
                nominal value or of the largest seen
    factors     component -> how many steps of its own it takes in one communication step
    """

    master: str = "gauss-seidel"
    order: int | None = None
    passes: int = 4
    tolerance: float = 1e-6
    factors: Mapping[str, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.master not in MASTERS:
            raise Problem(f"unknown master {self.master!r}, expected one of {', '.join(MASTERS)}")
        if self.order not in (None, 0, 1, 2):
            raise Problem(f"order of extrapolation: expected 0, 1 or 2, got {self.order}")
        if self.passes < 1:
            raise Problem(f"passes: expected at least 1, got {self.passes}")
        if not self.tolerance > 0:
            raise Problem(f"coupling tolerance: expected a positive number, got {self.tolerance:g}")
        for name, factor in self.factors.items():
            if factor < 1:
                raise Problem(f"factor of {name}: expected at least 1 step, got {factor}")

    @property
    def extrapolation(self) -> int:
        """The order of extrapolation."""
        return ORDERS[self.master] if self.order is None else self.order

    @property
    def text(self) -> str:
        """The master, with what differs from its usual settings."""
        return self.master if self.order is None else f"{self.master} of order {self.order}"
