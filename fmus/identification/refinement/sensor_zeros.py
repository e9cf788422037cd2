"""Zeros of sensors as free parameters: a reading is the output of the model plus the zero of its sensor.

An encoder that was mounted 2 degrees off makes the masses wrong that carry the arm, with intervals that do
not know of it. A sensor whose description declares the largest error of its zero (`zero_error`) has a zero of
its own in the refinement, with a prior of half that error as its standard deviation. The zero is bounded by
the declared error, so it cannot take the place of a force that the model lacks.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from fmus.identification.refinement.problem import FreeParameter
from fmus.identification.refinement.simulation import SegmentSolution, Simulator
from orchestrator.data.recording import Recording
from orchestrator.data.table import Array

PREFIX = "zero_of_"
PRIOR_SHARE = 0.5  # of the largest error: one in twenty sensors of a data sheet is that far off


def parameter(output: str) -> str:
    """Name of the parameter that is the zero of an output's sensor."""
    return PREFIX + output


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
        FreeParameter(parameter(n), 0.0, units[n], PRIOR_SHARE * e, -e, e, scale=e) for n, e in errors.items()
    )


class WithZeros:
    """A simulator of readings: the outputs of a model, some of them with the zero of their sensor."""

    def __init__(self, model: Simulator, outputs: Sequence[str]) -> None:
        self.model, self._columns = model, [model.outputs.index(name) for name in outputs]
        self.states, self.inputs, self.outputs = model.states, model.inputs, model.outputs
        self.free = (*model.free, *map(parameter, outputs))
        self.nominal, self.p0 = model.nominal, np.append(model.p0, np.zeros(len(outputs)))

    def start(self, p: Array, u0: Array) -> tuple[Array, Array]:
        """Initial states, which do not depend on the zeros."""
        x, x_p = self.model.start(p[: len(self.model.free)], u0)
        return x, self._padded(x_p)

    def segment(
        self, x: Array, p: Array, time: Array, inputs: Array, sensitivities: bool = True
    ) -> SegmentSolution:
        """A segment of the model; the derivative of a reading by the zero of its sensor is one."""
        count = len(self.model.free)
        found = self.model.segment(x, p[:count], time, inputs, sensitivities)
        y = found.y.copy()
        y[:, self._columns] += p[count:]
        if not sensitivities:
            return replace(found, y=y)
        y_p = self._padded(found.y_p)
        y_p[:, self._columns, range(count, len(p))] = 1.0
        return replace(found, y=y, y_p=y_p, x_p=self._padded(found.x_p))

    def _padded(self, by_p: Array) -> Array:
        """Derivatives with columns of zeros for the zeros of sensors."""
        return np.concatenate([by_p, np.zeros((*by_p.shape[:-1], len(self._columns)))], axis=-1)
