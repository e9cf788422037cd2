"""An estimation problem: a subsystem, its free parameters with priors and bounds, and measured runs.

Zeros of sensors may be free as well: a reading is the output of the model plus the zero of its sensor.
An encoder that was mounted 2 degrees off makes the masses wrong that carry the arm, with intervals that do
not know of it. A sensor whose description declares the largest error of its zero (`zero_error`) has a zero of
its own in the refinement, with a prior of half that error as its standard deviation. The zero is bounded by
the declared error, so it cannot take the place of a force that the model lacks.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fmus.contract import Subsystem, quantities
from fmus.identification.refinement.compiled_model import zero_of
from fmus.identification.refinement.measured_runs import MeasuredRun
from fmus.parameters import Values
from fmus.parameters import values as default_values
from orchestrator.base.errors import Problem
from orchestrator.data.recording import Recording
from orchestrator.data.table import Array

PRIOR_SHARE = 0.5  # of the largest error: one in twenty sensors of a data sheet is that far off


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

    def prior_sd(self) -> Array:
        """Prior standard deviations of z, shape (np,), infinite without a prior."""
        sd = np.array([math.inf if f.sd is None else f.sd for f in self.free])
        return np.asarray(sd / self.derivatives(self.initial()))

    def prior_rows(self, z: Array) -> Array:
        """Rows [parameters | residual] of the parameters with a prior."""
        sd = self.prior_sd()
        rows = np.column_stack([np.eye(len(z)), z - self.initial()]) / sd[:, None]
        return np.asarray(rows[np.isfinite(sd)])

    def bounds(self) -> tuple[Array, Array]:
        """Lower and upper bounds of z, each of shape (np,)."""
        return np.array([f.z_of(f.low) for f in self.free]), np.array([f.z_of(f.high) for f in self.free])

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


def declared_errors(recordings: Sequence[Recording], signals: Mapping[str, str]) -> dict[str, float]:
    """Output -> largest error of its sensor's zero in SI units, of the outputs whose sensors declare one.

    signals   output -> signal of the recordings
    """
    errors = {
        output: max((r.sensor(name).zero_error or 0.0 for r in recordings if name in r.signals), default=0.0)
        for output, name in signals.items()
    }
    return {output: error for output, error in errors.items() if error > 0}


def free_zeros(errors: Mapping[str, float], units: Mapping[str, str]) -> tuple[FreeParameter, ...]:
    """The zeros as free parameters, the last ones of a problem; output -> largest error, unit."""
    return tuple(
        FreeParameter(zero_of(n), 0.0, units[n], PRIOR_SHARE * e, -e, e, scale=e) for n, e in errors.items()
    )
