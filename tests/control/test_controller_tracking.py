"""The tip on line and square, with the built FMUs: errors in space, other machines, lost supply."""

import numpy as np
import pytest
from kit.sensors import opener

from fmus.machine.build import data
from fmus.machine.poses import NOMINAL, POSES
from orchestrator import Trace, read_trace, run

DETAILED = {
    "swing": "detailed",
    "boom_stick": "detailed",
    "manipulator": "pendulum_friction",
    "supply": "engine_pump",
}
TIP = [f"manipulator.tip_{n}" for n in ("x", "y", "height")]
COMMANDS = [f"controller.{n}_command" for n in ("swing", "boom", "stick")]


@pytest.fixture(scope="module")
def machine(fmu_dir):
    """harvester_control.ssp."""
    return fmu_dir / "harvester_control.ssp"


def tracked(machine, path: str, scenario: Trace | None = None, **options) -> tuple[np.ndarray, np.ndarray]:
    """Times and distances in space between the commanded point and the stick end [m]."""
    commanded = scenario or read_trace(data(f"scenarios/{path}.csv"))
    options = {"record": TIP, "record_step": 0.01, "parameters": [path], **options}
    trace = run(machine, commanded, **options).trace
    radius, angle, height = (
        np.interp(trace.time, commanded.time, commanded[f"path_{n}"]) for n in ("radius", "angle", "height")
    )
    there = radius * np.cos(angle), radius * np.sin(angle), height
    apart = [trace[name] - place for name, place in zip(TIP, there, strict=True)]
    return trace.time, np.linalg.norm(apart, axis=0)


def rms(error: np.ndarray) -> float:
    return float(np.sqrt((error**2).mean()))


@pytest.mark.parametrize("path", ["line", "square"])
def test_the_tip_stays_on_its_path(machine, path):
    """At 0.5 m/s below 30 mm and 10 mm RMS; by the feedforward alone five times that and more."""
    _, error = tracked(machine, path)
    assert error[0] < 1e-6  # the run starts on the path
    assert error.max() < 0.030
    assert rms(error) < 0.010
    _, without = tracked(machine, path, set={"controller.feedback": 0.0})
    assert without.max() > 5 * error.max()
    assert rms(without) > 5 * rms(error)


@pytest.mark.parametrize("path", ["line", "square"])
def test_the_same_gains_hold_a_machine_with_all_details(machine, path):
    """Long hoses, spools of 30 Hz, dry friction, a swinging head, an engine: below 60 mm."""
    _, error = tracked(machine, path, swap=DETAILED)
    assert error.max() < 0.060


@pytest.mark.parametrize(
    "changed",
    [
        {"manipulator.head_mass": 300.0},
        {"manipulator.head_mass": 600.0},
        {"supply.pressure_setting": 15e6},
        {"swing.valve_area": 3.2e-5, "boom_stick.valve_area": 3.2e-5},
        {"swing.valve_area": 4.8e-5, "boom_stick.valve_area": 4.8e-5},
        {"boom_stick.boom_hose_capacitance": 2.7e-12, "boom_stick.stick_hose_capacitance": 3.6e-12},
        {"swing.valve_dead_band": 0.5, "boom_stick.valve_dead_band": 0.5},
    ],
    ids=lambda changed: ", ".join(f"{n}={v:g}" for n, v in changed.items()),
)
def test_another_machine_than_assumed(machine, changed):
    """Masses, supply, valves and hoses that the controller does not know: the limits of the usual machine."""
    _, error = tracked(machine, "square", set=changed)
    assert error.max() < 0.030
    assert rms(error) < 0.010


@pytest.mark.parametrize(
    ("swap", "changed", "limit"),
    [
        ({}, {}, 0.030),
        ({}, {"swing.valve_dead_band": 0.5, "boom_stick.valve_dead_band": 0.5}, 0.030),
        (DETAILED, {}, 0.060),
    ],
    ids=["lumped", "dead band of 0.5 V", "detailed"],
)
def test_sampled_and_noisy_the_bars_hold(machine, swap, changed, limit):
    """A computer that looks every 10 ms and answers 10 ms later, encoder counts, noise of 0.1 bar."""
    options = {"swap": swap, "set": changed, "open": opener, "master": "gauss-seidel"}
    _, error = tracked(machine, "square", stop=7.0, step=1e-3, **options)
    assert error.max() < limit
    assert rms(error) < 0.010


def test_the_step_of_the_master_does_not_matter(machine):
    """1 ms and 5 ms: the same path to a tenth of the error."""
    errors = [tracked(machine, "square", step=step)[1] for step in (1e-3, 5e-3)]
    assert np.abs(errors[0] - errors[1]).max() < 0.1 * errors[0].max()


@pytest.mark.parametrize("pose", [*POSES, "line", "square"])
def test_every_pose_is_held(machine, pose):
    """Engaged from the start without a wish: no command leaves the dead band, the tip stays within 2 mm."""
    still = Trace(np.array([0.0, 2.0]), {"controller.engaged": np.ones(2)})
    trace = run(machine, still, parameters=[pose], record=[*TIP, *COMMANDS], stop=2.0).trace
    for name in TIP:
        assert np.ptp(trace[name]) < 2e-3
    for name in COMMANDS:
        assert trace[name][0] == 0
        assert np.abs(trace[name]).max() < 0.8  # V: dead band and half of its rounding


def test_levers_go_straight_through(machine):
    """Not engaged, a lever is the command after the amplifier's lag of 20 ms."""
    time = np.array([0.0, 1.0, 2.0])
    lever = Trace(time, {"controller.boom_lever": np.array([0.0, 2.0, 2.0])})
    trace = run(machine, lever, parameters=[NOMINAL], record=COMMANDS, stop=2.0).trace
    late = np.interp(trace.time - 0.02, time, [0.0, 2.0, 2.0])  # a ramp behind a lag is late by the lag
    np.testing.assert_allclose(trace[COMMANDS[1]][trace.time > 0.2], late[trace.time > 0.2], atol=0.02)
    assert np.ptp(trace[COMMANDS[0]]) == np.ptp(trace[COMMANDS[2]]) == 0


def test_a_lost_supply_is_waited_for_and_made_up_for(machine):
    """3 MPa for 3 s on the line: the tip falls behind, catches up, and goes 20 mm too far at most."""
    usual = read_trace(data("scenarios/line.csv"))
    time = usual.time
    lost = 20.684e6 - 17.684e6 * np.clip(np.minimum((time - 3) / 0.2, (6 - time) / 0.2), 0, 1)
    columns = dict(usual.signals) | {"supply_pressure": lost}
    wanted = Trace(time, columns)
    when, error = tracked(machine, "line", wanted)
    assert error[when < 3].max() < 0.030
    assert 0.050 < error[(when > 5) & (when < 6)].max() < 0.200
    assert error[-1] < 0.010
    angle = run(
        machine, wanted, parameters=["line"], record=["manipulator.swing_angle"], record_step=0.01
    ).trace
    goal = np.interp(angle.time, time, usual["path_angle"])
    out = (angle.time > 6) & (angle.time < 11)  # on the way out: swinging to the left, behind its point
    assert (angle["manipulator.swing_angle"] - goal)[out].max() * 4.2 < 0.020
