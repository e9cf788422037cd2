"""An overloaded engine stalls, says so, stays at rest, never turns backwards; a torque limit prevents it."""

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from kit.properties import examples
from kit.supply_bench import L_MIN, Bench, Load
from scipy.optimize import brentq

from orchestrator import Trace, run

BENCHES = [Bench(name) for name in ("engine_pump", "load_sensing")]
supplies = pytest.mark.parametrize("bench", BENCHES, ids=lambda b: b.sub.variant)
RPM = np.pi / 30  # rad/s
IDLE, STALL = 800 * RPM, 600 * RPM
# of the engine, besides its speed and fuel
REST = {"tank_pressure": 4e5, "oil_temperature": 333.15, "reservoir_volume": 0.2}
PRESSURES = st.lists(st.floats(-1e5, 3e7), min_size=3, max_size=3)
STROKES = st.lists(st.floats(0.0, 1.0), min_size=2, max_size=2)
ROWS = st.lists(st.tuples(st.integers(100, 900), st.floats(0.0, 1.9e7)), min_size=1, max_size=2)


def torques(speed: float, rated: float) -> tuple[float, float]:
    """Torque at the shaft at full fuel that burns, and friction of the engine, as in the pages."""
    net = 1 + 0.25 * (1 - ((speed - 157.0796) / (261.7994 - 157.0796)) ** 2)
    return rated * net, 40 * speed / np.hypot(speed, 1) + 0.17 * speed


def pulled(bench: Bench, speed: float, rated: float) -> float:
    """Net torque at full fuel, from the acceleration without pressure and the drag of the pumps."""
    p = bench.constants(engine_rated_torque=rated)
    fuel = sum(torques(speed, rated))
    x = bench.state((0.0, 0.0, 0.0), engine_speed=speed, engine_fuel_torque=fuel, **REST)
    y = bench.show(x, bench.row(), p)
    return bench.rates(x, bench.row(), p)["engine_speed"] * bench.p["engine_inertia"] + y["engine_load"]


@supplies
@pytest.mark.parametrize(("rated", "zero"), [(433.0, 649.4), (60.0, 694.1)])
def test_the_net_torque_falls_to_zero_between_idle_and_stall(bench, rated, zero):
    """The parabola from 800 rpm on, half of the fuel at 700, none at 600; zero where the pages say."""
    for rpm, share in ((2500, 1.0), (1500, 1.0), (801, 1.0), (700, 0.5), (599, 0.0), (1, 0.0)):
        net, friction = torques(rpm * RPM, rated)
        # 800, 600 rpm have six digits in parameters.toml, the steepest slope is 1.9 per 200 rpm
        expected = pytest.approx(share * (net + friction) - friction, abs=1e-5 * (rated + friction))
        assert pulled(bench, rpm * RPM, rated) == expected
    found = brentq(lambda w: pulled(bench, w, rated), 610 * RPM, 790 * RPM) / RPM
    assert found == pytest.approx(zero, abs=0.1)  # four digits, of which the pages have three


@supplies
@given(st.floats(0.0, STALL), st.floats(0.0, 600.0), PRESSURES, STROKES)
def test_at_stall_speed_and_below_nothing_drives_the_engine(bench, speed, fuel, pressures, strokes):
    """Whatever governor, stroke and pressure behind a check valve: slower until 0, and there no torque."""
    for w, signs in ((speed, (-1, 0)), (0.0, (0,)), (-0.1, (1,))):
        x = bench.state(pressures, strokes, engine_speed=w, engine_fuel_torque=fuel, **REST)
        assert np.sign(bench.rates(x, bench.row(), bench.constants())["engine_speed"]) in signs
        y = bench.show(x, bench.row(), bench.constants())
        assert (y["engine_torque"], y["engine_power"]) == (0, 0)


@supplies
@examples(8)
@given(ROWS, st.floats(60.0, 300.0))
def test_a_stalled_engine_stays_stalled(bench, rows, rated):
    """Any row of loads, then none: from the stall speed on it slows down to 0, and stays there."""
    loads = [Load(q * L_MIN / 1e3, load) for q, load in rows] + [Load(0.0)] * 2
    p = bench.constants(engine_rated_torque=rated)
    _, y = bench.through(loads, p, 3.0, 10)
    speed = y["engine_speed"]
    assert speed.min() > -1e-6  # absolute tolerance of the integrator, 1e-10 of 100 rad/s, over its steps
    if speed.min() < STALL:
        stalled = speed[np.argmax(speed < STALL) :]
        assert np.all(np.diff(stalled) < 1e-6)
        assert stalled[-1] < 1e-6  # after 6 s; the slowest coasting takes 2 s
    else:
        assert speed[-1] > IDLE  # on its way back; 60 N.m take longer than 6 s


@pytest.mark.parametrize(("limit", "runs"), [(385.0, False), (250.0, True), (100.0, True)])
def test_a_torque_limit_keeps_a_weak_engine_from_stalling(limit, runs):
    """250 N.m, 312 at 1500 rpm: less than 385 and the friction of the pump, more than 250 with it."""
    bench = BENCHES[1]
    y = bench.settled(Load(700 * L_MIN / 1e3, 1.7e7), engine_rated_torque=250.0, torque_limit=limit)
    assert (y["engine_speed"] > IDLE, y["engine_torque"] > 0) == (runs, runs)
    if runs:
        friction = 0.04 * bench.p["main_pump_displacement"] * y["pump_pressure"] + 0.06 * y["engine_speed"]
        # the rounding of the lowest stroke, and what is left of the transient
        assert y["engine_load"] == pytest.approx(limit + friction, rel=1e-3)


@supplies
def test_the_card_tells_when_the_engine_stalled(system, bench):
    """Below idle, then stalled: one warning each, with the time at which the speed crossed the limit."""
    full = {"boom_command": 10.0, "stick_command": -10.0, "swing_command": 10.0}
    levers = {name: np.array([0.0, end, end]) for name, end in full.items()}
    swap, weak = {"supply": bench.sub.variant}, {"supply.engine_rated_torque": 60.0}
    done = run(system, Trace(np.array([0, 0.2, 3.0]), levers), swap=swap, set=weak, step=2e-3, stop=3.0)
    speed, time = done.trace["supply.engine_speed"], done.trace.time
    assert speed.min() >= 0
    words = ("is overloaded", IDLE), ("has stalled and does not start again", STALL)
    for name, (word, limit) in zip(("idle", "stall"), words, strict=True):
        (line,) = (w for w in done.card.warnings if f"engine_speed_below_{name} = " in w)
        pattern = rf"supply: the engine {word} at t = (\S+) s: \S+ = (\S+) rpm \(limit 0 rpm\), at most"
        found = re.match(pattern, line)
        crossed, at = np.argmax(speed < limit), float(found[1])
        assert time[crossed - 1] < at <= time[crossed]  # a row, or within a step that was divided
        # curvature within a step, and four digits of at most 1 rad/s
        assert float(found[2]) * RPM == pytest.approx(limit - np.interp(at, time, speed), abs=2e-3)
