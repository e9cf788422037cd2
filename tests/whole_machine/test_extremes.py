"""The machine at and beyond its limits: leakage, end stops, poor supply, odd numbers, the work cycle."""

from __future__ import annotations

import numpy as np
import pytest

from fmus.machine.parts import CONNECTIONS, INPUTS, SUBSYSTEMS
from fmus.machine.poses import WORK_SPACE, parameter, pose_grid
from fmus.machine.reference import work_cycle
from fmus.machine.work_cycle import COMMANDS, WORK_CYCLE
from fmus.monolith import join, simulate
from fmus.parameters import values
from orchestrator import Problem
from orchestrator import run as cosimulate

MODEL = join(SUBSYSTEMS, CONNECTIONS, INPUTS)
BOOM_STICK, MANIPULATOR = (values(SUBSYSTEMS[n]).p for n in ("boom_stick", "manipulator"))
SUPPLY = values(SUBSYSTEMS["swing"]).u["supply_pressure"]
FULL_VACUUM = -101325.0  # Pa gauge
ENGINE = 113.3e3  # W: 152 hp, section 2 of the paper


def run(stop, numbers=None, samples=201, **inputs):
    """Outputs by name over [0, stop] s at constant inputs, with changed parameters."""
    u, p = MODEL.u.copy(), MODEL.p.copy()
    for target, names, given in ((u, MODEL.inputs, inputs), (p, MODEL.parameters, numbers)):
        for name, value in (given or {}).items():
            target[names.index(name)] = value
    _, y = simulate(MODEL, np.linspace(0, stop, samples), np.tile(u, (samples, 1)), p, 1e-8)
    return dict(zip(MODEL.output_names, y.T, strict=True))


def at(boom, stick, swing=0.0):
    """The parameters of a pose."""
    angles = {"boom": boom, "stick": stick, "swing": swing}
    return {f"manipulator.{parameter(joint)}": angle for joint, angle in angles.items()}


def chambers(y, joint):
    return [y[f"boom_stick.{joint}_{side}_pressure"] for side in ("head", "rod")]


def leaked(drop, joint):
    """Largest speed [m/s] of a piston whose ports leak under pressure differences of `drop` [Pa] in all."""
    rod = np.pi / 4 * (BOOM_STICK[f"{joint}_bore"] ** 2 - BOOM_STICK[f"{joint}_rod"] ** 2)
    return BOOM_STICK["valve_leakage"] * drop / rod


@pytest.mark.parametrize("pose", list(pose_grid(3)))
def test_a_held_arm_sinks_as_its_leakage_says(pose):
    """In 5 s with closed valves each piston moves by what leaks into its chambers, no more, no less.

    At constant force: x' = (q_h A_h/C_h - q_r A_r/C_r) / (A_h^2/C_h + A_r^2/C_r), q = G_l (P_s - 2 P).
    """
    y = run(5.0, at(*pose))
    for joint in ("boom", "stick"):
        p = {n.removeprefix(f"{joint}_"): v for n, v in BOOM_STICK.items()}
        x, beta = y[f"manipulator.{joint}_position"], p["bulk_modulus"]
        head = np.pi / 4 * p["bore"] ** 2
        rod = head - np.pi / 4 * p["rod"] ** 2
        c_head = p["hose_capacitance"] + (p["dead_volume"] + head * x[0]) / beta
        c_rod = p["hose_capacitance"] + (p["dead_volume"] + rod * (p["stroke"] - x[0])) / beta
        q_head, q_rod = (p["valve_leakage"] * (SUPPLY - 2 * np.mean(c)) for c in chambers(y, joint))
        speed = (q_head * head / c_head - q_rod * rod / c_rod) / (head**2 / c_head + rod**2 / c_rod)
        # the load's change along 0.1 mm, and what still rings: 1 % of the 0.2 mm that full leakage would give
        assert x[-1] - x[0] == pytest.approx(5.0 * speed, rel=0.02, abs=2e-6)


def test_without_leakage_a_held_arm_stands():
    """The motion of a held arm is leakage alone: with none to speak of, it stands to a micrometre."""
    y = run(5.0, at(0.5, -1.8) | {"boom_stick.valve_leakage": 1e-17, "swing.valve_leakage": 1e-17})
    for joint in ("boom", "stick"):
        # 1e-17 m3/(s.Pa) is 1/1600 of the nominal leakage, which moves at most 0.22 mm
        assert np.ptp(y[f"manipulator.{joint}_position"]) < 5e-7


