"""The payload of the head: weight, pick-up, drop, program of the operator, work cycle with stems."""

from __future__ import annotations

import math

import casadi as ca
import numpy as np
import pytest
from kit.fmu import driving
from scipy.integrate import solve_ivp

from fmus.contract import quantities, symbolic
from fmus.machine.parts import parts, wiring
from fmus.machine.poses import pose_grid
from fmus.machine.work_cycle import COMMANDS, PROGRAMS, STEMS, WITH_STEMS, payload, sample
from fmus.manipulator import VARIANTS
from fmus.monolith import join, simulate
from fmus.parameters import values
from orchestrator import run

HEADS = [v for v in VARIANTS if v.startswith("pendulum")]


class Arm:
    """A variant's equations in numbers by name, with changed parameters."""

    def __init__(self, name, **changed):
        sub = VARIANTS[name]
        own, self.model = values(sub), symbolic(sub)
        self.states, self.shown = list(quantities(sub.states)), list(quantities(sub.outputs))
        self.p, self.u = {**own.p, **changed}, dict.fromkeys(quantities(sub.inputs), 0.0)
        m = self.model
        self.of = ca.Function("arm", [m.x, m.u, m.p], [m.dx, m.y])

    def start(self, **inputs):
        """States at the start."""
        zero = [0.0] * len(self.states)
        start = self.model.initial()(zero, list((self.u | inputs).values()), list(self.p.values()))
        return start.full()[:, 0]

    def __call__(self, x, **inputs):
        """Rates, and outputs by name."""
        dx, y = self.of(x, list((self.u | inputs).values()), list(self.p.values()))
        return dx.full()[:, 0], dict(zip(self.shown, y.full()[:, 0], strict=True))

    def state(self, x, name):
        return x[self.states.index(name)]


def free(name):
    """A variant without gravity and friction, so that only the payload changes its momentum."""
    p = values(VARIANTS[name]).p
    zero = [n for n in p if n.endswith(("damping", "coulomb", "stop_stiffness"))]
    return Arm(name, gravity=0.0, **dict.fromkeys(zero, 0.0))


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
    arm, mass = Arm(name), 300.0
    for boom, stick in pose_grid(4):
        arm.p |= {"initial_boom_angle": boom, "initial_stick_angle": stick}
        loaded, empty = (arm(arm.start(payload_mass=m))[1] for m in (mass, 0.0))
        for joint, angle, out in zip(
            ("boom", "stick"), (boom, stick), lever_arms(arm.p, boom, stick), strict=True
        ):
            expected = mass * arm.p["gravity"] * out / triangle(arm.p, joint, angle)
            found = loaded[f"{joint}_holding_force"] - empty[f"{joint}_holding_force"]
            # exact identity; rounding of forces of 1e5 N
            assert found == pytest.approx(expected, rel=1e-9, abs=1e-7)


@pytest.mark.parametrize("mass", [100.0, 500.0])
def test_fmu_holds_the_payload_with_pressure(fmu_dir, mass):
    """harvester.fmu with a payload from the start: cylinder force m g r / J higher, and nothing moves."""
    found = []
    for load in (0.0, mass):
        with driving(fmu_dir / "harvester.fmu", payload_mass=load) as machine:
            start = machine.get("boom_force", "boom_head_pressure", "boom_rod_pressure", "held_mass")
            machine.step(1e-3, 500)
            found.append((*start, *machine.get("boom_speed", "boom_angle", "stick_angle")))
    empty, loaded = found
    p = Arm("rigid").p
    rise = mass * p["gravity"] * lever_arms(p, p["initial_boom_angle"], p["initial_stick_angle"])[0]
    rise /= triangle(p, "boom", p["initial_boom_angle"])
    # exact identity; initial pressures to rounding of 1e7 Pa
    assert loaded[0] - empty[0] == pytest.approx(rise, rel=1e-9)
    area = (
        math.pi / 4 * 0.120**2
    )  # m2, bore of the boom cylinder; the rod side keeps its preload but for rounding
    assert loaded[1] - empty[1] == pytest.approx(rise / area, rel=0.02)
    assert loaded[3] == mass
    assert abs(loaded[4]) < 1e-3  # rad/s: leakage only, some 0.1 mm of piston a second


def test_payload_stays_between_what_was_asked_for():
    """After a step from 0 to m the held mass is m (1 - exp(-1.5 t / T))^2: no overshoot."""
    arm = Arm("rigid")
    i = [arm.states.index(n) for n in ("held_mass", "payload_flow")]

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
    x = arm.start()
    x[arm.states.index("swing_speed")] = 0.5
    m = arm.model
    kinetic = m.y[arm.shown.index("kinetic_energy")]
    momentum = ca.Function(
        "h", [m.x, m.u, m.p], [ca.jacobian(kinetic, m.x[arm.states.index("swing_speed")]), kinetic]
    )

    def of(state):
        return [float(v) for v in momentum(state, list(arm.u.values()), list(arm.p.values()))]

    *after, heat = moved(arm, x, 300.0, until=1.5)
    (before_h, before_t), (after_h, after_t) = of(x), of(after)
    assert arm.state(after, "held_mass") == pytest.approx(300.0, rel=1e-4)
    # integrator error 1e-10 per step, some hundred steps
    assert after_h == pytest.approx(before_h, rel=1e-7)
    assert before_t - after_t == pytest.approx(heat, rel=1e-6)
    assert heat > 50.0  # J, of 1/2 0.5 rad/s h


