"""A dimensionless model for recordings without units: names and equations are all that it takes.

Time is counted in samples, signals in magnitudes that the data have, so that all numbers are near 1.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import make_dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from fmus.contract import Quantity, Scalar, Subsystem, quantities
from fmus.identification.recordings.reading import add
from fmus.identification.refinement.data import RecordingMap
from fmus.identification.refinement.problem import EstimationProblem, free_parameters
from fmus.parameters import Number
from orchestrator.base.errors import Problem
from orchestrator.data.recording import Recording

Rates = Callable[[Any, Any, Any], Mapping[str, Scalar]]


def dimensionless(
    name: str,
    parameters: Mapping[str, float],
    inputs: Sequence[str],
    states: Sequence[str],
    rates: Rates,
    begin: Mapping[str, str] | None = None,
) -> Subsystem:
    """A subsystem whose outputs are its states.

    parameters   value to start from by name; all are positive and stay so
    rates        (x, u, p) -> {state: its time derivative}
    begin        state -> input whose first value it has at the start; zero for the others
    """
    bad = [n for n, value in parameters.items() if not value > 0]
    if bad:
        raise Problem(f"{name}: {bad[0]} starts from {parameters[bad[0]]:g}, expected more than 0")
    numbers = {n: Number(float(value), "1", "assumed", "to start from") for n, value in parameters.items()}
    state, output = _group("States", states), _group("Outputs", states)

    def dynamics(x: Any, u: Any, p: Any) -> Any:
        dx = rates(x, u, p)
        if set(dx) != set(states):
            raise Problem(f"{name}: rates of {', '.join(dx)}, expected those of {', '.join(states)}")
        return state(**dx)

    def observe(x: Any, *_: Any) -> Any:
        return output(**{n: getattr(x, n) for n in states})

    def initial(_: Any, u: Any, __: Any) -> dict[str, Scalar]:
        return {n: getattr(u, source) for n, source in (begin or {}).items()}

    return Subsystem(
        name=name,
        text="",
        parameters=_group("Parameters", parameters, minimum=0.0),
        states=state,
        inputs=_group("Inputs", inputs),
        outputs=output,
        dynamics=dynamics,
        observe=observe,
        initial=initial,
        values=Path(name),
        numbers={"parameters": numbers, "start": {}},
    )


def normalised(recording: Recording) -> tuple[Recording, dict[str, float]]:
    """The recording with each signal over its peak, and those peaks.

    The peak of a signal that goes against the first one counts negative: plus then drives to plus.
    """
    peaks: dict[str, float] = {}
    first = next(iter(recording.signals))
    for name, signal in recording.signals.items():
        peak = float(np.nanmax(np.abs(signal))) if np.isfinite(signal).any() else 0.0
        if not peak > 0:
            raise Problem(f"{recording.source}: {name} is 0 throughout or a gap, expected one that moves")
        peaks[name] = peak if np.nansum(recording[first] * signal) >= 0 else -peak
    for name, peak in peaks.items():
        recording = add(recording, name, recording[name] / peak, "1")
    return recording, peaks


def all_free(
    model: Subsystem, training: Recording, *held_out: Recording, sd: float = 0.05
) -> EstimationProblem:
    """All parameters of a model, fitted to all its outputs that the recording has.

    sd   standard deviation of the outputs, to begin with: intervals come from what is left after the fit
    """
    outputs = [n for n in quantities(model.outputs) if n in training.signals]
    mapping = RecordingMap(model, outputs, sd=dict.fromkeys(outputs, sd))
    free = free_parameters(model, list(quantities(model.parameters)))
    unseen = tuple(mapping.run(recording) for recording in held_out)
    return EstimationProblem(model, tuple(outputs), free, (mapping.run(training),), unseen)


def _group(title: str, names: Sequence[str] | Mapping[str, float], minimum: float | None = None) -> type[Any]:
    """A group of variables of magnitude 1 without units."""
    quantity = [(n, Annotated[Scalar, Quantity("1", n, minimum=minimum)]) for n in names]
    return make_dataclass(title, quantity, frozen=True)
