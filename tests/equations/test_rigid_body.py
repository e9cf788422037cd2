"""The mechanics of the manipulator's variants against Pinocchio, pendulums, conservation laws, geometry."""

import math
import sys
from functools import cache
from importlib import import_module

import casadi as ca
import numpy as np
import pytest
from kit.equations import Part
from kit.needs import lacks
from scipy.integrate import solve_ivp
from scipy.special import ellipk

from fmus.contract import stack, symbols
from fmus.manipulator import VARIANTS
from fmus.parameters import values

NUMBERS = {variant: dict(values(sub).p) for variant, sub in VARIANTS.items()}
P = NUMBERS["rigid"]
CYLINDERS = ("boom", "stick")


@cache
def mechanics_of(variant):
    """(x, p) -> (M, V, G, T, U) of a variant."""
    sub = VARIANTS[variant]
    x, p = symbols(sub.states), symbols(sub.parameters)
    motion = sub.model.motion(x, p)
    terms = [motion.mass, motion.coriolis, motion.gravity, motion.kinetic, motion.potential]
    return ca.Function("mechanics", [stack(x), stack(p)], terms)


@cache
def part(variant):
    """The equations of a variant."""
    return Part(VARIANTS[variant])


COORDINATES = ("swing", "boom", "stick", "head", "head_side")


def indices(variant):
    """Where the angles, the speeds and the other states stand among the states of a variant."""
    names = part(variant).states
    angles, speeds = (
        [names.index(n) for n in (f"{c}_{kind}" for c in COORDINATES) if n in names]
        for kind in ("angle", "speed")
    )
    return angles, speeds, [i for i in range(len(names)) if i not in (*angles, *speeds)]


def state(variant, q, w, z=0.0, held=0.0):
    """States of a variant from angles, speeds, deflections [m or rad] and the payload held [kg]."""
    angles, speeds, others = indices(variant)
    x = np.zeros(len(angles) + len(speeds) + len(others))
    x[angles], x[speeds], x[others] = q, w, z
    x[[part(variant).at(n) for n in ("held_mass", "payload_flow")]] = held, 0.0
    return x


def evaluate(x, forces=(0.0, 0.0, 0.0), numbers=P, variant="rigid"):
    """Rates and outputs by name at states x, forces: swing torque, boom force, stick force."""
    own = part(variant)
    own.p, u = numbers, dict.fromkeys(own.inputs, 0.0)
    u |= dict(zip(("swing_torque", "boom_force", "stick_force"), forces, strict=True))
    return own(x, **u | {"payload_mass": x[own.at("held_mass")]})  # nothing is picked up or dropped


def random_numbers(rng, variant):
    """All parameters, each moved by up to 20 %; zeros become 0.1, so that a wrong term with them shows."""
    return {name: value * rng.uniform(0.8, 1.2) if value else 0.1 for name, value in NUMBERS[variant].items()}


def random_state(rng, variant):
    """Angles [rad] around the whole circle, the side angle as far as allowed, and speeds [rad/s] up to 1."""
    count = len(indices(variant)[0])
    q = rng.uniform(-math.pi, math.pi, count)
    q[4:] *= 1.4 / math.pi
    return q, rng.uniform(-1.0, 1.0, count)


@pytest.fixture(scope="module")
def pin():
    """Pinocchio, a rigid-body library with algorithms of its own."""
    if sys.platform != "linux":
        lacks("Linux", "Pinocchio is installed there only")
    return import_module("pinocchio")


