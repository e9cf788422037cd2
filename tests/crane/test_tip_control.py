"""Control of a crane's tip: the general law is that of the harvester, shares the motion, and draws lines."""

import math
import re
from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from kit import shards
from kit.cranes import changed, checked, machine
from kit.equations import Part
from kit.mistakes import problem
from scipy.linalg import eigvals

from fmus.contract import column, nested
from fmus.controller import CONTROLLER
from fmus.controller.arm import Cylindrical
from fmus.controller.paths import start_angles, write_route
from fmus.crane.controller import controlled
from fmus.crane.description import read
from fmus.crane.machine import crane_machine, tracked
from fmus.crane.manipulator import manipulator
from fmus.machine.path_following import follow
from fmus.machine.poses import outputs_at_start
from fmus.machine.sway import sway
from fmus.parameters import values
from orchestrator import load

LOADER = machine().controller
ARM, P = LOADER.model.arm, values(LOADER).p
RANGES = {a.joint.name: (a.low, a.high) for a in checked() if math.isfinite(a.low)}
POSES = st.tuples(*(st.floats(low + 0.02 * (high - low), high) for low, high in RANGES.values()))
SPEED = st.floats(-1.0, 1.0)


def _functions(**given):
    """Point, speeds for a velocity of the tip, levers and weights: of coordinates and velocity."""
    p, q, v = nested(LOADER.parameters, P | given), ca.SX.sym("q", 4), ca.SX.sym("v", 2)
    each, velocity = ca.vertsplit(q), Cylindrical(v[0], v[1], 0)
    point, pistons = column(*ARM.point(each, p)), column(*(x for x, _ in ARM.pistons(each, p)))
    weights = column(*ARM.choice(ARM.columns(each, p), each, velocity, p)[1])
    speeds = column(*ARM.joint_speeds(each, velocity, p))
    return ca.Function("f", [q, v], [point, ca.jacobian(point, q), speeds, weights, pistons])


AS_IT_IS, LEAST_OIL = _functions(), _functions(centring=0.0)


def test_a_crane_like_the_harvester_is_controlled_like_it():
    """At 100 states: commands and rates of the shipped controller, to 1e-12 of the largest.

    examples/cranes/feric.toml has the same pins and cylinders; valves, lines and gains are made the same.
    """
    sub = machine("feric").controller
    own, shipped, shown = Part(sub), Part(CONTROLLER), values(CONTROLLER)
    assert (own.states, own.inputs) == (shipped.states, shipped.inputs)
    p, same = dict(values(sub).p), {"swing_line": "line", "swing_motor": "motor", "swing_gear": "gear"}
    for n in p:
        name = re.sub(r"^(boom|stick)_valve", "valve", n)
        name = re.sub("^swing_(line|motor|gear)", lambda m: same[m[0]], name)
        p[n] = shown.p.get(name, p[n])
    rng, start = np.random.default_rng(1), shipped.start()
    for _ in range(100):
        x = start + rng.normal(size=start.size) * np.maximum(0.05, 0.1 * np.abs(start))
        u = [v + rng.normal() * max(0.1, 0.1 * abs(v)) for v in shown.u.values()]
        both = own.function(x, u, list(p.values())), shipped.function(x, u, list(shown.p.values()))
        for found, expected in zip(*both, strict=True):
            away = np.abs((found - expected).full())
            assert away.max() <= 1e-12 * np.abs(expected.full()).max()


def far_from_singular(j, weights):
    """Whether the inverse is not damped, with a margin: det(J W^-1 J^T) over that of two equal links."""
    square = j @ np.diag(1 / weights) @ j.T
    return np.linalg.det(square) > 1.1 * P["singular_share"] ** 2 * np.trace(square) ** 2 / 25


@given(POSES, SPEED, SPEED)
def test_the_joints_give_the_tip_its_velocity(pose, out, up):
    """J q' = v, J by differentiation of the tip's position; where nothing is damped, to rounding."""
    _, jacobian, speeds, weights, _ = (a.full() for a in AS_IT_IS([0, *pose], [out, up]))
    if far_from_singular(jacobian[:, 1:], weights[:, 0]):
        assert (jacobian @ speeds)[:, 0] == pytest.approx([out, up], abs=1e-9)


@given(POSES, SPEED, SPEED)
def test_without_a_wish_the_motion_needs_least_oil(pose, out, up):
    """Against W^-1 J^T (J W^-1 J^T)^-1 v of NumPy; the weights there are those of the controller."""
    _, jacobian, speeds, weights, _ = (a.full() for a in LEAST_OIL([0, *pose], [out, up]))
    j, w = jacobian[:, 1:], np.diag(1 / weights[:, 0])
    if far_from_singular(j, weights[:, 0]):
        least = w @ j.T @ np.linalg.solve(j @ w @ j.T, [out, up])
        assert speeds[1:, 0] == pytest.approx(least, abs=1e-8 * max(1, np.abs(least).max()))


