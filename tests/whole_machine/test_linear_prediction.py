"""Master interface-jacobian on the machine and on the published benchmark."""

from functools import cache

import numpy as np
import pytest
from kit import shards
from kit.mistakes import table
from machine import solve  # of the example, see conftest.py

from fmus.machine.build import data
from orchestrator import Trace, run
from orchestrator.data.recording import read_recording
from orchestrator.engine.linear_system import LinearPrediction
from orchestrator.results.validation import validate

MASTER = "interface-jacobian"
REFERENCE = read_recording(data("reference/work_cycle.csv"))


def worst(result, group: str) -> float:
    rows = validate(result.trace, REFERENCE).rows
    return max(row.metrics.nrmse for row in rows if row.group == group)


@pytest.mark.parametrize(
    ("step", "speed", "pressure"),
    # measured 4.1e-7 and 7e-7, 4.8e-6 and 7e-6, 7.8e-5 and 1.1e-4
    [pytest.param(5e-3, 1e-6, 2e-6, marks=shards.machine), (1e-2, 1e-5, 2e-5), (2e-2, 1.5e-4, 2e-4)],
)
def test_work_cycle(system, step, speed, pressure):
    """The whole work cycle in one pass, led by the levers, within a hundredth of the bar of 1e-3 at 10 ms."""
    result = run(system, master=MASTER, step=step)
    assert worst(result, "speed") < speed
    assert worst(result, "pressure") < pressure
    assert result.card.notes == ()  # every component tells how it changes


def test_order_four(system):
    """Halving the step divides the error by up to sixteen."""
    errors = [worst(run(system, master=MASTER, step=h, stop=5.0), "speed") for h in (2e-2, 1e-2, 5e-3)]
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    # measured 3.3 and 3.7: corners of the commands inside the first steps after them
    assert np.all((orders > 3.1) & (orders < 4.4))


def test_a_scenario_and_fmi_3_are_as_accurate_as_the_levers(system, fmi3_dir):
    """Driven inputs are part of the prediction; in FMI 3.0 inputs move at their rates."""
    driven = run(system, data("scenarios/work_cycle.csv"), master=MASTER, step=1e-2, stop=5.0)
    led = run(fmi3_dir / "harvester.ssp", master=MASTER, step=1e-2, stop=5.0)
    # measured 1.2e-5 of both
    assert worst(driven, "speed") < 2e-5
    assert worst(led, "speed") < 2e-5


def test_the_fastest_component_steps_first(system, monkeypatch):
    """Operator input and supply lead; hydraulics precede the arm: the other order is 7.7 times worse."""
    begin, names = LinearPrediction.begin, [*system.components]

    def error(arranged):
        monkeypatch.setattr(LinearPrediction, "begin", lambda prediction: arranged([*begin(prediction)]))
        return worst(run(system, master=MASTER, step=1e-2, stop=5.0, isolate=False), "speed")

    orders = []
    chosen = error(lambda order: orders.append([names[k] for k in order]) or order)
    assert {*orders[0][:2]} == {"operator_input", "supply"}
    assert orders[0][-1] == "manipulator"
    assert error(lambda order: [*order[:2], *order[:1:-1]]) > 5 * chosen


@cache
def manoeuvre(ramp: float) -> tuple[Trace, np.ndarray]:
    """M1 with ramps of this length [s], and the truth every 10 ms."""
    kappa = 0.4543455896 + np.array([0, 0, -0.01, -0.01, 0.02, 0.02])
    given = Trace(np.array([0, 2, 2 + ramp, 6, 6 + ramp, 10.0]), {"kappa": kappa}, {"kappa": "1"})
    return given, solve(given, np.arange(1001) * 1e-2)["arm.s1"]


@table(__file__, "ramps", "ramp, step, limit")
def test_benchmark_is_stable_at_large_steps(manipulator_systems, ramp, step, limit):
    """Ramps of 0.2 s: micrometres at 100 ms, where the authors' schemes stop at 40 ms."""
    given, truth = manoeuvre(ramp)
    trace = run(manipulator_systems["rates"], given, master=MASTER, step=step, stop=10.0).trace
    every = round(step / 1e-2)
    assert np.max(np.abs(trace["arm.s1"] - truth[::every])) < limit
