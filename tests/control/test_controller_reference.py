"""The reference: inverse kinematics, limits, singular poses, waiting for the machine."""

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from kit.properties import examples
from kit.steering import PART, STATES, arm_angles, at, measured, rates

from fmus.controller import CONTROLLER, reference
from fmus.controller.arm import Cylindrical
from fmus.controller.harvester import ARM
from fmus.controller.paths import start_angles
from fmus.parameters import parameters

P = parameters(CONTROLLER)
STROKES = P.boom.stroke, P.stick.stroke
ANGLES = st.tuples(st.floats(-0.4, 0.95), st.floats(-2.1, -0.6))  # inside the strokes


def tip(boom: float, stick: float) -> tuple[float, float]:
    at = ARM.tip((0.0, boom, stick), P)
    return float(at.radius), float(at.height)


def pistons(boom: float, stick: float) -> list[float]:
    """Positions of both pistons [m]."""
    return [float(position) for position, _ in ARM.pistons((0.0, boom, stick), P)[1:]]


# ---- inverse kinematics


@examples(30)
@given(ANGLES)
def test_the_search_for_a_pose_finds_the_closed_form(angles):
    """Angles -> tip -> angles, with the elbow above; 1e-10 m of the search, over links of metres."""
    place = tip(*angles)
    found = start_angles("", (*place, 0.3), {})
    pose = [found[f"manipulator.initial_{n}_angle"] for n in ("swing", "boom", "stick")]
    assert pose == pytest.approx([0.3, *angles], abs=1e-9)
    assert arm_angles(*place) == pytest.approx(angles, abs=1e-7)  # acos near its ends loses half the digits


@pytest.mark.parametrize("bend", [0.0, 1e-9, 1e-3, math.pi])
def test_a_stretched_or_folded_arm_stays_finite(bend):
    """Collinear links: no joint speed moves the tip outwards; joint speeds stay within 1 rad/s per m/s."""
    stick = math.atan2(P.stick_pivot_z, P.stick_pivot_x) - bend
    for out, up in ((1.0, 0.0), (0.0, 1.0), (0.7, 0.7)):
        _, *speeds = ARM.joint_speeds((0.0, 0.2, stick), Cylindrical(out, up, 0.0), P)
        assert np.isfinite([float(s) for s in speeds]).all()
        assert max(abs(float(s)) for s in speeds) < 1 / P.singular_damping


# ---- limits

SPEED = st.floats(-3.0, 3.0)


@given(SPEED, SPEED, SPEED, st.floats(0.02, 0.59), st.floats(0.02, 0.70))
def test_speeds_stay_below_the_limits(swing, boom, stick, boom_at, stick_at):
    """The factor brings each actuator below its limit and below what the end of the stroke allows."""
    speeds = {"swing": swing, "boom": boom, "stick": stick}
    limits = reference.speed_limits(ARM, [(0.2, 1)] * 3, P)
    utilisation = reference.utilisation(speeds, limits, {"boom": boom_at, "stick": stick_at}, P)
    factor = float(utilisation.factor)
    assert 0 <= factor <= 1
    slack = 1 + 1e-9
    assert abs(swing) * factor <= P.swing_speed_limit * slack
    for name, position, speed in (("boom", boom_at, boom), ("stick", stick_at, stick)):
        assert abs(speed) * factor <= getattr(P, f"{name}_speed_limit") * slack
        way = getattr(P, name).stroke - position if speed > 0 else position
        left = way - P.stroke_margin
        assert abs(speed) * factor <= P.stroke_gain * max(left, 0.0) + reference.CREEP * slack


