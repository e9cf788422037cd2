"""Variants of the manipulator: swinging head, dry friction, and what all of them keep."""

import math
from functools import cache

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from kit import shards
from kit.equations import Part, machine, played
from scipy.integrate import quad, solve_ivp
from scipy.optimize import brentq

from fmus.components.friction import CREEP, Bristles, lugre
from fmus.machine.poses import pose_grid
from fmus.manipulator import VARIANTS
from fmus.manipulator.pendulum import SIDE_LIMIT
from fmus.parameters import values

HEADS = ("pendulum", "pendulum_friction")
DRY = ("friction", "pendulum_friction")
# kg.m2: the arm stays where it is
HELD = {"column_inertia": 1e12, "boom_inertia": 1e12, "stick_inertia": 1e12}
P = dict(values(VARIANTS["pendulum_friction"]).p)
FORCES = ("swing_torque", "boom_force", "stick_force")
variants = pytest.mark.parametrize("name", VARIANTS)
heads = pytest.mark.parametrize("name", HEADS)


@cache
def variant(name, **numbers):
    """A variant, with other numbers as far as it has them."""
    return Part(VARIANTS[name], **numbers)


def random_state(v, rng):
    """Any pose inside the strokes, speeds [rad/s] up to 1, head anywhere allowed, bristles deflected.

    The payload [kg] comes or goes.
    """
    ranges = {"swing_angle": 3.0, "head_angle": 3.0, "head_side_angle": 1.3, "payload_flow": 1e3}
    sizes = (1e-4 if n.endswith("bristle") else ranges.get(n, 1.0) for n in v.states)
    x = np.array([rng.uniform(-1, 1) * size for size in sizes])
    x[1:3] = rng.uniform(-0.4, 0.95), rng.uniform(-2.1, -0.65)
    x[v.at("held_mass")] = rng.uniform(0.0, 500.0)
    return x


def random_forces(rng):
    return {name: rng.normal(0, size) for name, size in zip(FORCES, (1e4, 1e5, 1e5), strict=True)}


@variants
def test_power_in_is_power_stored_and_heat(name):
    """Power of hydraulics and payload = d/dt of kinetic, potential and elastic energy + heat >= 0."""
    v, rng = variant(name, swing_stop_angle=1.0, swing_stop_stiffness=1e5), np.random.default_rng(1)
    y = v.expressions["y"]
    energies = ("kinetic_energy", "potential_energy", "stored_energy", "stop_energy")
    rate = v.of(v.along(sum(y[n] for n in energies if n in y)))
    for _ in range(100):
        x, forces = random_state(v, rng), random_forces(rng)
        x[1] += rng.choice([0.0, 1.5])  # a third of the poses lie in a stop
        _, y = v(x, **forces)
        powers = [forces["swing_torque"] * y["swing_speed"], y["payload_power"]]
        powers += [forces[f"{a}_force"] * y[f"{a}_velocity"] for a in ("boom", "stick")]
        stored, heat = rate(x, **forces)[0].item(), y["dissipated_power"]
        assert heat >= 0
        # exact identity; 1e-12 is 1e4 rounding errors of the largest power, times the condition of M
        size = sum(map(abs, (*powers, stored, heat)))
        assert sum(powers) - stored - heat == pytest.approx(0, abs=1e-12 * size)


@variants
def test_accelerations_are_the_slopes_of_the_velocities(name):
    """The rate ports are exact: d/dt of swing_speed, boom_velocity, stick_velocity along the equations."""
    v, rng = variant(name), np.random.default_rng(2)
    names = ("swing_speed", "boom_velocity", "stick_velocity")
    slope = v.of(v.along(ca.vertcat(*(v.expressions["y"][n] for n in names))))
    for _ in range(20):
        x, forces = random_state(v, rng), random_forces(rng)
        _, y = v(x, **forces)
        found = [y[n] for n in ("swing_acceleration", "boom_acceleration", "stick_acceleration")]
        expected = slope(x, **forces)[0][:, 0]
        np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12)  # exact identity, rounding only


@variants
def test_arm_rests_under_the_holding_forces(name):
    """At any pose, head hanging and bristles relaxed, nothing moves; the forces are those of `rigid`."""
    for boom, stick in pose_grid(5):
        x = {"boom_angle": boom, "stick_angle": stick}
        _, usual = variant("rigid")(variant("rigid").start(**x))
        _, y = variant(name)(variant(name).start(**x))
        held = {f"{a}_force": y[f"{a}_holding_force"] for a in ("boom", "stick")}
        dx, _ = variant(name)(variant(name).start(**x), **held)
        # exact identity; rounding of moments up to 4e4 N.m over inertias of some 1e2 kg.m2
        assert np.abs(dx).max() < 1e-12
        for a, force in held.items():
            # exact identity, rounding only
            assert force == pytest.approx(usual[a.replace("_force", "_holding_force")], rel=1e-12)