@pytest.mark.parametrize("name", VARIANTS)
def test_mass_that_is_dropped_gives_no_impulse(name):
    """While mass leaves every acceleration is that of the mass still held: leaving mass keeps its speed."""
    arm, rng = Arm(name), np.random.default_rng(8)
    for _ in range(20):
        x = arm.start(payload_mass=250.0)
        x[3:6] = rng.uniform(-1.0, 1.0, 3)
        forces = {"swing_torque": 1e4, "boom_force": 9e4, "stick_force": -1e4}
        still = arm(x, **forces)[0]
        x[arm.states.index("payload_flow")] = -800.0
        dropping = arm(x, **forces)[0]
        speeds = [i for i, n in enumerate(arm.states) if n.endswith("_speed")]
        np.testing.assert_array_equal(dropping[speeds], still[speeds])  # the same expressions


@pytest.mark.parametrize("name", VARIANTS)
def test_force_of_the_pick_up_is_flow_times_velocity(name):
    """The force -m' v at the payload, seen as power: the accelerations change by M^-1 of it, P = -m' v^2."""
    arm, rng = Arm(name), np.random.default_rng(9)
    m, speeds = arm.model, [i for i, n in enumerate(arm.states) if n.endswith("_speed")]
    kinetic = m.y[arm.shown.index("kinetic_energy")]
    mass_matrix = ca.Function(
        "M", [m.x, m.u, m.p], [ca.hessian(kinetic, m.x)[0][speeds, speeds], ca.jacobian(kinetic, m.x)]
    )
    for _ in range(20):
        x = arm.start(payload_mass=100.0)
        x[speeds] = rng.uniform(-1.0, 1.0, len(speeds))
        still = arm(x)[0]
        x[arm.states.index("payload_flow")] = 800.0
        change = arm(x)[0] - still
        matrix, slope = mass_matrix(x, list(arm.u.values()), list(arm.p.values()))
        square = 2 * float(slope[arm.states.index("held_mass")])  # v^2, for T holds m v^2 / 2
        power = x[speeds] @ matrix.full() @ change[speeds]
        # exact identity, rounding only
        assert power == pytest.approx(-800.0 * square, rel=1e-9)
        assert arm(x)[1]["dissipated_power"] - 400.0 * square == pytest.approx(
            arm(np.where(np.arange(x.size) == arm.states.index("payload_flow"), 0.0, x))[1][
                "dissipated_power"
            ],
            rel=1e-9,
        )


@pytest.mark.parametrize("name", HEADS)
def test_payload_swings_with_the_head(name):
    """At the head's centre of mass: a kilogram has the energy of the point head_x, head_y, head_height."""
    arm, rng = Arm(name), np.random.default_rng(10)
    m, places = arm.model, ("head_x", "head_y", "head_height")
    at = ca.vertcat(*(m.y[arm.shown.index(n)] for n in places))
    speed = ca.Function("v", [m.x, m.u, m.p], [ca.jtimes(at, m.x, m.dx)])
    for _ in range(10):
        x = arm.start()
        x[: len(arm.states)] += rng.uniform(-0.3, 0.3, len(arm.states))
        x[[arm.states.index(n) for n in ("held_mass", "payload_flow")]] = 100.0, 0.0
        heavier = x.copy()
        heavier[arm.states.index("held_mass")] = 101.0
        v = speed(x, list(arm.u.values()), list(arm.p.values())).full()[:, 0]
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


def test_work_cycle_with_stems_is_that_of_the_monolith(fmu_dir):
    """The FMUs with the program `work_cycle_stems`: angles, pressures and the held mass of the reference."""
    stop = 21.0
    result = run(fmu_dir / "harvester.ssp", parameters=[WITH_STEMS], stop=stop)
    chosen = parts()
    model = join(chosen, *wiring(chosen))
    time, commands = sample(PROGRAMS[WITH_STEMS], stop)
    rows = np.unique([*time, *(t - 1e-6 for s in STEMS for t in (s.start, s.start + s.hold) if t < stop)])
    inputs = np.tile(model.u, (rows.size, 1))
    inputs[:, [model.inputs.index(n) for n in COMMANDS]] = np.column_stack(
        [np.interp(rows, time, column) for column in commands.T]
    )
    inputs[:, model.inputs.index("payload_mass")] = payload(STEMS, rows + 1e-9)
    _, outputs = simulate(model, rows, inputs, tolerance=1e-10)
    # The default master makes a ramp of 1 ms of each step of the payload: half a millisecond ahead, at up to
    # 1.1e3 kg/s 0.6 kg, measured 2.4e-4 of range. Beside it, speeds are exact to 2e-5 (docs/convergence.md).
    for name, bar in (
        ("manipulator.boom_angle", 1e-4),
        ("manipulator.swing_speed", 1e-3),
        ("manipulator.held_mass", 5e-4),
        ("boom_stick.boom_head_pressure", 2e-3),
    ):
        ours = np.interp(rows, result.trace.time, result.trace[name])
        theirs = outputs[:, model.output_names.index(name)]
        error = np.sqrt(np.mean((ours - theirs) ** 2)) / np.ptp(theirs)
        assert error < bar, f"{name}: {error:.2g}"
