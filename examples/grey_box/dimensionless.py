"""Grey-box identification from recordings without units: a dimensionless model of names and equations.

Time is in samples, and signals are relative to their peaks, so that all values are near 1.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import make_dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from fmus.contract import Quantity, Scalar, Subsystem, quantities
from fmus.identification.recordings.reading import add
from fmus.identification.refinement.problem import EstimationProblem, RecordingMap, free_parameters
from fmus.parameters import Number
from orchestrator.base.errors import Problem
from orchestrator.data.recording import Mask, Recording
from orchestrator.data.table import read_columns

Rates = Callable[[Any, Any, Any], Mapping[str, Scalar]]


def dimensionless(
    name: str,
    parameters: Mapping[str, float],
    inputs: Sequence[str],
    states: Sequence[str],
    rates: Rates,
    initial: Mapping[str, str] | None = None,
) -> Subsystem:
    """A subsystem whose outputs are its states.

    parameters   initial values by name; all are positive and stay positive
    rates        (x, u, p) -> {state: its time derivative}
    initial      state -> input whose first value is its initial value; zero for the others
    """
    for parameter, value in parameters.items():
        if not value > 0:
            raise Problem(f"{name}: {parameter}: expected an initial value above 0, got {value:g}")
    numbers = {n: Number(float(value), "1", "assumed", "initial value") for n, value in parameters.items()}
    state, output = _group("States", states), _group("Outputs", states)

    def dynamics(x: Any, u: Any, p: Any) -> Any:
        dx = rates(x, u, p)
        if set(dx) != set(states):
            raise Problem(f"{name}: rates: expected {', '.join(states)}, got {', '.join(dx)}")
        return state(**dx)

    def observe(x: Any, *_: Any) -> Any:
        return output(**{n: getattr(x, n) for n in states})

    def initial_states(_: Any, u: Any, __: Any) -> dict[str, Scalar]:
        return {n: getattr(u, source) for n, source in (initial or {}).items()}

    return Subsystem(
        name=name,
        text="",
        parameters=_group("Parameters", parameters, minimum=0.0),
        states=state,
        inputs=_group("Inputs", inputs),
        outputs=output,
        dynamics=dynamics,
        observe=observe,
        initial=initial_states,
        values=Path(name),
        numbers={"parameters": numbers, "start": {}},
    )


def normalised(recording: Recording) -> tuple[Recording, dict[str, float]]:
    """The recording with each signal divided by its peak, and the peaks.

    The peak of a signal that is opposed to the first one is negative, so that all signals have one direction.
    """
    peaks: dict[str, float] = {}
    first = next(iter(recording.signals))
    for name, signal in recording.signals.items():
        peak = float(np.nanmax(np.abs(signal))) if np.isfinite(signal).any() else 0.0
        if not peak > 0:
            raise Problem(f"{recording.source}: {name}: expected a varying signal, got only zeros and gaps")
        peaks[name] = peak if np.nansum(recording[first] * signal) >= 0 else -peak
    for name, peak in peaks.items():
        recording = add(recording, name, recording[name] / peak, "1")
    return recording, peaks


def blank(recording: Recording, name: str, mask: Mask) -> Recording:
    """The recording with the samples of a signal under `mask` replaced by gaps (NaN)."""
    values = np.where(mask, np.nan, recording[name])
    return replace(recording, signals={**recording.signals, name: values})


def all_free(
    model: Subsystem, training: Recording, *held_out: Recording, sd: float = 0.05
) -> EstimationProblem:
    """A problem with all parameters of a model free and all recorded outputs to fit.

    sd   assumed standard deviation of the outputs; the residuals of the fit determine the intervals
    """
    outputs = [n for n in quantities(model.outputs) if n in training.signals]
    mapping = RecordingMap(model, outputs, sd=dict.fromkeys(outputs, sd))
    free = free_parameters(model, list(quantities(model.parameters)))
    held_out_runs = tuple(mapping.run(recording) for recording in held_out)
    return EstimationProblem(model, tuple(outputs), free, (mapping.run(training),), held_out_runs)


def _group(title: str, names: Sequence[str] | Mapping[str, float], minimum: float | None = None) -> type[Any]:
    """A group of dimensionless variables with nominal value 1."""
    quantity = [(n, Annotated[Scalar, Quantity("1", n, minimum=minimum)]) for n in names]
    return make_dataclass(title, quantity, frozen=True)


def series(path: Path | str, columns: Mapping[str, int | str]) -> Recording:
    """A file of numbers without units and time, whose clock counts samples.

    columns   signal -> index from 0 in a text file without names, or name of a column or variable
    """
    path, unnamed = Path(path), all(isinstance(column, int) for column in columns.values())
    table = read_columns(path, {str(column) for column in columns.values()}, named=not unnamed)
    signals = {name: table.values[str(column)] for name, column in columns.items()}
    time = np.arange(float(len(table.rows)))
    return Recording(time, signals, dict.fromkeys(columns, "1"), path, title=path.stem)
