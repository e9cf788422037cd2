"""Runs an experiment that an FMU ships: parameters, inputs at each communication point, outputs at times."""

from __future__ import annotations

import ctypes
from bisect import bisect_right
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Any

from orchestrator.check.child.description import Variable
from orchestrator.check.child.instance import Instance
from orchestrator.check.child.main import Bench, Said
from orchestrator.check.child.player import Values

Rows = list[list[float]]


def experiment(bench: Bench) -> Iterator[Said]:
    """Hands over the rows before and after the inputs of a point were set: nobody says which are meant."""
    job = bench.payload
    if bench.side == "me":
        bench.result = {"times": job["times"], "before": _by_importer(bench, job), "after": []}
        return
    player = bench.player(start=job["start"], stop=job["stop"], step=job["step"])
    instance, variables = player.instance, bench.declared.variables
    _parameters(instance, job["parameters"])
    inputs = Values(instance, [variables[name] for name in job["inputs"]])
    outputs = Values(instance, [variables[name] for name in job["signals"]])
    instance.enter(job["start"], job["stop"], job["tolerance"])
    if inputs.names:
        inputs.set(_at(job, job["start"]))
    instance.leave()
    points, wanted = _points(bench, job)
    before, after = ([outputs.get()], [outputs.get()]) if 0 in wanted else ([], [])
    times = points[: len(before)]
    for n, (begin, end) in enumerate(pairwise(points), 1):
        instance.step(begin, end - begin)
        told = n in wanted
        if told:
            times.append(end)
            before.append(outputs.get())
        if inputs.names:
            inputs.set(_at(job, end))
        if told:
            after.append(outputs.get())
        if instance.ended:
            break
    player.close()
    bench.result = {"times": times, "before": before, "after": after}
    return
    yield


def _points(bench: Bench, job: Any) -> tuple[list[float], set[int]]:
    """Communication points, and the numbers of those that are recorded."""
    start, stop, step, times = job["start"], job["stop"], job["step"], job["times"]
    grid = [start + n * step for n in range(int((stop - start) / step + 1 + 1e-9))]
    if bench.can("canHandleVariableCommunicationStepSize"):
        off = [
            t
            for t in times
            if start < t <= stop and not any(abs(t - g) < 1e-6 * step for g in _near(grid, t))
        ]
        grid = sorted([*grid, *off])
    wanted = {n for t in times for n, g in _numbered(grid, t) if abs(t - g) < 1e-6 * step}
    return grid, wanted


def _numbered(grid: Sequence[float], t: float) -> list[tuple[int, float]]:
    i = bisect_right(grid, t)
    return [(n, grid[n]) for n in range(max(i - 1, 0), min(i + 1, len(grid)))]


def _near(grid: Sequence[float], t: float) -> list[float]:
    return [g for _, g in _numbered(grid, t)]


def _at(job: Any, t: float) -> list[float]:
    """Inputs at a time, linear between the rows; of two rows at one time the later."""
    time, rows = job["input_times"], job["input_rows"]
    i = bisect_right(time, t + 1e-9 * job["step"])
    if i == 0 or i == len(time):
        return list(rows[max(i - 1, 0)])
    share = (t - time[i - 1]) / (time[i] - time[i - 1])
    if share < 1e-6:
        return list(rows[i - 1])
    return [a + share * (b - a) for a, b in zip(rows[i - 1], rows[i], strict=True)]


def _parameters(instance: Instance, values: dict[str, Any]) -> None:
    """Numbers, and texts."""
    for name, value in values.items():
        v: Variable = instance.declared.variables[name]
        if v.kind == "String":
            extra = [ctypes.c_size_t(1)] if instance.declared.major == 3 else []
            references, texts = (ctypes.c_uint * 1)(v.reference), (ctypes.c_char_p * 1)(str(value).encode())
            instance.call("SetString", references, ctypes.c_size_t(1), texts, *extra)
        else:
            Values(instance, [v]).set(value)


def _by_importer(bench: Bench, job: Any) -> Rows:
    """Model exchange needs a good solver: FMPy's CVODE."""
    import fmpy
    import numpy as np

    def alive(*_: Any) -> bool:
        bench.beacon.call("a simulation with CVODE")
        return True

    table = None
    if job["inputs"]:
        table = np.zeros(len(job["input_times"]), [("time", float), *((n, float) for n in job["inputs"])])
        table["time"] = job["input_times"]
        for i, name in enumerate(job["inputs"]):
            table[name] = [row[i] for row in job["input_rows"]]
    found = fmpy.simulate_fmu(
        str(bench.folder),
        validate=False,
        fmi_type="ModelExchange",
        start_time=job["start"],
        stop_time=job["stop"],
        output_interval=job["step"],
        relative_tolerance=min(job["tolerance"] or 1e-6, 1e-6),
        start_values={n: v if isinstance(v, str) else v[0] for n, v in job["parameters"].items()},
        input=table,
        output=job["signals"],
        step_finished=alive,
    )
    columns = [np.interp(job["times"], found["time"], found[name]) for name in job["signals"]]
    return [[float(x) for x in row] for row in np.column_stack(columns)]
