"""The integration from event to event, of equations in Python: counts, times that are equal, limits."""

import time
from types import SimpleNamespace

import numpy as np
import pytest

from orchestrator.base.errors import Problem
from orchestrator.base.units import IDENTITY
from orchestrator.engine.run import ProgressBar
from orchestrator.engine.scenario import Scenario, ScenarioTable
from orchestrator.engine.time_grid import Grid
from orchestrator.fmi.description import FmuVariable
from orchestrator.fmi.interface import FmuInterface
from orchestrator.monolithic import reference as module
from orchestrator.monolithic.reference import reference
from orchestrator.ssp.system import Component, Port, System


class Equations:
    """Stands for a plant with x' = rate(x), or without states, whose output is the number of events.

    at      times of its time events
    z       time -> event indicator
    told    times of the accepted steps; events: times of event mode
    """

    def __init__(self, x=(), rate=lambda x: -x, slope=-1.0, at=(), z=None, nominal=1.0):
        variables = [FmuVariable("y", causality="output"), FmuVariable("u", causality="input")]
        variables += [FmuVariable("n", "Integer", "input", "discrete"), FmuVariable("x")]
        self.system = System("s", {"a": Component("a", FmuInterface({v.name: v for v in variables}))})
        self.states, self.outputs, self.inputs = [Port("a", "x")] * len(x), [Port("a", "y")], []
        self.x, self.y, self.v = np.array(x), np.zeros(1), np.zeros(0)
        self.rate, self.slope, self.at, self.z, self.nominal = rate, slope, [*at, np.inf], z, nominal
        self.indicator_count, self.ended, self.notes, self.slaves = int(z is not None), "", (), {}
        self.changed = ["a.y"]
        self.told, self.events, self.rates, self.jacobians = [], [], 0, 0

    next_event = property(lambda self: self.at[0])

    def start(self, span, _):
        self.time = span[0]

    def settle_at(self, t, x):
        self.time, self.x[:] = t, x

    @property
    def f(self):
        self.rates += 1
        return self.rate(self.x)

    def matrices(self):
        self.jacobians += 1
        return SimpleNamespace(a=self.slope * np.eye(len(self.x)))

    def indicators(self):
        return np.array(self.z(self.time) if self.z else [])

    def completed_step(self, t, _):
        self.told.append(t)
        return False

    def event(self, _):
        self.events.append(self.time)
        del self.at[: self.at[0] < np.inf]
        self.y += 1.0

    def magnitudes(self):
        return np.full(len(self.x), self.nominal)


def solved(equations, grid, tolerance=1e-10):
    """The result over a grid."""
    return module._Recorded(equations, None, grid, tolerance).result(ProgressBar(1.0, False))


def test_the_card_counts_what_happened():
    """Each accepted step is told once; evaluations, Jacobians and events are those that were asked for."""
    plant = Equations([1.0], at=[2.5])
    begin = time.perf_counter()
    result = solved(plant, Grid(2.0, 0.1, 30))
    assert 0.0 < result.card.wall < time.perf_counter() - begin
    assert result.time.tolist() == (2.0 + 0.1 * np.arange(31)).tolist()
    # a hundred times the tolerance of a step
    np.testing.assert_allclose(result["a.x"], np.exp(2.0 - result.time), rtol=0, atol=1e-8)
    assert result["a.y"].tolist() == [0.0] * 5 + [1.0] * 26
    assert (np.diff(plant.told) > 0).all()
    assert result.card.steps == len(plant.told) > 60  # two starts with short steps
    assert result.card.simulated == pytest.approx(3.0, rel=1e-15)
    assert result.card.step == pytest.approx(3.0 / len(plant.told), rel=1e-15)
    counts = f"{plant.rates} evaluations, {plant.jacobians} Jacobians, 1 events"
    assert result.card.notes == (f"monolithic solution: {counts}",)


def test_a_nominal_value_scales_the_absolute_tolerance():
    """x in another unit, 2^20 times as large, with a nominal value as much larger: the same bits."""
    grid = Grid(0.0, 0.1, 100)
    small, large = (solved(Equations([n], nominal=n), grid, 1e-6)["a.x"] for n in (1.0, 2.0**20))
    assert (2.0**20 * small).tolist() == large.tolist()


@pytest.mark.parametrize(("start", "stop"), [(0.0, 1.0), (0.0, 1000.0), (-3.0, 1.0), (7.0, 8.0)])
@pytest.mark.parametrize(("late", "same"), [(-1.1, True), (0.9, True), (1.1, False)])
@pytest.mark.parametrize("x", [(), (1.0,)])
def test_an_event_within_1e_12_of_the_span_is_at_the_recorded_time(start, stop, late, same, x):
    """Then the row has the values after it; the span is the larger one of duration and stop time."""
    late *= 1e-12 * max(stop - start, stop)
    grid = Grid(start, (stop - start) / 4, 4)
    found = solved(Equations(x, at=[start + 2 * grid.step + late]), grid, 1e-4)["a.y"]
    assert found.tolist() == [0.0, 0.0, float(same), 1.0, 1.0]


