"""The payload of the head: weight, pick-up, drop, program of the operator, work cycle with stems."""

from __future__ import annotations

import math

import casadi as ca
import numpy as np
import pytest
from kit import shards
from kit.equations import Part, machine, played, work_cycle
from kit.fmu import driving
from scipy.integrate import solve_ivp

from fmus.machine.poses import pose_grid
from fmus.machine.work_cycle import STEMS, WITH_STEMS, payload
from fmus.manipulator import VARIANTS
from fmus.parameters import values
from orchestrator import run

HEADS = [v for v in VARIANTS if v.startswith("pendulum")]


def arm_of(name, **changed):
    """A variant's equations without any force, with changed parameters."""
    arm = Part(VARIANTS[name], **changed)
    arm.u = dict.fromkeys(arm.u, 0.0)
    return arm


def free(name):
    """A variant without gravity and friction, so that only the payload changes its momentum."""
    p = values(VARIANTS[name]).p
    zero = [n for n in p if n.endswith(("damping", "coulomb", "stop_stiffness"))]
    return arm_of(name, gravity=0.0, **dict.fromkeys(zero, 0.0))


def triangle(p, joint, angle):
    """Moment arm [m] of a cylinder: the pivot's distance from the line through its pins."""
    base = complex(p[f"{joint}_base_x"], p[f"{joint}_base_z"])
    rod = complex(p[f"{joint}_pin_x"], p[f"{joint}_pin_z"]) * np.exp(1j * angle)
    return (base.conjugate() * (rod - base)).imag / abs(rod - base)


def lever_arms(p, boom, stick):
    """Horizontal distances [m] of the tip from boom pivot and elbow, written out here."""
    out = (complex(p["stick_pivot_x"], p["stick_pivot_z"]) * np.exp(1j * boom)).real
    return out + p["stick_length"] * math.cos(boom + stick), p["stick_length"] * math.cos(boom + stick)


# ---- weight


@pytest.mark.parametrize("name", VARIANTS)
def test_holding_forces_carry_the_payload(name):
    """m g r / J more than without, r the tip's distance from the joint: also below a head that hangs."""
    arm, mass = arm_of(name), 300.0
    for boom, stick in pose_grid(4):
        arm.p |= {"initial_boom_angle": boom, "initial_stick_angle": stick}
        loaded, empty = (arm(arm.start({"payload_mass": m}))[1] for m in (mass, 0.0))
        for joint, angle, out in zip(
            ("boom", "stick"), (boom, stick), lever_arms(arm.p, boom, stick), strict=True
        ):
            expected = mass * arm.p["gravity"] * out / triangle(arm.p, joint, angle)
            found = loaded[f"{joint}_holding_force"] - empty[f"{joint}_holding_force"]
            # exact identity; rounding of forces of 1e5 N
            assert found == pytest.approx(expected, rel=1e-9, abs=1e-7)


def test_fmu_holds_the_payload_with_pressure(fmu_dir):
    """harvester.fmu with a payload from the start: cylinder force m g r / J higher, and nothing moves."""
    mass, found = 400.0, []
    for load in (0.0, mass):
        with driving(fmu_dir / "harvester.fmu", payload_mass=load) as harvester:
            start = harvester.get("boom_force", "boom_head_pressure", "boom_rod_pressure", "held_mass")
            harvester.step(1e-3, 500)
            found.append((*start, *harvester.get("boom_speed", "boom_angle", "stick_angle")))
    empty, loaded = found
    p = arm_of("rigid").p
    rise = mass * p["gravity"] * lever_arms(p, p["initial_boom_angle"], p["initial_stick_angle"])[0]
    rise /= triangle(p, "boom", p["initial_boom_angle"])
    # exact identity; initial pressures to rounding of 1e7 Pa
    assert loaded[0] - empty[0] == pytest.approx(rise, rel=1e-9)
    area = math.pi / 4 * 0.120**2  # m2, bore of the boom cylinder
    # the rod side keeps its preload but for its rounding
    assert loaded[1] - empty[1] == pytest.approx(rise / area, rel=0.02)
    assert loaded[3] == mass
    assert abs(loaded[4]) < 1e-3  # rad/s: leakage only, some 0.1 mm of piston a second


