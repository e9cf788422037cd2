"""An estimation problem: a subsystem, its free parameters with priors and bounds, the runs to explain."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fmus.contract import Subsystem, quantities
from fmus.parameters import Values, values
from orchestrator.base.errors import Problem

Array = NDArray[np.float64]


@dataclass(frozen=True)
class FreeParameter:
    """One free parameter, searched as z.

        value = exp(z)      if it cannot be negative and is not zero (`log`): z counts relative changes
        value = scale z     else

    sd         prior standard deviation of the value around `value`, None without a prior
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
        """z of a value; minus infinity for zero on a logarithmic scale."""
        if not self.log:
            return value / self.scale
        return math.log(value) if value > 0 else -math.inf

    def value_of(self, z: float) -> float:
        """The value of z."""
        return math.exp(z) if self.log else self.scale * z

    def slope(self, z: float) -> float:
        """d value / dz."""
        return math.exp(z) if self.log else self.scale

    @property
    def z_sd(self) -> float:
        """Prior standard deviation of z, infinite without a prior."""
        return math.inf if self.sd is None else self.sd / self.slope(self.z_of(self.value))


@dataclass(frozen=True)
class MeasuredRun:
    """One recording by the model's names.

    time           shape (n,) [s]
    inputs         input -> shape (n,), linear between the samples
    measured       shape (n, ny); NaN allowed where the weight is zero
    weight         shape (n, ny): 1 / standard deviation of a sample, 0 for one that does not count
    compared       shape (n, ny), true where a sample takes part in the fit that is reported
    scale          range of each whole output, by which the NRMSE divides
    guess          state -> its trajectory (n,) as far as it is measured, to start from
    rest           states that start at rest: zero, and that is known well
    input_noise    measured input -> standard deviation of a sample, samples over which it was smoothed
    """

    name: str
    time: Array
    inputs: Mapping[str, Array]
    measured: Array
    weight: Array
    compared: NDArray[np.bool_]
    scale: Array
    guess: Mapping[str, Array] = field(default_factory=dict)
    rest: tuple[str, ...] = ()
    input_noise: Mapping[str, tuple[float, int]] = field(default_factory=dict)


@dataclass(frozen=True)
class EstimationProblem:
    """A subsystem, its free parameters, the runs to fit and the runs held out; `fixed` are its numbers."""

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
        """z to start from, shape (np,)."""
        return np.array([f.z_of(f.value) for f in self.free])

    def bounds(self) -> tuple[Array, Array]:
        """Lowest and highest z, each of shape (np,)."""
        return (
            np.array([f.z_of(f.low) if math.isfinite(f.low) else -math.inf for f in self.free]),
            np.array([f.z_of(f.high) if math.isfinite(f.high) else math.inf for f in self.free]),
        )

    def values_of(self, z: Array) -> Array:
        """Parameter values of z, shape (np,)."""
        return np.array([f.value_of(float(v)) for f, v in zip(self.free, z, strict=True)])

    def slopes(self, z: Array) -> Array:
        """d value / dz, shape (np,)."""
        return np.array([f.slope(float(v)) for f, v in zip(self.free, z, strict=True)])

    def by_name(self, z: Array) -> dict[str, float]:
        """Parameter values of z by name."""
        return dict(zip(self.names, self.values_of(z).tolist(), strict=True))


def free_parameters(
    sub: Subsystem,
    names: Sequence[str],
    priors: Mapping[str, tuple[float, float | None]] | None = None,
    numbers: Values | None = None,
) -> tuple[FreeParameter, ...]:
    """Free parameters with the bounds that the subsystem declares.

    priors   value and its standard deviation, None for a mere value to start from
    numbers  values where there is no prior, by default those of the subsystem's file
    """
    declared, given, priors = quantities(sub.parameters), (numbers or values(sub)).p, priors or {}
    unknown = [n for n in (*names, *priors) if n not in declared]
    if unknown:
        raise Problem(f"{sub.name}: {unknown[0]} is to be refined, expected a parameter of it")
    free = []
    for name in names:
        q = declared[name]
        value, sd = priors.get(name, (given[name], None))
        low = -math.inf if q.minimum is None else q.minimum
        high = math.inf if q.maximum is None else q.maximum
        if not low <= value <= high or (sd is not None and not sd > 0):
            raise Problem(
                f"{sub.name}: {name} starts from {value:g} {q.unit} with sd {sd}, "
                f"expected {low:g} to {high:g} and a positive sd"
            )
        free.append(FreeParameter(name, value, q.unit, sd, low, high, low >= 0 and value > 0, q.nominal))
    return tuple(free)
