"""What an FMU declares, as far as running it needs."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

FLOATS = ("Real", "Float64", "Float32")
WHOLE = ("Integer", "Enumeration", *(f"{u}Int{n}" for u in ("", "U") for n in (8, 16, 32, 64)))
NUMBERS = (*FLOATS, *WHOLE, "Boolean")


@dataclass(frozen=True)
class Variable:
    """One variable.

    size    number of its scalars
    state   name of the state that it is the derivative of
    """

    name: str
    kind: str
    reference: int
    causality: str = "local"
    variability: str = "continuous"
    initial: str = ""
    start: tuple[float, ...] = ()
    low: float = -math.inf
    high: float = math.inf
    nominal: float = 1.0
    size: int = 1
    state: str = ""

    @property
    def is_float(self) -> bool:
        return self.kind in FLOATS

    @property
    def scale(self) -> float:
        """A typical magnitude."""
        return max([abs(s) for s in self.start if math.isfinite(s)] + [self.nominal])


@dataclass(frozen=True)
class Declared:
    """One FMU.

    sides          "cs", "me" -> attributes of the element CoSimulation, ModelExchange
    derivatives    names of the derivatives of the continuous states, in the order of the state vector
    dependencies   output or derivative -> what it depends on; None when the FMU does not say
    """

    major: int
    token: str
    sides: Mapping[str, Mapping[str, str]]
    variables: Mapping[str, Variable]
    derivatives: tuple[str, ...] = ()
    dependencies: Mapping[str, frozenset[str] | None] = field(default_factory=dict)
    indicators: int = 0
    categories: tuple[str, ...] = ()
    experiment: Mapping[str, float] = field(default_factory=dict)

    def of(self, *causalities: str) -> list[Variable]:
        """Numeric variables of these causalities."""
        return [v for v in self.variables.values() if v.causality in causalities and v.kind in NUMBERS]

    def can(self, side: str, *names: str) -> bool:
        """True when this side has one of these attributes set; the versions spell them in two ways."""
        return any(self.sides[side].get(name) in ("true", "1") for name in names)

    @property
    def step(self) -> float:
        """Communication step [s]: as declared, else a 500th of the default experiment, else 10 ms."""
        start, stop = self.experiment.get("startTime", 0.0), self.experiment.get("stopTime", math.nan)
        length = (stop - start) / 500 if stop > start else 1e-2
        return self.experiment.get("stepSize", 0.0) or self.inner_step or length

    @property
    def inner_step(self) -> float:
        """The fixed step [s] inside, by which the FMU's time may be late; 0 when unknown."""
        return float(self.sides.get("cs", {}).get("fixedInternalStepSize", 0.0))

    @property
    def states(self) -> list[str]:
        """Names of the continuous states."""
        return [self.variables[d].state for d in self.derivatives if d in self.variables]