def arm(pin, p, held=0.0):
    """The arm as a tree of bodies: x forward, y to the left, z up; positive boom and stick angles are up.

    held   mass of a payload, a further point mass at the centre of the head
    """
    tree, up, nowhere = pin.Model(), np.array([0.0, -1.0, 0.0]), np.zeros(3)
    tree.gravity.linear = np.array([0.0, 0.0, -p["gravity"]])

    def link(parent, joint, place, *parts):
        number = tree.addJoint(parent, joint, pin.SE3(np.eye(3), place), f"joint {parent}")
        for mass, centre, inertia in parts:
            body = pin.Inertia(mass, np.array(centre), np.diag(inertia))
            tree.appendBodyToJoint(number, body, pin.SE3.Identity())
        return number

    column = link(0, pin.JointModelRZ(), nowhere, (0.0, nowhere, (0.0, 0.0, p["column_inertia"])))
    along = [(0.0, p[f"{name}_inertia"], p[f"{name}_inertia"]) for name in CYLINDERS]  # slender links
    centres = [(p[f"{name}_centre_x"], 0.0, p[f"{name}_centre_z"]) for name in CYLINDERS]
    pivots = [np.array([p[f"{name}_pivot_x"], 0.0, p[f"{name}_pivot_z"]]) for name in CYLINDERS]
    boom = link(
        column, pin.JointModelRevoluteUnaligned(up), pivots[0], (p["boom_mass"], centres[0], along[0])
    )
    hangs = "head_length" in p
    point = (p["head_mass"], (p["stick_length"], 0.0, 0.0), (0.0, 0.0, 0.0))
    load = (held, *point[1:])
    parts = [(p["stick_mass"], centres[1], along[1])] + ([] if hangs else [point, load])
    stick = link(boom, pin.JointModelRevoluteUnaligned(up), pivots[1], *parts)
    if hangs:
        end, inertia = np.array([p["stick_length"], 0.0, 0.0]), (p["head_inertia"], p["head_inertia"], 0.0)
        yoke = link(stick, pin.JointModelRevoluteUnaligned(up), end)
        centre = (0.0, 0.0, -p["head_length"])
        load = (held, centre, (0.0, 0.0, 0.0))
        link(yoke, pin.JointModelRX(), nowhere, (p["head_mass"], centre, inertia), load)
    return tree, tree.createData()


def joint_angles(variant):
    """(n, n) from our angles to those of the tree: its pin turns relative to the stick."""
    turn = np.eye(len(indices(variant)[0]))
    turn[3:4, 1:3] = -1.0
    return turn


@pytest.mark.parametrize("variant", VARIANTS)
def test_mass_matrix_coriolis_gravity_and_energies_are_pinocchio_s(pin, variant):
    """M by composite bodies, V and G by Newton-Euler and both energies: the same at any state and numbers."""
    rng, turn = np.random.default_rng(4), joint_angles(variant)
    for _ in range(100):
        numbers, (q, w) = random_numbers(rng, variant), random_state(rng, variant)
        held = rng.choice([0.0, rng.uniform(0.0, 500.0)])
        tree, data = arm(pin, numbers, held)
        upper = np.triu(pin.crba(tree, data, turn @ q))
        gravity = pin.computeGeneralizedGravity(tree, data, turn @ q).copy()
        coriolis = pin.rnea(tree, data, turn @ q, turn @ w, np.zeros(len(q))) - gravity
        theirs = [turn.T @ (upper + np.triu(upper, 1).T) @ turn, turn.T @ coriolis, turn.T @ gravity]
        theirs += [pin.computeKineticEnergy(tree, data, turn @ q, turn @ w)]
        theirs += [pin.computePotentialEnergy(tree, data, turn @ q)]
        ours = mechanics_of(variant)(state(variant, q, w, held=held), [*numbers.values()])
        for own, expected in zip(ours, theirs, strict=True):
            # exact identity; 1e-9 is 1e2 rounding errors of terms up to 7e4 that cancel
            np.testing.assert_allclose(np.array(own).squeeze(), expected, rtol=1e-11, atol=1e-9)


def friction(variant, numbers, x, y):
    """Friction torques of the joints and forces of the pistons; those of the head's joint."""
    w = x[indices(variant)[1]]
    if "friction" in variant:
        joints = [y[f"{joint}_friction_torque"] for joint in ("swing", *CYLINDERS)]
        pistons = [y[f"{name}_friction_force"] for name in CYLINDERS]
    else:
        damping = [numbers[f"{n}_damping"] for n in ("swing", "boom_joint", "stick_joint")]
        joints = [b * v for b, v in zip(damping, w, strict=False)]
        pistons = [numbers[f"{name}_piston_damping"] * y[f"{name}_velocity"] for name in CYLINDERS]
    return joints, pistons, [numbers["head_joint_damping"] * v for v in (joint_angles(variant) @ w)[3:]]


