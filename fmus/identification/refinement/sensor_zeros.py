"""Zeros of sensors as free parameters: a reading is the output of the model plus the zero of its sensor.

An encoder that was mounted 2 degrees off makes the masses wrong that carry the arm, with intervals that do
not know of it. A sensor whose description declares the largest error of its zero (`zero_error`) has a zero of
its own in the refinement, with a prior of half that error as its standard deviation. The zero is bounded by
the declared error, so it cannot take the place of a force that the model lacks.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from fmus.contract import Quantity, Subsystem, make_group, quantities
from fmus.identification.refinement.problem import FreeParameter, free_parameters
from orchestrator.data.recording import Recording

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


def with_zeros(sub: Subsystem, errors: Mapping[str, float]) -> Subsystem:
    """The subsystem with a zero for each of these outputs, within its largest error."""
    if not errors:
        return sub
    outputs = quantities(sub.outputs)
    zeros = {
        parameter(n): Quantity(outputs[n].unit, f"Zero of the sensor of {n}", e, minimum=-e, maximum=e)
        for n, e in errors.items()
    }

    def observe(x: Any, u: Any, p: Any) -> Any:
        y = sub.observe(x, u, p)
        return replace(y, **{n: getattr(y, n) + getattr(p, parameter(n)) for n in errors})

    parameters = make_group("ParametersWithZeros", {**quantities(sub.parameters), **zeros})
    return replace(sub, parameters=parameters, observe=observe)


def free_zeros(sub: Subsystem, errors: Mapping[str, float], values: Any) -> tuple[FreeParameter, ...]:
    """The zeros as free parameters, with their priors."""
    priors = {parameter(n): (0.0, PRIOR_SHARE * e) for n, e in errors.items()}
    return free_parameters(sub, list(priors), priors, values)