def test_weights_are_the_oil():
    """At mid-stroke of all pistons: their ratios are those of (A dx/dq)^2, areas the mean of both sides.

    Within 2 %: a share is added, and the ends of the strokes count a little.
    """
    q = np.array([0.0, *np.mean([*RANGES.values()], axis=1)])
    slopes, areas = [], []
    for k, name in enumerate(RANGES, 1):
        step = 1e-6 * (np.arange(4) == k)
        ends = [AS_IT_IS(q + s * step, [0, 0])[4].full()[k, 0] for s in (1, -1)]
        slopes.append((ends[0] - ends[1]) / 2e-6)
        areas.append(math.pi / 4 * (P[f"{name}_bore"] ** 2 - P[f"{name}_rod"] ** 2 / 2))
    oil, found = (np.array(areas) * slopes) ** 2, AS_IT_IS(q, [0, 0])[3].full()[:, 0]
    assert found / found.sum() == pytest.approx(oil / oil.sum(), rel=0.02)


def test_a_wish_leads_the_pistons_to_the_middle():
    """In and out on one line ten times, by the speeds alone: the extension is half as far from mid-stroke.

    The tip is where it began to 1 cm, after 4000 steps of 5 mm by Euler's method.
    """
    q, first = np.array([0.0, 0.35, -1.05, 0.4]), AS_IT_IS([0, 0.35, -1.05, 0.4], [0, 0])[0].full()[:, 0]
    for sign in (1, -1) * 10:
        for _ in range(200):
            q = q + 5e-3 * AS_IT_IS(q, [sign, 0])[2].full()[:, 0]
    at, *_, pistons = AS_IT_IS(q, [0, 0])
    middle = P["extension_stroke"] / 2
    assert at.full()[:, 0] == pytest.approx(first, abs=1e-2)
    assert abs(float(pistons[3]) - middle) < 0.5 * abs(0.4 - middle)


def test_an_arm_that_the_controller_does_not_know_is_told(tmp_path):
    """What it needs and what it found; the machine has none."""
    crane = read(changed(tmp_path, ('[slew]\naxis = "z"', '[slew]\naxis = "-z"')))
    assert crane_machine(crane).controller is None
    problem(lambda: controlled(crane), r"in the plane of the arm, got \[slew\] drive motor, axis -z$")
    lamp = '[lamp]\njoint = "prismatic"\naxis = "x"\nparent = "slew"\nmass = 20\n'
    lamp += '[second]\nparent = "extension"'
    follows = ('follows = "extension"', 'follows = "lamp"')
    crane = read(changed(tmp_path, ("[second]", lamp), follows))
    problem(lambda: controlled(crane), r"got \[second\] follows lamp$")


@pytest.mark.parametrize("beside", ["117 mm", "-0.4 m"])
def test_an_arm_beside_the_slewing_axis_moves_its_tip_as_asked(tmp_path, beside):
    """Velocities of the tip are the derivatives of its place, and the speeds of the joints give them.

    Its angle about the axis is that of x and y: atan(d/sqrt(r^2 - d^2)) ahead of the slew.
    """
    boom = '["-180 mm", 0, "1274 mm"]'
    whole = crane_machine(read(changed(tmp_path, (boom, boom.replace("0,", f'"{beside}",')))))
    sub, shown = whole.controller, outputs_at_start(whole.subsystems["manipulator"])
    arm, p = sub.model.arm, nested(sub.parameters, values(sub).p)
    q, rates, wanted = (ca.SX.sym(n, size) for n, size in (("q", 4), ("rates", 4), ("wanted", 3)))
    each = ca.vertsplit(q)

    def parts(at):
        return column(at.radius, at.height, at.angle)

    place = parts(arm.tip(each, p))
    place_of = ca.Function("place", [q], [place])
    speeds = column(*arm.joint_speeds(each, Cylindrical(*ca.vertsplit(wanted)), p))
    given = parts(arm.tip_velocity(each, ca.vertsplit(rates), p))
    found = ca.Function(
        "f", [q, rates, wanted], [place, given - ca.jtimes(place, q, rates), ca.jtimes(place, q, speeds)]
    )
    at, zero, moved = (
        x.full()[:, 0] for x in found([0.3, 0.35, -1.05, 0.4], [0.1, 0.2, -0.3, 0.05], [0.5, 0.2, 0.1])
    )
    start = place_of([shown[a.coordinate[0]] for a in arm.axes])
    own = [shown[f"crane_tip_{n}"] for n in ("radius", "height", "angle")]
    assert own == pytest.approx(start.full()[:, 0], abs=1e-9)  # of the mechanics; the start is solved
    d = float(beside.split()[0]) * (1e-3 if "mm" in beside else 1)
    assert at[2] == pytest.approx(0.3 + math.atan(d / math.sqrt(at[0] ** 2 - d**2)), abs=1e-12)
    assert zero == pytest.approx(np.zeros(3), abs=1e-12)  # rounding
    assert moved == pytest.approx([0.5, 0.2, 0.1], abs=1e-9)  # far from singular: not damped