@heads
def test_damping_of_the_head_is_the_ratio_that_its_note_says(name):
    """With the arm held, both axes have sqrt(m g L / (J + m L^2)) [rad/s] and a tenth of critical damping."""
    v = variant(name, **HELD)
    own = [i for i, n in enumerate(v.states) if n.startswith("head")]
    (matrix,) = v.of(ca.jacobian(v.model.dx, v.model.x))(v.start())
    roots = np.linalg.eigvals(matrix[np.ix_(own, own)])
    m, length = P["head_mass"], P["head_length"]
    omega = math.sqrt(m * P["gravity"] * length / (P["head_inertia"] + m * length**2))
    # exact but for the arm's 1e-7
    np.testing.assert_allclose(np.abs(roots), omega, rtol=1e-6)
    # the number is rounded to 240
    np.testing.assert_allclose(-roots.real / np.abs(roots), 0.1, rtol=0.03)


def rounded(z: float) -> float:
    """m_w(z) of docs/equations.md."""
    return (z + math.hypot(z, 0.01)) / 2


@heads
def test_a_head_that_is_pulled_out_of_its_stop_is_let_go(name):
    """However fast the yoke leaves its stop, the stop pushes or does nothing."""
    v = variant(name)
    angle, c = v.p["head_stop_angle"] + 0.05, v.p["head_stop_damping"]
    states = (v.start(head_side_angle=angle, head_side_speed=-f / c) for f in (0, 1, 3))
    torques = [v(x)[1]["head_stop_torque"] for x in states]
    assert torques == sorted(torques)
    assert -1e-2 * v.p["head_stop_stiffness"] < torques[-1] < 0


@pytest.mark.parametrize("speed", [1.0, -15.0])
def test_thrown_head_comes_back_from_its_stop_as_the_law_of_contact_says(speed):
    """v dv = -k r(d)/I m_w(1 + c v) dd: the integral of v/m_w(1 + c v) is equal at first and last touch."""
    v = variant("pendulum", gravity=0.0, head_joint_damping=0.0, **HELD)
    i, c, stop = v.at("head_side_angle"), v.p["head_stop_damping"], v.p["head_stop_angle"]
    start = v.start(head_side_angle=math.copysign(stop, speed), head_side_speed=speed)

    def left(_, x):
        return abs(x[i]) - stop + 1e-9

    left.direction, left.terminal = -1, True
    run = solve_ivp(lambda _, x: v(x)[0], (0, 1), start, "DOP853", events=left, rtol=1e-10, atol=1e-12)
    back = -run.y[v.at("head_side_speed"), -1] / math.copysign(1, speed)
    level = quad(lambda u: u / rounded(1 + c * u), 0, abs(speed))[0]
    expected = brentq(lambda end: quad(lambda u: u / rounded(1 - c * u), 0, end)[0] - level, 0, abs(speed))
    assert 0.5 * abs(speed) < expected < abs(speed)
    assert back == pytest.approx(expected, rel=1e-6)  # the arm, 1e12 kg.m2, gives way by 1e-7
    assert np.abs(run.y[i]).max() < 1.3


@pytest.mark.parametrize("hold", [1.1, pytest.param(2.1, marks=shards.machine)])
def test_swing_at_full_command_stopped_at_once_throws_the_head_into_its_stop_only(hold):
    """The hardest that levers can do, and the FMU goes on: the head stays clear of the singular position."""
    model, time = machine(manipulator="pendulum"), np.arange(0.0, hold + 0.6, 0.005)
    lever = np.where((time > 0.1) & (time < hold), 10.0, 0.0)
    y = played(model, time, {"swing_command": lever}, tolerance=1e-8)
    side = np.abs(y["manipulator.head_side_angle"]).max()
    assert P["head_stop_angle"] < side < SIDE_LIMIT - 0.1


@heads
def test_side_angle_near_the_singular_position_is_an_error(name):
    """Every condition holds with the head hanging, exactly one fails with the side angle beyond 1.4 rad."""
    v = variant(name)
    check = v.of(v.model.require)
    for angle, failing in ((0.0, 0), (1.39, 0), (1.41, 1), (-1.41, 1)):
        found = check(v.start(head_side_angle=angle))[0][:, 0]
        bad = [s for s, value in zip(v.model.statements, found, strict=True) if not value > 0]
        assert [s.startswith("head_side_angle") for s in bad] == [True] * failing


# ---- dry friction