def test_times_with_just_the_limit_between_them_are_equal(monkeypatch):
    """In numbers without rounding."""
    monkeypatch.setattr(module, "SAME_TIME", 2.0**-40)
    for late, first in ((2.0**-40, 1.0), (1.5 * 2.0**-40, 0.0)):
        found = solved(Equations(at=[0.5 + late]), Grid(0.0, 0.5, 2))
        assert found["a.y"].tolist() == [0.0, first, 1.0]


@pytest.mark.parametrize("at", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("x", [(), (1.0,)])
def test_at_one_time_there_are_at_most_1000_events(at, x):
    """At the start, inside and, once, at the stop time, where nothing follows."""
    rows = [0.0] * round(2 * at + 0.5) + [1000.0] * (3 - round(2 * at + 0.5))
    if at == 1.0:
        assert solved(Equations(x, at=[at]), Grid(0.0, 0.5, 2))["a.y"].tolist() == [0.0, 0.0, 1.0]
        return
    events = [at] * 1000
    assert solved(Equations(x, at=events), Grid(0.0, 0.5, 2))["a.y"][1:].tolist() == rows[1:]
    with pytest.raises(Problem, match=f"s: t = {at:.9g} s: expected at most 1000 events at one time: a.y"):
        solved(Equations(x, at=[*events, at]), Grid(0.0, 0.5, 2))


def test_an_event_that_is_announced_too_late_does_not_turn_time_back():
    """The event that is due at 0.1 s and announced at 0.5 s is at 0.5 s; x = t."""
    plant = Equations([0.0], rate=np.ones_like, slope=0.0, at=[0.5, 0.1])
    result = solved(plant, Grid(0.0, 0.25, 4))
    assert result["a.y"].tolist() == [0.0, 0.0, 2.0, 2.0, 2.0]
    np.testing.assert_allclose(result["a.x"], result.time, rtol=0, atol=1e-9)  # ten tolerances


@pytest.mark.parametrize(
    ("z", "events"),
    [
        (lambda t: 0.4 - t, [0.4]),
        (lambda t: t - 0.5, [0.5]),  # zero is on the negative side, as in FMI
        (lambda t: t, [0.0]),
        (lambda t: -t, []),
        (lambda t: np.sin(2 * np.pi * t + 0.3), [0.5 - 0.15 / np.pi, 1.0 - 0.15 / np.pi]),
    ],
)
def test_without_states_events_are_where_an_indicator_changes_its_sign(z, events):
    """To rounding, between two recorded points too."""
    plant = Equations(z=z)
    counted = solved(plant, Grid(0.0, 0.25, 4))["a.y"]
    assert plant.events == pytest.approx(events, abs=1e-15)
    assert counted[-1] == len(events)


def test_the_solver_starts_again_where_a_slope_jumps():
    """By more than 1e-9 of the largest slope of its column; a whole number where it changes."""
    time = np.arange(6.0)

    def breaks(port, *slopes):
        values = np.concatenate([[0.0], np.cumsum(slopes)])
        columns = np.column_stack([np.zeros(6), values, np.full(6, 3.0)])
        driven = {Port("a", "u"): (0, IDENTITY), port: (1, IDENTITY)}
        scenario = Scenario(ScenarioTable(time, columns), driven)
        return module._Recorded(Equations(), scenario, Grid(0.0, 1.0, 5), 1e-10)._breaks()

    u, n = Port("a", "u"), Port("a", "n")
    assert breaks(u, 0.0, 0.0, 0.0, 0.0, 0.0) == [np.inf]
    for scale in (1e-3, 1.0, 1e3):
        more, less = scale * (1 + 1.3e-9), scale * (1 + 0.7e-9)
        assert breaks(u, scale, scale, more, more, 0.0) == [0.0, 2.0, 4.0, np.inf]
        assert breaks(u, scale, scale, less, less, 0.0) == [0.0, 4.0, np.inf]
    assert breaks(n, 0.0, 1.0, 1.0, 2.0, 0.0) == [1.0, 2.0, 3.0, 4.0, np.inf]


@pytest.mark.parametrize("tolerance", [1e-14, 2e-14, 1e-2])
def test_the_limits_of_the_tolerance_are_allowed(fmu, tolerance):
    """And the default is 2e-14."""
    options = {"stop": 1.0, "record_step": 0.1, "set": {"room2.T": 1.0}}
    given = reference(fmu("room", 2), tolerance=tolerance, **options)
    default = reference(fmu("room", 2), **options)
    assert (given["room2.T"].tolist() == default["room2.T"].tolist()) == (tolerance == 2e-14)


@pytest.mark.parametrize("x", [(), (1.0,)], ids=["without states", "with a state"])
@pytest.mark.parametrize("since", [0.0, 0.3, 1.0])
def test_an_indicator_that_is_no_number_is_told(x, since):
    """At once, and not searched for; until then the run goes on."""
    plant = Equations(x, z=lambda t: [1.0, np.nan if t >= since else 2.0])
    plant.indicator_count, plant.slaves = (
        2,
        {"a": SimpleNamespace(interface=SimpleNamespace(event_indicators=2))},
    )
    told = r"^a: event indicator 2: expected a finite value, got nan at t = "
    with pytest.raises(Problem, match=told):
        solved(plant, Grid(0.0, 0.1, 10))
    assert all(t <= since + 0.1 for t in plant.told)
