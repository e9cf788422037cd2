"""Robustness of the controller against operators and faults: bounded commands, the machine comes to rest."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from kit import shards
from kit.steering import IDEAL, INPUTS, PART, STATES, measured, rates

from fmus.controller.harvester import ARM
from fmus.machine.build import data
from fmus.machine.poses import NOMINAL
from orchestrator import Trace, read_trace, run

FULL = 10.0  # V, valve_full_command
AXES = [a.name for a in ARM.axes]
COMMANDS = [f"controller.{n}_command" for n in AXES]
TIP = [f"manipulator.tip_{n}" for n in ("x", "y", "height")]
SHOWN = [*COMMANDS, *TIP, "manipulator.boom_speed", "controller.tip_error"]


def driven(machine, time, pose=NOMINAL, start=None, **inputs) -> Trace:
    """A run from a pose with inputs of the controller, or of all (`supply_pressure`), over time."""
    names = {n: n if n == "supply_pressure" else f"controller.{n}" for n in inputs}
    signals = {names[n]: np.broadcast_to(np.asarray(v, float), len(time)) for n, v in inputs.items()}
    wanted = Trace(np.asarray(time, float), {n: np.array(v) for n, v in signals.items()})
    trace = run(machine, wanted, parameters=[pose], record=SHOWN, record_step=0.01, set=start or {}).trace
    for name in COMMANDS:
        assert np.abs(trace[name]).max() <= FULL * (1 + 1e-6), name  # the foot of the curve is rounded
    return trace


def resting(trace: Trace, within: float = 5e-3) -> None:
    """In the last second the tip moves by less than `within` [m] in each direction."""
    last = trace.time > trace.time[-1] - 1
    for name in TIP:
        assert np.ptp(trace[name][last]) < within, name


# ---- any input


@given(st.integers(0, 2**32 - 1), st.integers(0, 12))
def test_whatever_comes_in_the_rates_are_finite_and_commands_stay_within_the_valve(seed, size):
    """Inputs up to 1e12: every rate is finite, and a command at the end of its range does not go beyond."""
    rng = np.random.default_rng(seed)
    u = measured(rng.uniform(-0.4, 0.95), rng.uniform(-2.1, -0.6))
    u |= {n: rng.normal() * 10.0**size for n in rng.choice(INPUTS, 6)}
    x = PART.start(u)
    for sign in (-1, 1):
        for axis in AXES:
            x[STATES.index(f"{axis}_spool")] = sign * FULL * (1 + 1e-6)
        dx = rates(x, u)
        assert np.isfinite(dx).all()
        for axis in AXES:
            assert sign * dx[STATES.index(f"{axis}_spool")] <= 0, axis


@pytest.mark.parametrize("axis", ["boom", "stick"])
def test_an_angle_that_passes_dead_centres_does_not_stop_the_solver(axis):
    """The rate of the load stays below 1e7 N/s at every angle that a broken sensor can read."""
    u = measured(0.3, -1.2) | {"boom_speed": 0.2, "engaged": 0.0}
    x, most = PART.start(u), 0.0
    x[STATES.index("stick_load")] *= 1.5
    for q in np.arange(-np.pi, np.pi, 4e-3):
        x[STATES.index(f"reference_{axis}")] = q
        most = max(most, abs(rates(x, u | {f"{axis}_angle": q})[STATES.index(f"{axis}_load")]))
    # M a/lever: 1e9 to 1e11 N/s if the lever is not bounded; bounded, a tonne at the tip makes 8e5 N/s
    assert most < 1e7


# ---- reach and paths

RISE = [0.0, 1.0, 1.5, 12.0]


BEYOND = [(0.5, 0.0), (-0.5, 0.0), (0.0, -0.5), (3.0, 3.0), (1e6, 0.0)]  # m/s


@pytest.mark.parametrize(("out", "up"), shards.few(BEYOND[:2] + BEYOND[4:], BEYOND, shards.machine))
def test_beyond_the_reach_the_arm_comes_to_rest(machine, out, up):
    """A joystick held for ten seconds, outwards, into the column, down, too fast: it comes to rest."""
    wanted = {"radial_velocity": [0, 0, out, out], "vertical_velocity": [0, 0, up, up]}
    trace = driven(machine, RISE, engaged=1, **wanted)
    resting(trace)
    assert trace["controller.tip_error"][-1] < 0.005


def moved(**by: tuple[float, float]) -> dict[str, np.ndarray]:
    """The square with columns that become `factor * value + offset` after 3 s."""
    square = read_trace(data("scenarios/square.csv"))
    late = square.time > 3
    new = {n: np.where(late, factor * square[n] + offset, square[n]) for n, (factor, offset) in by.items()}
    return {"time": square.time, **square.signals, **new}


JUMPS = {
    "by 0.5 m": {"path_height": (1, 0.5)},
    "out of reach": {"path_radius": (1, 3.0)},
    "into the column": {"path_radius": (0, 0.5), "path_height": (0, -3.0)},
    "a turn away": {"path_angle": (1, 2 * np.pi)},
}


@pytest.mark.parametrize("jump", shards.few(("out of reach", "a turn away"), JUMPS, shards.machine))
def test_a_path_that_jumps_is_approached_calmly(machine, jump):
    """Reference and tip move to the path at the limited speed, as far as the strokes allow."""
    by = JUMPS[jump]
    trace = driven(machine, pose="square", **moved(**by))
    assert trace["controller.tip_error"].max() < 0.060
    if "path_angle" not in by:  # a whole turn takes a minute
        resting(trace, 0.03)  # it comes to the end of a stroke exponentially, with 2 1/s


def test_the_swing_goes_on_past_half_a_turn(machine):
    """0.4 rad/s for ten seconds: no jump of the reference or the command at 180 degrees."""
    trace = driven(machine, [0, 1, 2, 12], start=IDEAL, engaged=1, swing_velocity=[0, 0, 0.4, 0.4])
    angle = np.unwrap(np.arctan2(trace[TIP[1]], trace[TIP[0]]))
    assert angle[-1] > 3.6
    late = trace.time > 6
    assert np.ptp(trace[COMMANDS[0]][late]) < 0.1
    assert trace["controller.tip_error"][late].max() < 0.005


# ---- faults


@pytest.mark.parametrize("pressure", shards.few([3e6], [0.0, 3e6, 8e6], shards.machine))
def test_without_supply_the_arm_stays_up(machine, pressure):
    """Lost while the path goes up: the valve closes, for open it would let the arm sink; then it goes on."""
    square = read_trace(data("scenarios/square.csv"))
    gone = np.clip(np.minimum((square.time - 5.5) / 0.1, (8.5 - square.time) / 0.1), 0, 1)
    supply = 20.684e6 + gone * (pressure - 20.684e6)
    trace = driven(machine, square.time, "square", supply_pressure=supply, **square.signals)
    assert trace[TIP[2]].min() > square["path_height"].min() - 0.05
    # its speed on the side, and the position gain times the error at which the reference waits
    assert np.abs(trace["manipulator.boom_speed"]).max() < 0.36
    assert trace["controller.tip_error"][-1] < 0.005  # back on the path


def test_engaging_at_full_swing_brings_the_arm_to_rest(machine):
    """1.1 rad/s and the boom rising, then engaged with the joystick at rest: it stops and stays.

    The valve crosses its dead band late: the arm still swings on its oil by 3 mm in the sixth second.
    """
    levers = {"boom_lever": [0, 0, 4, 4, 4, 4], "swing_lever": [0, 0, 5, 5, 5, 5]}
    resting(driven(machine, [0, 0.5, 1, 2, 2.001, 13], engaged=[0, 0, 0, 0, 1, 1], **levers))