DRY_PISTON = Bristles(2000.0, 1.4, 0.005, 1e-4, 0.01)
speeds = st.floats(-1.0, 1.0)
deflections = st.floats(-1.4e-4, 1.4e-4)
laws = st.builds(
    Bristles,
    coulomb=st.floats(0.0, 1e4),
    static_ratio=st.floats(0.5, 3.0),
    stribeck_speed=st.floats(1e-4, 0.1),
    deflection=st.floats(1e-6, 1e-3),
    damping_time=st.floats(0.0, 1.0),
)


@pytest.mark.parametrize("v", [2e-4, 2e-3, 5e-3, 0.02, 0.3, -0.01])
def test_steady_slip_follows_the_stribeck_curve(v):
    """At constant speed the friction settles at g(v) + b v, g = Fc (1 + (r - 1) exp(-(v/vs)^2))."""

    def rate(_, z):
        return [lugre(v, z[0], DRY_PISTON, 2e4).deflection_rate]

    run = solve_ivp(rate, (0, 2e-3 / abs(v)), [0.0], "Radau", rtol=1e-9, atol=1e-15)
    r, dry = lugre(v, run.y[0, -1], DRY_PISTON, 2e4), DRY_PISTON
    g = dry.coulomb * (1 + (dry.static_ratio - 1) * math.exp(-((v / dry.stribeck_speed) ** 2)))
    # the rounding of |v|, 5 um/s: (5e-6 / v)^2 / 2 = 3e-4 at the slowest
    assert r.force == pytest.approx(math.copysign(g, v) + 2e4 * v, rel=5e-4)
    assert r.deflection_rate == pytest.approx(0, abs=1e-6 * abs(v))  # settled
    assert r.heat == pytest.approx(r.force * v, rel=1e-5)  # all of the power


@given(dry=laws, v=speeds, z=deflections, b=st.floats(0.0, 1e5))
def test_power_into_friction_is_stored_or_heat_for_any_numbers(dry, v, z, b):
    """F v = d(stored)/dt + heat, both >= 0, at any state: no program of speeds gets work out of bristles."""
    r = lugre(v, z, dry, b)
    stored_rate = dry.coulomb / dry.deflection * z * r.deflection_rate
    assert r.heat >= 0
    assert r.stored >= 0
    # exact identity; 1e-12 is 1e4 rounding errors of its terms
    size = abs(r.force * v) + abs(stored_rate) + r.heat
    assert r.force * v - stored_rate - r.heat == pytest.approx(0, abs=1e-12 * size + 1e-30)


@given(dry=laws, v=speeds, z=deflections, b=st.floats(0.0, 1e5))
def test_friction_is_odd(dry, v, z, b):
    """The mirrored motion has the mirrored force and the same heat, to the bit."""
    one, other = lugre(v, z, dry, b), lugre(-v, -z, dry, b)
    assert (one.force, one.deflection_rate) == (-other.force, -other.deflection_rate)
    assert (one.heat, one.stored) == (other.heat, other.stored)


@given(v=speeds, z=st.floats(-1.0, 1.0))
def test_deflection_stays_below_break_away(v, z):
    """At |z| = r d or more the bristles never deflect further, so friction stays bounded."""
    z = math.copysign(DRY_PISTON.static_ratio * DRY_PISTON.deflection * (1 + abs(z)), z)
    assert lugre(v, z, DRY_PISTON, 0.0).deflection_rate * z <= 0


def test_creep_of_a_held_contact_is_the_rounding_speed():
    """Under half its break-away force a contact creeps at CREEP vs times 0.58: micrometres a second."""
    load, ratio = 0.5, DRY_PISTON.static_ratio
    z = load * ratio * DRY_PISTON.deflection
    v = CREEP * DRY_PISTON.stribeck_speed * load / math.sqrt(1 - load**2)
    # exact but for (v / vs)^2 in the Stribeck curve
    assert lugre(v, z, DRY_PISTON, 0.0).deflection_rate == pytest.approx(0, abs=1e-5 * v)
    assert v < 3e-6  # m/s


@pytest.mark.parametrize("name", DRY)
def test_variant_without_coulomb_friction_is_the_one_without_bristles(name):
    """All Coulomb numbers zero: rates and outputs are those of rigid or pendulum, at any state."""
    plain = variant({"friction": "rigid", "pendulum_friction": "pendulum"}[name])
    rng = np.random.default_rng(3)
    bare = variant(name, **{n: 0.0 for n in P if n.endswith("_coulomb")})
    shared = [bare.at(n) for n in plain.states]
    for _ in range(20):
        x, forces = random_state(bare, rng), random_forces(rng)
        (dx, y), (dx0, y0) = bare(x, **forces), plain(x[shared], **forces)
        # exact identity, rounding only
        np.testing.assert_allclose(dx[shared], dx0, rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose([y[n] for n in y0], list(y0.values()), rtol=1e-12, atol=1e-12)
