"""Task that simulates an experiment shipped with an FMU: parameters, inputs over time, recorded outputs."""

import ctypes
from bisect import bisect_right
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Any

from orchestrator.check.tasks.runner import Remark, Trial
from orchestrator.check.tasks.trial_run import Rows, Simulation


def run(trial: Trial) -> Iterator[Remark]:
    """Simulate; the result has times, and rows of outputs `before` and `after` the inputs of a point are set.

    FMI-LS-REF does not define which of the two a result file contains.
    """
    job = trial.payload
    if trial.kind == "ModelExchange":
        trial.result = {"times": job["times"], "before": _by_cvode(trial, job), "after": []}
        return
    simulation = Simulation(trial, start=job["start"], stop=job["stop"], step=job["step"])
    instance, variables = simulation.instance, trial.description.by_name
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
    trial.result = {"times": times, "before": before, "after": after}
    yield from ()  # a task without findings of its own


def _points(trial: Trial, job: Any) -> tuple[list[float], set[int]]:
    """Communication points, and the indices of those that are recorded."""
    start, stop, step, times = job["start"], job["stop"], job["step"], job["times"]
    tolerance = 1e-6 * step
    grid = [start + n * step for n in range(int((stop - start) / step + 1 + 1e-9))]
    if trial.interface.declares("canHandleVariableCommunicationStepSize"):
        off_grid = [
            t
            for t in times
            if start < t <= stop and all(abs(t - g) >= tolerance for _, g in _neighbours(grid, t))
        ]
        grid = sorted([*grid, *off_grid])
    return grid, {n for t in times for n, g in _neighbours(grid, t) if abs(t - g) < tolerance}


def _neighbours(grid: Sequence[float], t: float) -> list[tuple[int, float]]:
    """The points before and after a time, with their indices."""
    i = bisect_right(grid, t)
    return [(n, grid[n]) for n in range(max(i - 1, 0), min(i + 1, len(grid)))]


def _inputs_at(job: Any, t: float) -> list[float]:
    """Inputs at a time, by linear interpolation; the later one of two rows with the same time."""
    time, rows = job["input_times"], job["input_rows"]
    i = bisect_right(time, t + 1e-9 * job["step"])
    if i == 0 or i == len(time):
        return list(rows[max(i - 1, 0)])
    fraction = (t - time[i - 1]) / (time[i] - time[i - 1])
    if fraction < 1e-6:
        return list(rows[i - 1])
    return [a + fraction * (b - a) for a, b in zip(rows[i - 1], rows[i], strict=True)]


def _set_parameters(simulation: Simulation, values: dict[str, Any]) -> None:
    """Set numeric parameters and strings."""
    instance = simulation.instance
    for name, value in values.items():
        v = simulation.trial.description.by_name[name]
        if v.type == "String":
            text = (ctypes.c_char_p * 1)(str(value).encode())
            instance.call("SetString", *instance.references([v.reference or 0]), *instance.values(text, 1))
        else:
            simulation.values([v]).set(value)


def _by_cvode(trial: Trial, job: Any) -> Rows:
    """Outputs in Model Exchange, which needs an accurate solver: CVODE of FMPy."""
    import fmpy
    import numpy as np

    def report_progress(*_: Any) -> bool:
        trial.activity.call("a simulation with CVODE")
        return True

    stimuli = None
    if job["inputs"]:
        stimuli = np.zeros(len(job["input_times"]), [("time", float), *((n, float) for n in job["inputs"])])
        stimuli["time"] = job["input_times"]
        for i, name in enumerate(job["inputs"]):
            stimuli[name] = [row[i] for row in job["input_rows"]]
    result = fmpy.simulate_fmu(
        str(trial.folder),
        validate=False,
        fmi_type="ModelExchange",
        start_time=job["start"],
        stop_time=job["stop"],
        output_interval=job["step"],
        relative_tolerance=min(job["tolerance"] or 1e-6, 1e-6),
        start_values={n: v if isinstance(v, str) else v[0] for n, v in job["parameters"].items()},
        input=stimuli,
        output=job["signals"],
        step_finished=report_progress,
    )
    columns = [np.interp(job["times"], result["time"], result[name]) for name in job["signals"]]
    return [[float(x) for x in row] for row in np.column_stack(columns)]
