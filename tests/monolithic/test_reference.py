"""The monolithic solution of systems of FMUs: events, algebraic loops, mixed versions, the machine."""

from __future__ import annotations

from functools import partial
from itertools import product
from math import exp, inf, log, sqrt

import numpy as np
import pytest

from monolithic.hybrid import build
from orchestrator.base.errors import Problem
from orchestrator.monolithic.reference import reference
from orchestrator.ssp.assembly import assemble

VERSIONS = (2, 3)
MIXED = list(product(VERSIONS, VERSIONS))


@pytest.fixture
def fmu(once):
    """fmu("ball", 3): a model of hybrid.c, compiled once for all test processes."""

    def made(model: str, version: int):
        folder = once(f"hybrid-{model}{version}", partial(build, model=model, version=version))
        return folder / f"{model}{version}.fmu"

    return made


# ---- events


def height(t: float, e: float = 0.7, g: float = 9.81) -> float:
    """Height of the ball at t, from flight to flight."""
    begin, h, v = 0.0, 1.0, 0.0
    while True:
        flight = (v + sqrt(v * v + 2 * g * h)) / g
        if begin + flight > t:
            return h + v * (t - begin) - g * (t - begin) ** 2 / 2
        begin, h, v = begin + flight, 0.0, e * (g * flight - v)
        if v < 0.7 * 0.01:
            return 0.0


@pytest.mark.parametrize("version", VERSIONS)
def test_a_ball_bounces_at_the_right_times(fmu, version):
    """Until it rests after 19 impacts the height is that of the closed form."""
    result = reference(fmu("ball", version), stop=3.0, record_step=0.01, tolerance=1e-11)
    exact = [height(t) for t in result.trace.time]
    # an event time is off by 1e-11 s; the error of the solver is of the order of its tolerance
    assert np.abs(result[f"ball{version}.h"] - exact).max() < 1e-9
    assert result[f"ball{version}.h"][-1] == result[f"ball{version}.v"][-1] == 0.0
    assert "19 events" in result.card.notes[-1]


@pytest.mark.parametrize("version", VERSIONS)
def test_a_time_event_is_at_its_time(fmu, version):
    """A discrete output changes at the event, and a recorded point there has the value after it."""
    count = reference(fmu("counter", version), stop=3.5, record_step=0.5)[f"counter{version}.count"]
    assert count.tolist() == [0, 0, 1, 1, 2, 2, 3, 3]


@pytest.mark.parametrize("version", VERSIONS)
def test_an_fmu_may_end_the_simulation(fmu, version):
    """The trace ends at the event, and a note names the FMU."""
    name = f"counter{version}"
    result = reference(fmu("counter", version), stop=9.0, record_step=0.5, set={f"{name}.last": 2})
    assert result.trace.time[-1] == 2.0
    assert f"{name} requested the end of the simulation" in result.card.notes


@pytest.mark.parametrize(("of_room", "of_thermo"), MIXED)
def test_discrete_signals_reach_other_fmus_in_event_mode(fmu, of_room, of_thermo):
    """A thermostat heats a room: T rises to 0.6, then moves between 0.4 and 0.6 on exponentials."""
    fmus = {"room": fmu("room", of_room), "thermo": fmu("thermo", of_thermo)}
    system = assemble(fmus, ["room.T -> thermo.y", "thermo.on -> room.on"], exchange=True)
    result = reference(system, stop=3.0, record_step=0.01)
    first, half = -log(0.4), log(1.5)

    def exact(t: float) -> float:
        s = (t - first) % (2 * half)
        if t < first:
            return 1 - exp(-t)
        return 0.6 * exp(-s) if s < half else 1 - 0.6 * exp(half - s)

    # the thermostat switches 1e-9 beside its thresholds
    assert np.abs(result["room.T"] - [exact(t) for t in result.trace.time]).max() < 1e-8


# ---- algebraic loops


@pytest.mark.parametrize(("of_a", "of_b"), MIXED)
@pytest.mark.parametrize("cubic", [0.0, 0.3])
def test_a_loop_is_solved(fmu, of_a, of_b, cubic):
    """u = 1 - 2 (3 u + b u^3): its gain of 6 would make repeated substitution diverge."""
    fmus = {"a": fmu("gain", of_a), "b": fmu("gain", of_b), "ball": fmu("ball", 2)}
    wires = [("a.y", "b.u"), ("b.y", "a.u", -1.0, 1.0)]
    start = {"a.a": 3.0, "a.b": cubic, "b.a": 2.0}
    u = reference(assemble(fmus, wires, start, exchange=True), stop=1.0, record_step=0.5)["a.u"]
    assert u == pytest.approx(1 - 2 * (3 * u + cubic * u**3), rel=1e-12)


def test_a_loop_without_solution_is_told(fmu):
    """u = u + 1."""
    fmus = {"a": fmu("gain", 2), "ball": fmu("ball", 2)}
    system = assemble(fmus, [("a.y", "a.u", 1.0, 1.0)], {"a.a": 1.0}, exchange=True)
    with pytest.raises(Problem, match="loop"):
        reference(system, stop=1.0)


# ---- mistakes


@pytest.mark.parametrize("tolerance", [0.0, 1e-20, 1.0, inf])
def test_a_tolerance_out_of_range_is_refused(fmu, tolerance):
    """Below rounding, or so large that it is no reference."""
    with pytest.raises(Problem, match=r"tolerance .*: expected 1e-14 to 1e-2"):
        reference(fmu("ball", 2), tolerance=tolerance)


# ---- the machine

STROKE = np.array([0.0, 0.0, 1.0, 1.0, 0.0, 0.0])
VOLTS = {"swing_command": 1.5, "boom_command": 2.0, "stick_command": -1.5}
CYCLE = {"time": [0.0, 0.5, 0.8, 1.4, 1.6, 3.0], **{name: volts * STROKE for name, volts in VOLTS.items()}}


def largest(a, b, names):
    """Largest difference of two traces over the range of each signal."""
    ranges = {n: float(np.ptp(b[n])) for n in names}
    return max(
        float(np.abs(a[n] - b[n]).max()) / r for n, r in ranges.items() if r > 1e-6 * np.abs(b[n]).max() > 0
    )


def test_the_machine_in_parts_is_the_machine_in_one_block(fmu_dir, fmi3_dir):
    """Five FMUs joined by their connections, in FMI 2.0 and 3.0, against the FMU with all equations."""
    options = {"stop": 3.0, "record_step": 0.01}
    whole = reference(fmu_dir / "harvester.fmu", CYCLE, **options)
    for folder in (fmu_dir, fmi3_dir):
        parts = reference(folder / "harvester.ssp", CYCLE, **options)
        bare = [n.rpartition(".")[2] for n in parts.trace.signals]
        names = dict(zip(bare, parts.trace.signals, strict=True))
        # of a name in several parts, such as an energy, the whole has the sum
        common = [n for n in names if f"harvester.{n}" in whole.trace.signals and bare.count(n) == 1]
        assert len(common) > 40
        of_whole = {n: whole[f"harvester.{n}"] for n in common}
        of_parts = {n: parts[names[n]] for n in common}
        # the same equations, other rounding and other steps: measured 1.2e-10
        assert largest(of_parts, of_whole, common) < 1e-9