def test_a_place_out_of_reach_is_told():
    """With the place and the reason; elsewhere the pose has its tip at the place."""
    told = "^12,0,1: tip at radius 12 m, height 1 m: (out of reach, the arm comes to radius|the piston of)"
    problem(lambda: start_angles("12,0,1", (12.0, 1.0, 0.0), {}, LOADER), told)
    found = start_angles("5,1,1", (5.0, 1.0, 0.3), {}, LOADER)
    pose = [found[f"manipulator.initial_{a.coordinate[0]}"] for a in ARM.axes]
    assert AS_IT_IS(pose, [0, 0])[0].full()[:, 0] == pytest.approx([5.0, 1.0], abs=1e-8)
    assert pose[0] == 0.3


AT_START = SimpleNamespace(real_parameters=dict, value=lambda _: 0.0)


def test_the_modes_of_a_grapple_are_those_of_its_axes():
    """Of loader.toml by hand: link and grapple together about the pin, the grapple alone about its axis."""
    both = (0.3 + 20 * 0.15**2 + 15 + 180 * 0.8**2) / (20 * 0.15 + 180 * 0.8), 147
    alone = (15 + 180 * 0.5**2) / (180 * 0.5), 90
    expected = [
        (2 * math.pi * math.sqrt(x / 9.81), 60 / (2 * math.sqrt(g * 9.81 * g * x))) for x, g in (both, alone)
    ]
    found = sorted(sway(machine().subsystems["manipulator"], AT_START), reverse=True)
    np.testing.assert_allclose(found, expected, rtol=1e-3)  # gravity to three digits


CHAINS = [  # length to the next pin [m], centre [m], mass [kg], inertia [kg.m2], damping [N.m.s/rad] of links
    [(0.3, 0.15, 20, 0.3, 60), (0.9, 0.5, 180, 15, 60)],
    [(0.5, 0.2, 30, 1.0, 5), (0.8, 0.4, 60, 4, 3)],
    [(0.4, 0.2, 15, 0.2, 4), (0.5, 0.25, 25, 0.5, 6), (0.7, 0.4, 120, 9, 25)],
]


@pytest.mark.parametrize("links", CHAINS, ids=len)
def test_modes_of_links_about_parallel_pins(tmp_path, links):
    """Of a chain of pendulums in absolute angles, by hand; an overdamped mode is none."""
    text, at = "", "177 mm"
    for k, (length, centre, mass, inertia, damping) in enumerate(links):
        text += f'[hung{k}]\naxis = "y"\nat = {[0, 0, at] if k else [at, 0, 0]}\nmass = {mass}\n'
        text += f"centre = [0, 0, {-centre}]\ninertia = [9, {inertia}, 9]\ndamping = {damping}\n"
        at = -length
    whole = changed(tmp_path).read_text(encoding="utf-8")
    before, end = whole[: whole.index("[link]")], whole[whole.index("[start]") :]
    payload = f'[payload]\non = "hung{k}"\nat = [0, 0, {at}]\n'
    crane = read(tmp_path / "crane.toml", (before + text + payload + end).encode())
    long, centres, mass, inertia, losses = np.array(links).T
    count = len(links)
    arms = np.tril(np.tile(long, (count, 1)), -1) + np.diag(centres)  # of body k by angle i
    relative = np.eye(count) - np.eye(count, k=-1)
    m = arms.T @ np.diag(mass) @ arms + np.diag(inertia)
    d, stiff = relative.T @ np.diag(losses) @ relative, np.diag(9.80665 * mass @ arms)
    nothing, one = np.zeros((count, count)), np.eye(count)
    roots = eigvals(np.block([[nothing, one], [-stiff, -d]]), np.block([[one, nothing], [nothing, m]]))
    size = abs(swinging := roots[roots.imag > 0])
    expected = sorted(zip(2 * np.pi / size, -swinging.real / size, strict=True))
    assert len(expected) == count - (links is CHAINS[0])
    found = sorted(sway(manipulator(crane), AT_START))
    # rounding, and 1e-9 of the shift in the balance at rest
    np.testing.assert_allclose(found, expected, rtol=1e-8)


@shards.machine
def test_the_loader_draws_a_line(loader_folder, tmp_path):
    """4 m in its plane with boom, jib and extension moving, valves with hysteresis: within 10 mm."""
    system = load(loader_folder / "loader_control.ssp")
    names, mechanics = tracked(system)
    path, _ = write_route(["7.5,0,1", "3.5,0,1", "7.5,0,1"], 0.5, tmp_path)
    given = system.components["manipulator"].real_parameters()
    start = start_angles("", (7.5, 1.0, 0.0), given, mechanics.controller)
    found = follow(system, names, path, "loader", True, start)
    assert not found.failure
    assert found.largest < 10e-3
    assert found.rms < 3e-3