@pytest.mark.parametrize("tank", [5e5, 2e6])
def test_a_tank_under_pressure_is_part_of_the_consistent_start(tank):
    """With back pressure in the return line the arm still stands at the start and holds."""
    y = run(2.0, tank_pressure=tank)
    for joint in ("swing", "boom", "stick"):
        # exact identity of forces of 1e5 N on 1e3 kg.m2
        assert abs(y[f"manipulator.{joint}_acceleration"][0]) < 1e-9
    assert min(c.min() for joint in ("boom", "stick") for c in chambers(y, joint)) > 0.5 * tank
    assert np.ptp(y["manipulator.boom_position"]) < 2.0 * leaked(SUPPLY, "boom")


@pytest.mark.parametrize(("joint", "stroke"), [("boom", "boom_stroke"), ("stick", "stick_stroke")])
@pytest.mark.parametrize("command", [10.0, -10.0])
def test_full_command_into_an_end_stop(joint, stroke, command):
    """At full speed a piston goes at most 2 % of its stroke beyond its end, stays there, and says so."""
    y = run(6.0, at(0.2, -1.4), samples=3001, **{f"{joint}_command": command})
    length, x = MANIPULATOR[stroke], y[f"manipulator.{joint}_position"]
    force = y[f"manipulator.{joint}_stop_force"]
    beyond = x - length if command > 0 else -x
    # the FMU refuses to go on at 5 %
    assert 1e-3 < beyond.max() < 0.02 * length
    assert np.all(force * np.sign(command) <= 0)
    assert abs(force[-1]) > 1e4
    # m/s, over the last second: the joint that is not driven still rings and shakes this one
    assert abs(y[f"manipulator.{joint}_velocity"][-500:]).max() < 0.02
    assert min(c.min() for c in chambers(y, joint)) > FULL_VACUUM
    assert max(c.max() for c in chambers(y, joint)) < 1.5 * SUPPLY


def test_a_supply_below_the_load_lets_the_arm_sink():
    """No check valve holds the load (the paper has none): opened upwards at 5 MPa the boom sinks."""
    y = run(2.0, supply_pressure=5e6, boom_command=3.0)
    assert y["manipulator.boom_velocity"][-1] < -0.01
    assert y["boom_stick.supply_flow"][-1] < 0  # into the supply
    assert chambers(y, "boom")[0][0] > 5e6  # the load is above the supply
    assert min(c.min() for c in chambers(y, "boom")) > FULL_VACUUM


def test_without_supply_the_closed_valves_still_hold():
    """The engine off: the arm stands but for its leakage."""
    y = run(5.0, supply_pressure=0.0)
    for joint in ("boom", "stick"):
        # both edges of a port leak to zero pressure
        highest = max(c.max() for c in chambers(y, joint))
        assert np.ptp(y[f"manipulator.{joint}_position"]) < 5.0 * leaked(2 * highest, joint)


def test_reversing_at_full_speed_stays_bounded():
    """All three commands from +6 to -6 V within 20 ms: no tension, no more than three times the supply."""
    time = np.linspace(0, 2.0, 401)
    u = np.tile(MODEL.u, (time.size, 1))
    for name in COMMANDS:
        u[:, MODEL.inputs.index(name)] = np.interp(time, [0.0, 0.3, 0.8, 0.82], [0.0, 6.0, 6.0, -6.0])
    _, rows = simulate(MODEL, time, u, tolerance=1e-8)
    y = dict(zip(MODEL.output_names, rows.T, strict=True))
    pressures = [v for n, v in y.items() if n.endswith(("_pressure", "pressure_a", "pressure_b"))]
    assert min(p.min() for p in pressures) > FULL_VACUUM
    assert max(p.max() for p in pressures) < 3 * SUPPLY
    for joint, way in (("swing", -1), ("boom", -1), ("stick", 1)):
        assert way * y[f"manipulator.{joint}_speed"][-1] > 0.1


ODD = {
    "no head": {"manipulator.head_mass": 1e-3},
    "upper case of the hose resistance": {
        f"boom_stick.{j}_hose_resistance": 3.1e11 for j in ("boom", "stick")
    },
    "soft oil": {"boom_stick.bulk_modulus": 2e8},
    # not 0, which stands for the capacitance that follows from length and bore
    "no hoses": {f"boom_stick.{j}_hose_capacitance": 1e-18 for j in ("boom", "stick")},
    "no line resistance": {"swing.line_resistance": 1.0},
    "sharp edges": {f"{c}.valve_transition_flow": 1e-8 for c in ("swing", "boom_stick")},
    "no friction": {n: 0.0 for n in MODEL.parameters if n.endswith("_damping") and "stop" not in n},
}


