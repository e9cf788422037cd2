"""How a system is coupled: which master, how it extrapolates and repeats, how long its steps are."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from orchestrator.errors import Problem

MASTERS = ("jacobi", "gauss-seidel", "hermite")
ORDERS = {"jacobi": 0, "gauss-seidel": 0, "hermite": 3}  # of extrapolation, where the user says nothing

CONTROLS = ("error", "energy")
MISS = 1e-4  # tolerance of the passes of hermite, where the user says nothing
OF_STEP = 0.3  # of the tolerance of an adaptive step: tolerance of its passes


@dataclass(frozen=True)
class Coupling:
    """All choices about the coupling of a run.

    master      one of MASTERS
    order       at which sources are continued over a step: 0, 1, 2 or 3; default: that of ORDERS
    passes      hermite: how often a step is computed at most
    tolerance   hermite: a step is computed again while value or slope (times the step) of a signal ends
                further from its source, as a share of its magnitude: the nominal value, or the largest seen
    correct     inputs get back what their continuation lost over the step before
    factors     component -> how many steps of its own it takes in one communication step
    adaptive    None: all steps are as long as the user says; else the tolerance of their estimated error, as
                a share of the magnitude of each signal
    control     what the tolerance is of: "error" of the signals, or "energy" of the power bonds
    smallest    step [s] of adaptive runs; at it errors above the tolerance are let pass
    largest     step [s] of adaptive runs
    """

    master: str = "gauss-seidel"
    order: int | None = None
    passes: int = 8
    tolerance: float | None = None
    correct: bool = False
    factors: Mapping[str, int] = field(default_factory=dict)
    adaptive: float | None = None
    control: str = "error"
    smallest: float = 1e-7
    largest: float = 0.1

    def __post_init__(self) -> None:
        if self.master not in MASTERS:
            raise Problem(f"unknown master {self.master!r}, expected one of {', '.join(MASTERS)}")
        if self.order not in (None, 0, 1, 2, 3):
            raise Problem(f"order of extrapolation: expected 0, 1, 2 or 3, got {self.order}")
        if self.passes < 1:
            raise Problem(f"passes: expected at least 1, got {self.passes}")
        for name, value in (("coupling tolerance", self.tolerance), ("adaptive", self.adaptive)):
            if value is not None and not value > 0:
                raise Problem(f"{name}: expected a positive number, got {value:g}")
        if self.control not in CONTROLS:
            raise Problem(f"unknown control {self.control!r}, expected one of {', '.join(CONTROLS)}")
        if not 0 < self.smallest <= self.largest:
            raise Problem(
                f"smallest and largest step: expected 0 < smallest <= largest, got {self.smallest:g} s and"
                f" {self.largest:g} s"
            )
        for name, factor in self.factors.items():
            if factor < 1:
                raise Problem(f"factor of {name}: expected at least 1 step, got {factor}")

    @property
    def extrapolation(self) -> int:
        """The order of extrapolation."""
        return ORDERS[self.master] if self.order is None else self.order

    @property
    def miss(self) -> float:
        """The tolerance of the passes."""
        if self.tolerance is not None:
            return self.tolerance
        return MISS if self.adaptive is None else OF_STEP * self.adaptive

    @property
    def text(self) -> str:
        """The master, with what differs from its usual settings."""
        more = [] if self.order is None else [f"of order {self.order}"]
        more += ["with correction"] if self.correct else []
        return " ".join([self.master, *more])