def test_payload_stays_between_what_was_asked_for():
    """After a step from 0 to m the held mass is m (1 - exp(-1.5 t / T))^2: no overshoot."""
    arm = arm_of("rigid")
    i = [arm.at(n) for n in ("held_mass", "payload_flow")]

    def rates(_, z):
        x = arm.start()
        x[i] = z
        return arm(x, payload_mass=300.0)[0][i]

    time = np.linspace(0.0, 2.0, 41)
    mass = solve_ivp(rates, (0, 2), [0.0, 0.0], "DOP853", time, rtol=1e-10, atol=1e-9).y[0]
    # integrator error 1e-10 per step
    expected = 300 * (1 - np.exp(-1.5 * time / arm.p["payload_grip_time"])) ** 2
    np.testing.assert_allclose(mass, expected, rtol=1e-7, atol=1e-6)


# ---- momentum


def moved(arm, x, ask, until=3.0):
    """States and heat [J] after `until` seconds without forces, the payload asked for from the start."""

    def rates(_, z):
        dx, y = arm(z[:-1], payload_mass=ask)
        return [*dx, y["dissipated_power"]]

    return solve_ivp(rates, (0, until), [*x, 0.0], "DOP853", rtol=1e-10, atol=1e-10).y[:, -1]


@pytest.mark.parametrize("name", ["rigid", "pendulum"])
def test_pick_up_keeps_the_angular_momentum_and_loses_kinetic_energy(name):
    """Mass that comes from rest brings no momentum: that about the column stays, T falls by the heat."""
    arm = free(name)
    x, kinetic = arm.start(swing_speed=0.5), arm.expressions["y"]["kinetic_energy"]
    momentum = arm.of(ca.jacobian(kinetic, arm.expressions["x"]["swing_speed"]), kinetic)
    *after, heat = moved(arm, x, 300.0, until=1.5)
    (before_h, before_t), (after_h, after_t) = ([v.item() for v in momentum(at)] for at in (x, after))
    assert after[arm.at("held_mass")] == pytest.approx(300.0, rel=1e-4)
    # integrator error 1e-10 per step, some hundred steps
    assert after_h == pytest.approx(before_h, rel=1e-7)
    assert before_t - after_t == pytest.approx(heat, rel=1e-6)
    assert heat > 50.0  # J, of 1/2 0.5 rad/s h


@pytest.mark.parametrize("name", VARIANTS)
def test_mass_that_is_dropped_gives_no_impulse(name):
    """While mass leaves every acceleration is that of the mass still held: leaving mass keeps its speed."""
    arm, rng = arm_of(name), np.random.default_rng(8)
    for _ in range(20):
        x = arm.start({"payload_mass": 250.0})
        x[3:6] = rng.uniform(-1.0, 1.0, 3)
        forces = {"swing_torque": 1e4, "boom_force": 9e4, "stick_force": -1e4}
        still = arm(x, **forces)[0]
        x[arm.at("payload_flow")] = -800.0
        dropping = arm(x, **forces)[0]
        speeds = [i for i, n in enumerate(arm.states) if n.endswith("_speed")]
        np.testing.assert_array_equal(dropping[speeds], still[speeds])  # the same expressions