@pytest.mark.parametrize("numbers", ODD.values(), ids=ODD)
def test_odd_numbers_still_give_a_machine(numbers):
    """At the edges of the plausible the machine moves the way it is told, at about the usual speeds."""
    told = {name: 4.0 for name in COMMANDS}
    y, usual = run(1.5, numbers=numbers, **told), run(1.5, **told)
    assert all(np.all(np.isfinite(v)) for v in y.values())
    for name in ("swing_speed", "boom_velocity", "stick_velocity"):
        # the valves' C_R of 6e12 at 4 V rules the speed, none of these numbers does
        assert y[f"manipulator.{name}"][-1] == pytest.approx(usual[f"manipulator.{name}"][-1], rel=0.15)


def test_a_head_too_heavy_to_lift_is_not_lifted():
    """With 3 t at the stick end the holding pressure is above the supply: the boom sinks at full command."""
    y = run(1.5, at(0.0, -0.7) | {"manipulator.head_mass": 3000.0}, boom_command=10.0)
    assert chambers(y, "boom")[0][0] > SUPPLY
    assert y["manipulator.boom_velocity"][-1] < 0


@pytest.fixture(scope="module")
def cycle():
    """Time (n,) and outputs by name of the shipped work cycle."""
    time, commands = work_cycle()
    u = np.tile(MODEL.u, (time.size, 1))
    u[:, [MODEL.inputs.index(n) for n in COMMANDS]] = commands
    _, y = simulate(MODEL, time, u, tolerance=1e-6)
    return time, dict(zip(MODEL.output_names, y.T, strict=True))


def test_the_work_cycle_is_one_that_the_engine_can_drive(cycle):
    """Flow times supply pressure stays below the engine's power, with overlapping functions."""
    _, y = cycle
    flow = y["swing.supply_flow"] + y["boom_stick.supply_flow"]
    assert 0.5 * ENGINE < SUPPLY * flow.max() < 0.8 * ENGINE  # efficiency of the pumps, other consumers
    assert flow.min() > 0  # never back into the pumps


def test_the_work_cycle_stays_where_the_model_is_valid(cycle):
    """Inside the work space, off the end stops, no cavitation, pressures below supply."""
    _, y = cycle
    for name, (low, high) in WORK_SPACE.items():
        assert low < y[f"manipulator.{name}"].min() < y[f"manipulator.{name}"].max() < high
    for joint in ("boom", "stick"):
        assert not np.any(y[f"manipulator.{joint}_stop_force"])
        assert y[f"boom_stick.{joint}_void_volume"].max() < 1e-7  # where the FMU would warn
        assert max(c.max() for c in chambers(y, joint)) < SUPPLY
    assert y["swing.swing_void_volume"].max() < 1e-7


def test_the_work_cycle_moves_like_a_harvester(cycle):
    """Speeds of a crane of this class: tip below 4 m/s, swing below 1 rad/s, ramps of 0.3 s and more."""
    time, y = cycle
    tip = np.hypot(
        np.hypot(y["manipulator.tip_radial_velocity"], y["manipulator.tip_vertical_velocity"]),
        y["manipulator.tip_radius"] * y["manipulator.swing_speed"],
    )
    assert 3.0 < tip.max() < 4.0
    assert 0.5 < abs(y["manipulator.swing_speed"]).max() < 1.0
    assert min(min(m.rise, m.fall) for m in WORK_CYCLE) >= 0.3
    active = np.abs(work_cycle()[1]) > BOOM_STICK["valve_dead_band"]
    assert 30.0 <= time[-1] <= 60.0
    assert np.mean(active.sum(axis=1) >= 2) > 0.3  # two or three functions at once for a third of the time


def test_a_violated_requirement_is_told_rather_than_the_nan_that_it_causes(fmu_dir):
    """Full command within the dead band divides by zero: the first value asked for names the reason."""
    with pytest.raises(Problem, match='"valve_full_command exceeds valve_dead_band" is violated at t = 0 s'):
        cosimulate(fmu_dir / "harvester.ssp", stop=0.01, set={"swing.valve_full_command": 0.1})