@pytest.mark.parametrize("variant", VARIANTS)
def test_acceleration_is_pinocchio_s(pin, variant):
    """Under hydraulic forces and friction the joints accelerate as articulated bodies do."""
    rng, turn = np.random.default_rng(5), joint_angles(variant)
    for _ in range(100):
        numbers = random_numbers(rng, variant)
        numbers |= {n: 0.0 for n in numbers if n.endswith("stop_stiffness")}
        (q, w), z = random_state(rng, variant), rng.uniform(-1e-4, 1e-4)
        held = rng.choice([0.0, rng.uniform(0.0, 500.0)])
        tree, data = arm(pin, numbers, held)
        forces = rng.uniform(-1.0, 1.0, 3) * (3e4, 1e5, 1e5)
        x = state(variant, q, w, z, held)
        dx, y = evaluate(x, forces, numbers, variant)
        joints, pistons, head = friction(variant, numbers, x, y)
        torque = [forces[0] - joints[0], y["boom_torque"] - joints[1], y["stick_torque"] - joints[2]]
        for i, name in enumerate(CYLINDERS, start=1):
            torque[i] -= y[f"{name}_velocity"] / w[i] * pistons[i - 1]
        torque += [-h for h in head]
        theirs = np.linalg.solve(turn, pin.aba(tree, data, turn @ q, turn @ w, np.array(torque)))
        # exact identity; rounding times the condition of M, below 1e3, with the head beside its pin 1e4
        np.testing.assert_allclose(dx[indices(variant)[1]], theirs, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("variant", ["rigid", "pendulum"])
def test_elbow_tip_and_head_are_where_pinocchio_s_kinematics_put_them(pin, variant):
    """Stick pivot, stick end and head by chained frames, and the end's velocity in the plane of the arm."""
    rng, turn = np.random.default_rng(6), joint_angles(variant)
    for _ in range(50):
        numbers, (q, w) = random_numbers(rng, variant), random_state(rng, variant)
        tree, data = arm(pin, numbers)
        pin.forwardKinematics(tree, data, turn @ q, turn @ w)
        offset = pin.SE3(np.eye(3), np.array([numbers["stick_length"], 0.0, 0.0]))
        tip = data.oMi[3].act(offset).translation
        velocity = data.oMi[3].rotation @ offset.actInv(data.v[3]).linear
        _, y = evaluate(state(variant, q, w), numbers=numbers, variant=variant)
        forward = np.array([math.cos(q[0]), math.sin(q[0]), 0.0])
        elbow = data.oMi[3].translation
        ours = ["elbow_radius", "elbow_height", "tip_x", "tip_y", "tip_height", "tip_radius"]
        ours += ["tip_radial_velocity", "tip_vertical_velocity"]
        theirs = [forward @ elbow, elbow[2], *tip, forward @ tip, forward @ velocity, velocity[2]]
        if variant == "pendulum":
            ours += ["head_x", "head_y", "head_height"]
            theirs += [*data.oMi[5].act(np.array([0.0, 0.0, -numbers["head_length"]]))]
        # exact identity, rounding only
        np.testing.assert_allclose([y[name] for name in ours], theirs, rtol=1e-12, atol=1e-12)


def first_moment_and_inertia(joint):
    """Sum of m r [kg.m] and inertia [kg.m2] about a joint, the others locked, the stick at -1.4 rad."""
    p, fold = P, -1.4
    stick = [
        (p["stick_mass"], complex(p["stick_centre_x"], p["stick_centre_z"])),
        (p["head_mass"], p["stick_length"]),
    ]
    inertia = p["stick_inertia"]
    if joint == "boom":
        elbow, turn = complex(p["stick_pivot_x"], p["stick_pivot_z"]), complex(math.cos(fold), math.sin(fold))
        stick = [(m, elbow + turn * r) for m, r in stick]
        stick.append((p["boom_mass"], complex(p["boom_centre_x"], p["boom_centre_z"])))
        inertia += p["boom_inertia"]
    return sum(m * r for m, r in stick), inertia + sum(m * abs(r) ** 2 for m, r in stick)


@pytest.mark.parametrize("amplitude", [5.0, 30.0, 90.0])
@pytest.mark.parametrize("joint", CYLINDERS)
def test_free_link_swings_with_the_period_of_a_compound_pendulum(joint, amplitude):
    """T = 4 sqrt(I / (g |m r|)) K(sin^2(A/2)) about boom and stick pivot, all other joints locked."""
    moment, inertia = first_moment_and_inertia(joint)
    swing, i = math.radians(amplitude), 1 if joint == "boom" else 2
    weight = P["gravity"] * abs(moment)
    period = 4 * math.sqrt(inertia / weight) * ellipk(math.sin(swing / 2) ** 2)
    rest = -math.pi / 2 - np.angle(moment)  # the centre of mass hangs below the pivot

    def rates(_, y):
        q, w = np.array([0.0, 0.0, -1.4]), np.zeros(3)
        q[i], w[i] = y[0] + rest, y[1]
        mass, coriolis, gravity, _, _ = mechanics_of("rigid")(state("rigid", q, w), [*P.values()])
        return [y[1], -(float(coriolis[i]) + float(gravity[i])) / float(mass[i, i])]

    def crossing(_, y):
        return y[0]

    run = solve_ivp(rates, (0, 0.3 * period), [swing, 0.0], "DOP853", events=crossing, rtol=1e-11, atol=1e-12)
    # integrator error: 1e-11 per step over a quarter of a period, 1e2 steps at most
    assert 4 * run.t_events[0][0] == pytest.approx(period, rel=1e-9)


@pytest.mark.parametrize("variant", ["rigid", "pendulum"])
def test_free_arm_keeps_its_energy_and_its_angular_momentum(variant):
    """Without forces and friction the falling, turning arm keeps T + U and its momentum about the column."""
    own = NUMBERS[variant]
    free = own | {name: 0.0 for name in own if name.endswith(("damping", "stop_stiffness"))}
    angles, speeds, _ = indices(variant)
    start = state(variant, [0.0, 0.4, -1.2, 0.3, -0.2][: len(angles)], [0.7, 0, 0, 0, 0][: len(angles)])

    def kept(x):
        mass, _, _, kinetic, potential = mechanics_of(variant)(x, [*free.values()])
        return float(kinetic), float(kinetic + potential), float(mass[0, :] @ x[speeds])

    def falling(_, x):
        return evaluate(x, numbers=free, variant=variant)[0]

    run = solve_ivp(falling, (0, 3), start, "DOP853", rtol=1e-11, atol=1e-11)
    rows = np.array([kept(x) for x in run.y.T])
    exchanged = np.ptp(rows[:, 0])
    assert exchanged > 2e4  # the arm does fall: most of its potential energy passes through the kinetic
    # integrator error: 1e-11 per step, a few hundred steps
    assert np.ptp(rows[:, 1]) < 1e-8 * exchanged
    assert np.ptp(rows[:, 2]) < 1e-8 * abs(rows[0, 2])


def poses(name, count=25):
    """Angles [rad] of a joint over the cylinder's stroke, as states with speed 0.3 rad/s there."""
    i = 1 + CYLINDERS.index(name)
    for angle in np.linspace(-0.5, 1.0, count) if name == "boom" else np.linspace(-2.2, -0.6, count):
        x = state("rigid", [0.1, 0.2, -1.4], [0.0, 0.0, 0.0])
        x[i], x[i + 3] = angle, 0.3
        yield i, x


def pins(name, angle):
    """Base and rod pin [m] of a cylinder as complex numbers (along, across) from the joint."""
    base, pin = (complex(P[f"{name}_{n}_x"], P[f"{name}_{n}_z"]) for n in ("base", "pin"))
    return base, pin * complex(math.cos(angle), math.sin(angle))


@pytest.mark.parametrize("name", CYLINDERS)
def test_moment_arm_is_slope_of_the_length_and_distance_to_the_cylinder_line(name):
    """J = dx/dq by differences; |J| = distance of the pivot from the line of the pins; J > 0 for the boom."""
    step = 1e-4
    for i, x in poses(name):
        lever = evaluate(x)[1][f"{name}_velocity"] / x[i + 3]
        ends = [evaluate(x + d * np.eye(x.size)[i])[1][f"{name}_position"] for d in (-step, step)]
        # truncation step^2/6 of the third derivative (below 1 m), rounding 1e-16/step
        assert (ends[1] - ends[0]) / (2 * step) == pytest.approx(lever, abs=1e-8)
        base, rod = pins(name, x[i])
        along = (rod - base) / abs(rod - base)
        length = evaluate(x)[1][f"{name}_position"] + P[f"{name}_closed_length"]
        # exact identities, rounding only
        assert length == pytest.approx(abs(rod - base), rel=1e-13)
        assert abs((base.conjugate() * along).imag) == pytest.approx(abs(lever), rel=1e-12)
        assert (lever > 0) == (name == "boom")
