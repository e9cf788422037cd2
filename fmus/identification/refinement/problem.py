"""An estimation problem: a subsystem, its free parameters with priors and bounds, and measured runs."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fmus.contract import Subsystem, quantities
from fmus.identification.refinement.measured_runs import MeasuredRun
from fmus.parameters import Values
from fmus.parameters import values as default_values
from orchestrator.base.errors import Problem
from orchestrator.data.table import Array


@dataclass(frozen=True)
class FreeParameter:
    """A parameter to be estimated; z is the variable of the search.

        value = exp(z)      if the parameter is positive (`log`): a change of z is a relative change
        value = scale z     otherwise

    value      initial value, mean of the prior
    sd         prior standard deviation of the value, None without a prior
    low, high  bounds of the value
    """

    name: str
    value: float
    unit: str = "1"
    sd: float | None = None
    low: float = -math.inf
    high: float = math.inf
    log: bool = False
    scale: float = 1.0

    def z_of(self, value: float) -> float:
        """z of a value; minus infinity for zero if z is logarithmic."""
        if not self.log:
            return value / self.scale
        return math.log(value) if value > 0 else -math.inf

    def value_of(self, z: float) -> float:
        """The value of z."""
        return math.exp(z) if self.log else self.scale * z

    def derivative(self, z: float) -> float:
        """d value / dz."""
        return math.exp(z) if self.log else self.scale

    @property
    def z_sd(self) -> float:
        """Prior standard deviation of z, infinite without a prior."""
        return math.inf if self.sd is None else self.sd / self.derivative(self.z_of(self.value))


@dataclass(frozen=True)
class EstimationProblem:
    """A subsystem, its free parameters, the runs to fit and the runs held out.

    fixed   values of the other parameters, inputs and states; None: those of the subsystem's file
    """

    sub: Subsystem
    outputs: tuple[str, ...]
    free: tuple[FreeParameter, ...]
    training: tuple[MeasuredRun, ...]
    held_out: tuple[MeasuredRun, ...] = ()
    fixed: Values | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the free parameters."""
        return tuple(f.name for f in self.free)

    def initial(self) -> Array:
        """z of the initial values, shape (np,)."""
        return np.array([f.z_of(f.value) for f in self.free])

    def bounds(self) -> tuple[Array, Array]:
        """Lower and upper bounds of z, each of shape (np,)."""
        return (
            np.array([f.z_of(f.low) if math.isfinite(f.low) else -math.inf for f in self.free]),
            np.array([f.z_of(f.high) if math.isfinite(f.high) else math.inf for f in self.free]),
        )

    def values_of(self, z: Array) -> Array:
        """Parameter values of z, shape (np,)."""
        return np.array([f.value_of(float(v)) for f, v in zip(self.free, z, strict=True)])

    def derivatives(self, z: Array) -> Array:
        """d value / dz, shape (np,)."""
        return np.array([f.derivative(float(v)) for f, v in zip(self.free, z, strict=True)])

    def by_name(self, z: Array) -> dict[str, float]:
        """Parameter values of z by name."""
        return dict(zip(self.names, self.values_of(z).tolist(), strict=True))


def free_parameters(
    sub: Subsystem,
    names: Sequence[str],
    priors: Mapping[str, tuple[float, float | None]] | None = None,
    values: Values | None = None,
) -> tuple[FreeParameter, ...]:
    """Free parameters with the bounds that the subsystem declares.

    priors   initial value and prior standard deviation, None for an initial value without a prior
    values   initial values of the others, by default those of the subsystem's file
    """
    declared, initial, priors = quantities(sub.parameters), (values or default_values(sub)).p, priors or {}
    unknown = [n for n in (*names, *priors) if n not in declared]
    if unknown:
        raise Problem(f"{sub.name}: {unknown[0]} is not a parameter; expected one of {', '.join(declared)}")
    free = []
    for name in names:
        q = declared[name]
        value, sd = priors.get(name, (initial[name], None))
        low = -math.inf if q.minimum is None else q.minimum
        high = math.inf if q.maximum is None else q.maximum
        if not low <= value <= high or (sd is not None and not sd > 0):
            expected = f"an initial value from {low:g} to {high:g} {q.unit} and a positive standard deviation"
            raise Problem(f"{sub.name}: {name}: expected {expected}, got {value:g} and {sd}")
        free.append(FreeParameter(name, value, q.unit, sd, low, high, low >= 0 and value > 0, q.nominal))
    return tuple(free)
