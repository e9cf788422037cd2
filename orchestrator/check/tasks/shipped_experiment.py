"""Task that simulates an experiment shipped with an FMU: parameters, inputs over time, recorded outputs."""

import ctypes
from bisect import bisect_right
from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orchestrator.check.tasks.runner import Remark, Trial
from orchestrator.check.tasks.trial_run import Simulation, Vector


def run(trial: Trial) -> Iterator[Remark]:
    """Simulate; the result has times, and rows of outputs `before` and `after` the inputs of a point are set.

    FMI-LS-REF does not define which of the two a result file contains.
    """
    job = trial.payload
    simulation = Simulation(trial, start=job["start"], stop=job["stop"], step=job["step"])
    instance, variables = simulation.instance, trial.description.by_name
    job = {**job, "input_rows": np.array(job["input_rows"])}
    _set_parameters(simulation, job["parameters"])
    inputs = simulation.values([variables[name] for name in job["inputs"]])
    outputs = simulation.values([variables[name] for name in job["signals"]])
    instance.setup(job["start"], job["stop"], job["tolerance"])
    instance.enter()
    if inputs.names:
        inputs.set(_inputs_at(job, job["start"]))
    instance.leave()
    points, recorded = _points(trial, job)
    before, after = ([outputs.get()], [outputs.get()]) if 0 in recorded else ([], [])
    times = points[: len(before)]
    for n, (begin, end) in enumerate(pairwise(points), 1):
        simulation.do_step(begin, end - begin)
        if n in recorded:
            times.append(end)
            before.append(outputs.get())
        if inputs.names:
            inputs.set(_inputs_at(job, end))
        if n in recorded:
            after.append(outputs.get())
        if simulation.ended:
            break
    simulation.close()
    trial.result = {"times": times, "before": np.array(before).tolist(), "after": np.array(after).tolist()}
    yield from ()  # a task without findings of its own


def _points(trial: Trial, job: Any) -> tuple[list[float], set[int]]:
    """Communication points, and the indices of those that are recorded."""
    start, stop, step, times = job["start"], job["stop"], job["step"], np.array(job["times"])
    tolerance = 1e-6 * step
    grid = start + step * np.arange(int((stop - start) / step + 1 + 1e-9))
    if trial.interface.declares("canHandleVariableCommunicationStepSize"):
        distance = np.abs(times - grid[_nearest(grid, times)])
        off_grid = times[(start < times) & (times <= stop) & (distance >= tolerance)]
        grid = np.sort(np.concatenate([grid, off_grid]))
    nearest = _nearest(grid, times)
    return grid.tolist(), {*nearest[np.abs(times - grid[nearest]) < tolerance].tolist()}


def _nearest(grid: Vector, times: Vector) -> NDArray[np.intp]:
    """Index of the point next to each time."""
    after = np.minimum(np.searchsorted(grid, times, "right"), len(grid) - 1)
    before = np.maximum(after - 1, 0)
    return np.where(times - grid[before] < grid[after] - times, before, after)


def _inputs_at(job: Any, t: float) -> Any:
    """Inputs at a time, by linear interpolation; the later one of two rows with the same time."""
    time, rows = job["input_times"], job["input_rows"]
    i = bisect_right(time, t + 1e-9 * job["step"])
    if i == 0 or i == len(time):
        return rows[max(i - 1, 0)]
    fraction = (t - time[i - 1]) / (time[i] - time[i - 1])
    return rows[i - 1] + fraction * (rows[i] - rows[i - 1]) if fraction >= 1e-6 else rows[i - 1]


def _set_parameters(simulation: Simulation, values: dict[str, Any]) -> None:
    """Set numeric parameters and strings."""
    instance = simulation.instance
    for name, value in values.items():
        v = simulation.trial.description.by_name[name]
        if v.type == "String":
            text = (ctypes.c_char_p * 1)(str(value).encode())
            instance.call("SetString", *instance.references([v.reference]), *instance.values(text, 1))
        else:
            simulation.values([v]).set(value)