@examples(10)
@given(ANGLES, st.floats(-math.pi, math.pi), st.floats(0.5, 3.0))
def test_the_reference_never_leaves_its_strokes_and_keeps_the_direction(angles, heading, speed):
    """Driven anywhere for 4 s, the machine follows: pistons keep off their ends, the tip stays on a line."""
    velocity = speed * math.cos(heading), speed * math.sin(heading)
    u = measured(*angles, radial_velocity=velocity[0], vertical_velocity=velocity[1])
    x, first = PART.start(u), pistons(*angles)
    x[STATES.index("radial_lever")], x[STATES.index("vertical_lever")] = velocity
    for _ in range(200):
        boom, stick = at(x, "reference_boom"), at(x, "reference_stick")
        dx = rates(x, u | {"boom_angle": boom, "stick_angle": stick})
        speeds = 0.0, at(dx, "reference_boom"), at(dx, "reference_stick")
        moving = ARM.tip_velocity((0.0, boom, stick), speeds, P)
        across = float(moving.radius) * velocity[1] - float(moving.height) * velocity[0]
        bend = math.sin(stick - math.atan2(P.stick_pivot_z, P.stick_pivot_x))
        if abs(bend) > P.singular_share:  # where the inverse is not damped
            assert abs(across) <= 1e-9 * speed  # rounding
        x = x + 0.02 * dx
        for now, before, stroke in zip(pistons(boom, stick), first, STROKES, strict=True):
            # 0.1 mm for creep and the Euler steps
            assert min(P.stroke_margin, before) - 1e-4 <= now <= max(stroke - P.stroke_margin, before) + 1e-4


def test_the_reference_waits_for_a_machine_at_rest():
    """A blocked arm with an outward command for 20 s: the reference stays within 1.5 error limits."""
    u = measured(0.2, -1.4, radial_velocity=0.5)
    x = PART.start(u)
    for _ in range(2000):
        x = x + 0.01 * rates(x, u)
    ahead = math.dist(pistons(at(x, "reference_boom"), at(x, "reference_stick")), pistons(0.2, -1.4))
    assert ahead < 1.5 * P.piston_error_limit
    # and turns round at once: half a second backwards brings it nearer
    back = u | {"radial_velocity": -0.5}
    for _ in range(50):
        x = x + 0.01 * rates(x, back)
    later = pistons(at(x, "reference_boom"), at(x, "reference_stick"))
    assert math.dist(later, pistons(0.2, -1.4)) < ahead


# ---- the load


def load(q, mass):
    """Forces of the cylinders that hold a point mass at the tip, and the pistons."""
    pistons, columns = ARM.pistons(q, P), ARM.columns(q, P)
    held = [mass * 9.81 * h / lever for (_, h), (_, lever) in zip(columns, pistons[1:], strict=True)]
    return [0.0, *held], pistons


MASSES = st.floats(50, 2000)


@given(ANGLES, MASSES, st.floats(-0.5, 0.5), st.floats(-0.5, 0.5), st.floats(-0.5, 0.5))
def test_a_mass_at_the_tip_is_told_by_the_loads_and_moved_by_its_force(angles, mass, turn, boom, stick):
    """M a along each joint, of a tip that speeds up from rest; inertia of each axis by its kinetic energy."""
    q, rates = (0.0, *angles), (turn, boom, stick)
    loads, pistons = load(q, mass)
    carried = ARM.carried(q, pistons, (0.0, 0.0, 0.0), rates, loads, P)
    along = ARM.tip_velocity(q, rates, P)  # of a tip at rest the acceleration
    radius, _ = tip(*angles)
    assume(max(abs(h) for _, h in ARM.columns(q, P)) > 2)
    power = mass * (along.radius**2 + along.height**2 + (radius * along.angle) ** 2)
    worked = sum(f * lever * w for (_, f), (_, lever), w in zip(carried, pistons, rates, strict=True))
    # short by the square of `LEAST_ARM`, 0.1 m, over that of the longer arm, 2 m and more: 0.25 %
    assert float(worked) == pytest.approx(float(power), rel=3e-3, abs=1e-9)
    for k, (inertia, _) in enumerate(carried):
        one = [float(k == i) for i in range(3)]
        v = ARM.tip_velocity(q, one, P)
        square = float(v.radius**2 + v.height**2 + (radius * v.angle) ** 2)
        assert float(inertia) * float(pistons[k][1]) ** 2 == pytest.approx(mass * square, rel=3e-3)