@pytest.mark.parametrize("name", VARIANTS)
def test_force_of_the_pick_up_is_flow_times_velocity(name):
    """The force -m' v at the payload, seen as power: the accelerations change by M^-1 of it, P = -m' v^2."""
    arm, rng = arm_of(name), np.random.default_rng(9)
    x, speeds = arm.model.x, [i for i, n in enumerate(arm.states) if n.endswith("_speed")]
    kinetic = arm.expressions["y"]["kinetic_energy"]
    mass_matrix = arm.of(ca.hessian(kinetic, x)[0][speeds, speeds], ca.jacobian(kinetic, x))
    for _ in range(20):
        x = arm.start({"payload_mass": 100.0})
        x[speeds] = rng.uniform(-1.0, 1.0, len(speeds))
        still, without = arm(x)
        x[arm.at("payload_flow")] = 800.0
        moving, taking = arm(x)
        matrix, slope = mass_matrix(x)
        square = 2 * slope[0, arm.at("held_mass")]  # v^2, for T holds m v^2 / 2
        power = x[speeds] @ matrix @ (moving - still)[speeds]
        # exact identity, rounding only
        assert power == pytest.approx(-800.0 * square, rel=1e-9)
        heat = without["dissipated_power"] + 400.0 * square
        assert taking["dissipated_power"] == pytest.approx(heat, rel=1e-9)


@pytest.mark.parametrize("name", HEADS)
def test_payload_swings_with_the_head(name):
    """At the head's centre of mass: a kilogram has the energy of the point head_x, head_y, head_height."""
    arm, rng = arm_of(name), np.random.default_rng(10)
    places = ("head_x", "head_y", "head_height")
    speed = arm.of(arm.along(ca.vertcat(*(arm.expressions["y"][n] for n in places))))
    for _ in range(10):
        x = arm.start()
        x[: len(arm.states)] += rng.uniform(-0.3, 0.3, len(arm.states))
        x[[arm.at(n) for n in ("held_mass", "payload_flow")]] = 100.0, 0.0
        heavier = x.copy()
        heavier[arm.at("held_mass")] = 101.0
        v = speed(x)[0][:, 0]
        (_, light), (_, heavy) = arm(x), arm(heavier)
        # exact identity, differences of energies of 1e4 J
        assert heavy["kinetic_energy"] - light["kinetic_energy"] == pytest.approx(v @ v / 2, rel=1e-8)
        weight = arm.p["gravity"] * light["head_height"]
        assert heavy["potential_energy"] - light["potential_energy"] == pytest.approx(weight, rel=1e-7)


# ---- programs


def test_operator_gives_the_stems_of_its_program(fmu_dir):
    """Steps at start and end of each stem, as declared; the FMU stands at them to the millisecond."""
    program = {
        f"payload_{n}_{k}": getattr(s, k) for n, s in enumerate(STEMS, 1) for k in ("start", "mass", "hold")
    }
    with driving(fmu_dir / "operator_input.fmu", **program) as operator:
        for n in range(42):
            expected = payload(STEMS, np.array([float(n)]))[0]
            assert operator.get("payload_mass")[0] == expected
            operator.step(1.0)


# the first stem is taken up at 9.4 s and dropped at 19 s
@pytest.mark.parametrize("stop", [10.4, pytest.param(21.0, marks=shards.machine)])
def test_work_cycle_with_stems_is_that_of_the_monolith(fmu_dir, stop):
    """The FMUs with the program `work_cycle_stems`: angles, pressures and the held mass of the reference."""
    trace = run(fmu_dir / "harvester.ssp", parameters=[WITH_STEMS], stop=stop).trace
    time, levers = work_cycle(stop)
    rows = np.unique([*time, *(t - 1e-6 for s in STEMS for t in (s.start, s.start + s.hold) if t < stop)])
    inputs = {name: np.interp(rows, time, samples) for name, samples in levers.items()}
    true = played(machine(), rows, inputs | {"payload_mass": payload(STEMS, rows + 1e-9)})
    # The default master makes a ramp of 1 ms of each step of the payload: half a millisecond ahead, at up to
    # 1.1e3 kg/s 0.6 kg, measured 2.4e-4 of range. Beside it, speeds are exact to 2e-5 (docs/convergence.md).
    for name, bar in (
        ("manipulator.boom_angle", 1e-4),
        ("manipulator.swing_speed", 1e-3),
        ("manipulator.held_mass", 5e-4),
        ("boom_stick.boom_head_pressure", 2e-3),
    ):
        error = np.interp(rows, trace.time, trace[name]) - true[name]
        size = np.sqrt(np.mean(error**2)) / np.ptp(true[name])
        assert size < bar, f"{name}: {size:.2g}"
