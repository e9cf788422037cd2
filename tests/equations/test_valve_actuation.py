"""Actuation of the valves: the equations of docs/equations.md, section 4.11, the loop of the spool."""

import casadi as ca
import numpy as np
import pytest
from equations.transcription import ramp as r
from hypothesis import given
from hypothesis import strategies as st
from kit.equations import Part

from fmus.valve_actuation import ACTUATION, actuation

PART = Part(ACTUATION)
AXES = ("swing", "boom", "stick")
FULL, LAG = 10.0, PART.p["lag"]


def written(u: float, z: float, t: float, p: dict[str, float]) -> float:
    """Section 4.11: the rate of z."""
    full, w = p["full_command"], p["rounding"]
    u = min(max(u, -full), full)
    v = u + p["dead_band_compensation"] * (1 - abs(u) / full) * u / np.hypot(u, 0.05)
    e = v + p["dither_amplitude"] * np.sin(2 * np.pi * p["dither_frequency"] * t) - z
    gap = p["hysteresis"] * full / 2 - w / 2
    share = (r(e - gap, w) - r(-e - gap, w)) / p["lag"] / p["largest_rate"]
    return p["largest_rate"] * (share - r(share - 0.9, 0.2) + r(-share - 0.9, 0.2))


@given(st.integers(0, 2**32 - 1), st.sampled_from([0.1, 1.0, 15.0]))
def test_the_document_gives_the_actuation(seed, wide):
    """Rates of the states, and rate ports, at any command, state and number; 1e-9: rounding."""
    rng = np.random.default_rng(seed)
    p = {n: rng.uniform(0.5, 2) * (v or 0.3) for n, v in PART.p.items()}
    p["hysteresis"] *= rng.choice([0.0, 1.0])
    u = {n: wide * rng.normal() for n in PART.u}
    x = {n: wide * rng.normal() for n in PART.states}
    dx, y = PART.function(list(x.values()), list(u.values()), list(p.values()))
    rates = dict(zip(PART.states, dx.full()[:, 0], strict=True))
    shown = dict(zip(PART.outputs, y.full()[:, 0], strict=True))
    for axis in AXES:
        name = f"{axis}_valve_command"
        expected = written(u[f"{axis}_command"], x[name], x["clock"], p)
        assert rates[name] == shown[f"{name}_rate"] == pytest.approx(expected, rel=1e-9, abs=1e-9)
        assert shown[name] == x[name]


def _step() -> ca.Function:
    """One step of 1 ms of Runge-Kutta 4: states, boom command at its begin, middle and end, parameters."""
    x, p = ca.SX.sym("x", len(PART.states)), ca.SX.sym("p", len(PART.p))
    boom, k, moved = ca.SX.sym("u", 3), [], x
    for i, ahead in ((0, 0.5), (1, 0.5), (1, 1.0), (2, 0.0)):
        u = [boom[i] if n == "boom_command" else 0 for n in PART.u]
        k.append(PART.function(moved, ca.vertcat(*u), p)[0])
        moved = x + 1e-3 * ahead * k[-1]
    return ca.Function("step", [x, boom, p], [x + 1e-3 / 6 * (k[0] + 2 * k[1] + 2 * k[2] + k[3])])


STEP = _step()


def followed(times, volts, **changed: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times every 1 ms, the command through these points, and what the boom valve gets."""
    time = np.arange(0, times[-1], 1e-3)
    u = np.array([np.interp(time + ahead, times, volts) for ahead in (0, 5e-4, 1e-3)])
    p = ca.repmat(ca.DM(list((PART.p | changed).values())), 1, time.size)
    x = STEP.mapaccum(time.size)(ca.DM.zeros(len(PART.states)), u, p).full()
    return time + 1e-3, u[2], x[PART.at("boom_valve_command")]


@pytest.mark.parametrize("hysteresis", [0.0, 0.002, 0.02, 0.04, 0.08, 0.2])
def test_the_loop_is_as_wide_as_the_hysteresis(hysteresis):
    """4 V up and down at 5 V/s: rising and falling, z is apart from the command by h + lag times 5 V/s."""
    time, u, z = followed([0, 0.8, 2.4, 3.2], [0, 4, -4, 0], hysteresis=hysteresis)
    for at, sign in ((0.75, 1), (2.35, -1)):
        apart = sign * (u - z)[np.searchsorted(time, at)]
        # Runge-Kutta at a fifth of the lag: 1e-5 of the distance
        assert apart == pytest.approx(hysteresis * FULL / 2 + LAG * 5.0, rel=1e-4)


def test_ramp_dither_and_dead_band():
    """A jump becomes a ramp; dither of more than h leaves no hysteresis; the dead band is stepped over."""
    _, _, z = followed([0, 0.3], [8, 8], largest_rate=100.0, hysteresis=0.0)
    assert np.diff(z).max() == pytest.approx(0.1, rel=1e-9)  # 100 V/s in 1 ms
    dither = {"dither_amplitude": 0.6, "dither_frequency": 20.0}
    means = [followed([0, 1, 2], [1 + side, 1, 1], **dither)[2][-500:].mean() for side in (4.0, -4.0)]
    assert np.ptp(means) < 1e-3  # of 0.4 V without dither
    z = followed([0, 0.5], [0.5, 0.5], dead_band_compensation=0.6, hysteresis=0.0)[2]
    assert z[-1] == pytest.approx(0.5 + 0.6 * 0.95 * 0.5 / np.hypot(0.5, 0.05), abs=1e-6)


@pytest.mark.parametrize(
    ("volts", "hertz", "moved"), [(0.25, 1.0, 0.0546), (0.25, 100.0, 0.0067), (0.6, 100.0, 0.0985)]
)
def test_the_lag_damps_a_fast_dither(volts, hertz, moved):
    """The spool moves by what the page says, integrated by hand by 2000 Euler steps in a period."""
    z = followed([0, 3], [0, 0], dither_amplitude=volts, dither_frequency=hertz)[2][-1001:]
    # ten samples in a period miss its peak by 5 % at most
    assert np.ptp(z) / 2 == pytest.approx(moved, rel=0.06)


def test_any_list_of_valves():
    """The valve of a grapple alone: its names follow."""
    own = Part(actuation({"grapple": ("closes the grapple", "grapple")}))
    assert own.states == ["grapple_valve_command", "clock"]
    assert own.inputs == ["grapple_command", "grapple_command_rate"]
    assert [t.name for t in own.sub.terminals] == ["grapple_lever", "grapple_lever_grapple"]
