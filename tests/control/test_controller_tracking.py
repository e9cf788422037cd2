"""The tip on its path, with the built FMUs: other machines, sensors, lost supply. The bars: test_track.py."""

import numpy as np
import pytest
from kit import shards
from kit.sensors import opener
from kit.steering import IDEAL

from fmus.machine.build import data
from fmus.machine.parts import MACHINES
from fmus.machine.poses import POSES
from orchestrator import Trace, read_trace, run
from orchestrator.base.signals import rms

DETAILED = MACHINES["detailed"]
TIP = [f"manipulator.tip_{n}" for n in ("x", "y", "height")]
ANGLE = "manipulator.swing_angle"
PRESSURE = "supply.supply_pressure"
COMMANDS = [f"controller.{n}_command" for n in ("swing", "boom", "stick")]


def tracked(machine, path: str, scenario: Trace | None = None, **options):
    """Times and distances in space between the commanded point and the stick end [m]; the trace."""
    commanded = scenario or read_trace(data(f"scenarios/{path}.csv"))
    options = {"record": [*TIP, ANGLE], "record_step": 0.01, "parameters": [path], **options}
    trace = run(machine, commanded, **options).trace
    radius, angle, height = (
        np.interp(trace.time, commanded.time, commanded[f"path_{n}"]) for n in ("radius", "angle", "height")
    )
    there = radius * np.cos(angle), radius * np.sin(angle), height
    apart = [trace[name] - place for name, place in zip(TIP, there, strict=True)]
    return trace.time, np.linalg.norm(apart, axis=0), trace


def both(name: str, value: float) -> dict[str, float]:
    """A parameter of both drives."""
    return {f"{part}.{name}": value for part in ("swing", "boom_stick")}


OTHERS = {
    "light head": {"manipulator.head_mass": 300.0},
    "heavy head": {"manipulator.head_mass": 600.0},
    "low supply": {"supply.pressure_setting": 15e6},
    "small valves": both("valve_area", 3.2e-5),
    "large valves": both("valve_area", 4.8e-5),
    "long hoses": {"boom_stick.boom_hose_capacitance": 2.7e-12, "boom_stick.stick_hose_capacitance": 3.6e-12},
    "small dead band": both("valve_dead_band", 0.5),
}


@pytest.mark.parametrize("changed", shards.few(("heavy head", "small valves"), OTHERS, shards.machine))
def test_another_machine_than_assumed(machine, changed):
    """Masses, supply, valves and hoses that the controller does not know: the limits of the usual machine."""
    _, error, _ = tracked(machine, "square", set=OTHERS[changed])
    assert error[0] < 1e-6  # the run starts on the path
    assert error.max() < 0.030
    assert rms(error) < 0.010


COMPENSATED = {"swing": "compensated", "boom_stick": "compensated", "supply": "load_sensing"}
LOADS = [(path, head) for head in (350.0, 500.0, 700.0, 900.0) for path in ("line", "square")]


@pytest.mark.parametrize(("path", "head"), shards.few([("square", 900.0)], LOADS, shards.machine))
def test_a_pump_that_waits_for_a_valve(machine, path, head):
    """Compensated drives from the standby of a load-sensing pump, heads from empty to a heavy stem: 65 mm."""
    given = IDEAL | {"manipulator.head_mass": head}
    options = {"parameters": [path, "compensated"], "swap": COMPENSATED}
    _, error, trace = tracked(machine, path, set=given, record=[*TIP, ANGLE, PRESSURE], **options)
    assert trace[PRESSURE][0] < 25e5  # standby
    assert error.max() < 0.065
    assert rms(error) < 0.010


SAMPLED = {
    "lumped": ({}, {}, 0.030),
    "small dead band": ({}, OTHERS["small dead band"], 0.030),
    "detailed": (DETAILED, {}, 0.060),
}


@pytest.mark.parametrize(("swap", "changed", "limit"), SAMPLED.values(), ids=SAMPLED)
def test_sampled_and_noisy_the_bars_hold(machine, swap, changed, limit):
    """A computer that looks every 10 ms and answers 10 ms later, encoder counts, noise of 0.1 bar."""
    options = {"swap": swap, "set": changed, "open": opener, "master": "gauss-seidel"}
    _, error, _ = tracked(machine, "square", stop=7.0, step=1e-3, **options)
    assert error.max() < limit
    assert rms(error) < 0.010


# true hysteresis, that of the controller at the start, limits of largest error and RMS [m]
PLAYS = {
    "known": (0.04, 0.04, 0.025, 0.010),
    "half of that assumed": (0.02, 0.04, 0.030, 0.010),
    "twice that assumed": (0.08, 0.04, 0.060, 0.020),
}
PLAYED = [(p, k, n) for p in ("line", "square") for k in ("lumped", "detailed") for n in PLAYS]
FEW = [("square", "lumped", "known"), ("square", "lumped", "twice that assumed")]


@pytest.mark.parametrize(("path", "kind", "case"), shards.few(FEW, PLAYED, shards.machine))
def test_hysteresis_is_stepped_over_and_learned(machine, path, kind, case):
    """With sensors. Not compensated, 4 % are 55 mm and more, 8 % 77 mm and more, RMS 21 and 34 mm."""
    true, assumed, most, mean = PLAYS[case]
    given = {"valve_actuation.hysteresis": true, "controller.hysteresis": assumed}
    options = {"set": given, "swap": DETAILED if kind == "detailed" else {}, "step": 1e-3}
    _, error, _ = tracked(machine, path, open=opener, master="gauss-seidel", **options)
    assert error.max() < most
    assert rms(error) < mean


@pytest.mark.parametrize("pose", shards.few(("reach", "square"), [*POSES, "line", "square"], shards.machine))
def test_every_pose_is_held(machine, pose):
    """Engaged from the start without a wish: no command leaves the dead band, the tip stays within 2 mm."""
    still = Trace(np.array([0.0, 2.0]), {"controller.engaged": np.ones(2)})
    trace = run(machine, still, parameters=[pose], record=[*TIP, *COMMANDS], stop=2.0).trace
    for name in TIP:
        assert np.ptp(trace[name]) < 2e-3
    for name in COMMANDS:
        assert trace[name][0] == 0
        assert np.abs(trace[name]).max() < 0.8 + 0.2  # V: dead band, half of its rounding, of the play
