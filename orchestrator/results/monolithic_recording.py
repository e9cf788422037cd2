"""The monolithic solution of a system as the reference of a run, with the limits of its signals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from orchestrator.base.options import declarations
from orchestrator.base.progress import doing
from orchestrator.data.description import Tolerance
from orchestrator.data.recording import Criterion, Recording
from orchestrator.engine.arguments import SystemArguments
from orchestrator.engine.result import Result, ranges, widest_of_unit
from orchestrator.monolithic.reference import SOLVER, reference
from orchestrator.results.validation import by_variable

LIMIT = 0.01  # of NRMSE, as for pressures, flows and forces of the machine


def solve_as_run(system: Path, scenario: Path | None, run: Result, options: Mapping[str, Any]) -> Result:
    """The monolithic solution over the times of a run, which had these options."""
    same = {name: value for name, value in options.items() if name in declarations(SystemArguments)}
    start, stop = (float(run.trace.time[k]) for k in (0, -1))
    record_step = run.card.record_step or run.card.step
    with doing("computing the monolithic solution"):
        return reference(system, scenario, start=start, stop=stop, record_step=record_step, **same)


def monolithic_recording(
    solved: Result, shipped: Recording, names: Sequence[str] = (), limit: float | None = None
) -> Recording:
    """A monolithic solution as a reference.

    shipped   its signals, labels and limits apply if the solution has one of its signals; else all outputs
              have LIMIT
    names     further names that the signals of a system of one FMU may get, see `by_variable`
    limit     of the NRMSE of each signal that has a limit

    The NRMSE of a constant output is over its nominal value, else over its magnitude or the largest range in
    its unit, else over 1.
    """
    trace, spans = solved.trace, _spans_of_constants(solved)
    if len(solved.system.components) == 1:
        trace = by_variable(trace, (*shipped.signals, *names))
    own = dict(zip(trace.signals, solved.trace.signals, strict=True))
    criteria = {name: shipped.criterion(name) for name in shipped.signals if name in own}
    if not criteria:
        outputs = {str(port) for port in solved.system.ports("output")}
        every = Criterion(tolerance=Tolerance("nrmse", LIMIT))
        criteria = {name: every for name in trace.signals if own[name] in outputs}
    monolithic = solved.card.master == SOLVER
    return Recording(
        Path("monolithic solution"),
        trace.time,
        {name: trace[name] for name in criteria},
        {name: trace.units.get(name, "") for name in criteria},
        criteria={name: _adapted(c, limit, spans.get(own[name])) for name, c in criteria.items()},
        metadata={
            "title": "Monolithic solution of the FMUs" if monolithic else "Co-simulation with a small step",
            "kind": "simulation of the same FMUs",
            "solver": solved.card.master,
        },
    )


def _adapted(criterion: Criterion, limit: float | None, span: float | None) -> Criterion:
    """A criterion with another limit, if it has one, and another span."""
    tolerance = criterion.tolerance
    if limit is not None and tolerance is not None:
        tolerance = Tolerance("nrmse", limit)
    return replace(criterion, tolerance=tolerance, span=criterion.span if span is None else span)


def _spans_of_constants(solved: Result) -> dict[str, float]:
    """What replaces the range of outputs that are constant but for rounding."""
    nominals = solved.system.nominals
    outputs = solved.trace.select(name for name in nominals if name in solved.trace.signals)
    varying = ranges(outputs, nominals)
    constant = {n: float(np.abs(values).max()) for n, values in outputs.items() if n not in varying}
    widest = widest_of_unit({**dict.fromkeys(constant, 0.0), **varying}, outputs.units)
    return {n: abs(nominals[n] or max(magnitude, widest[n]) or 1.0) for n, magnitude in constant.items()}
