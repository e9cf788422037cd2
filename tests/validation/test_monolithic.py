"""The monolithic solution as the reference of a run: compared signals, limits, constant outputs."""

from pathlib import Path

import numpy as np
import pytest

from orchestrator import Result, Trace
from orchestrator.data.description import Tolerance
from orchestrator.data.recording import Criterion, Recording
from orchestrator.engine.result import Card
from orchestrator.fmi.description import FmuVariable
from orchestrator.fmi.interface import FmuInterface
from orchestrator.monolithic.reference import SOLVER
from orchestrator.results.validate_system import LIMIT, monolithic_recording
from orchestrator.results.validation import validate
from orchestrator.ssp.system import Component, System

TIME = np.linspace(0.0, 1.0, 11)
SHIPPED = Recording(
    TIME,
    {"arm.angle": TIME, "arm.command": TIME},
    {"arm.angle": "rad", "arm.command": "V"},
    Path("shipped.csv"),
    criteria={"arm.angle": Criterion("Angle", "angle", tolerance=Tolerance("nrmse", 0.001))},
)


def solved(name: str = "arm", master: str = SOLVER, **signals: float) -> Result:
    """A solution with outputs that grow at a rate each, or are constant if it is 0; `still` has a nominal."""
    variables = {n: FmuVariable(n, causality="output") for n in signals}
    if "still" in variables:
        variables["still"] = FmuVariable("still", causality="output", attributes={"nominal": "100"})
    system = System("s", {name: Component(name, FmuInterface(variables))})
    trace = Trace(TIME, {f"{name}.{n}": 3.0 + rate * TIME for n, rate in signals.items()})
    return Result(system, trace, Card(master, 0.1, 0.1, 10, 1.0, 0.1))


def test_without_shipped_signals_all_outputs_are_compared():
    """With one limit, which an option changes."""
    recording = monolithic_recording(solved("other", x=1.0, y=2.0), SHIPPED)
    assert set(recording.criteria) == {"other.x", "other.y"}
    for limit in (None, 1e-4):
        found = monolithic_recording(solved("other", x=1.0), SHIPPED, limit=limit).criteria["other.x"]
        assert found == Criterion(tolerance=Tolerance("nrmse", limit or LIMIT))


@pytest.mark.parametrize("limit", [None, 1e-4])
def test_shipped_signals_keep_labels_and_limits(limit):
    """Others have 1 %, and an option changes the limit; also those of a single FMU with another name."""
    for name in ("arm", "whole"):
        recording = monolithic_recording(solved(name, angle=1.0, x=1.0), SHIPPED, limit=limit)
        tolerance, other = (Tolerance("nrmse", limit or usual) for usual in (0.001, 0.01))
        # over its range in the shipped reference; with a limit over its own
        angle = Criterion("Angle", "angle", None if limit else 1.0, tolerance, 1e-3 if limit else 0.0)
        assert recording.criteria == {"arm.angle": angle, f"{name}.x": Criterion(tolerance=other)}


def test_constant_outputs_are_judged_by_their_magnitude():
    """A run that leaves a constant fails, and rounding does not: range 0 would make it infinite."""
    truth = solved("other", still=0.0, plain=0.0)
    recording = monolithic_recording(truth, SHIPPED)
    assert {n: c.span for n, c in recording.criteria.items()} == {"other.still": 100.0, "other.plain": 3.0}
    for error, passed in ((1e-14, True), (1.1, False)):
        run = Trace(TIME, {n: v + error * np.sin(99 * TIME) for n, v in truth.trace.signals.items()})
        assert validate(run, recording, rate=False).passed is passed


def test_the_title_and_the_signals_compared():
    """A co-simulation is told where an FMU has no Model Exchange; signals that the run lacks are left out."""
    titles = [monolithic_recording(solved(master=m, x=1.0), SHIPPED).heading for m in (SOLVER, "hermite")]
    assert titles == ["Monolithic solution of the FMUs", "Co-simulation with a small step"]
    truth = solved("other", x=1.0, state=2.0)
    run = truth.trace.select(["other.x"])
    assert [row.signal for row in validate(run, truth, rate=False).rows] == ["other.x"]
