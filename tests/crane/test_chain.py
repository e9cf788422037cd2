"""Chains of rigid links against Pinocchio, and at rest."""

import math
from dataclasses import replace
from functools import cache, partial

import casadi as ca
import numpy as np
import pytest
from crane.rigid_bodies import bodies, mass_and_weight
from hypothesis import assume, given
from hypothesis import strategies as st
from kit.mistakes import problem
from kit.properties import examples

from fmus.components.chain import Chain, Link, Payload, gravity_on_slope

seeds = st.integers(0, 2**32 - 1)
TIP = (0.1, -0.2, -0.7)  # m, of the payload in the frame of the last link of CRANE
PITCH, ROLL, LOAD = ca.SX.sym("pitch"), ca.SX.sym("roll"), ca.SX.sym("load")
CRANE = (
    Link("slew", "revolute", "z", (0, 0, 0.4), None, 300.0, (0.1, 0.02, 0.5), (10, 12, 20, 0.5, 0.3, 0.2)),
    Link("boom", "revolute", "-y", (0.1, 0, 1.5), 0, 250.0, (1.5, 0, 0.1), (3, 150, 150, 0, 1, 0)),
    Link("jib", "revolute", "-y", (3.5, 0, 0.3), 1, 200.0, (0.8, 0, 0.1), (2, 100, 100, 0, 0.5, 0)),
    Link("telescope", "prismatic", "x", (0.5, 0, 0), 2, 80.0, (0.9, 0, 0), "bar"),
    Link("pin", "revolute", "-y", (1.8, 0, 0), 3, 10.0, (0, 0, -0.1), (0.1, 0.1, 0.05, 0, 0, 0)),
    Link("yoke", "revolute", "x", (0, 0, -0.2), 4, 15.0, (0, 0, -0.2), (0.1, 0.1, 0.05, 0, 0, 0)),
    Link("rotator", "revolute", "z", (0, 0, -0.4), 5, 150.0, (0.05, 0, -0.5), (8, 12, 6, 0.1, 0.2, 0.3)),
)
SLOPE = Chain(CRANE, gravity_on_slope(9.81, PITCH, ROLL))


def terms_of(m):
    """M, V, G, T, U, and what a kilogram adds to M q', T and U."""
    terms = m.mass, m.coriolis, m.gravity, m.kinetic, m.potential, *vars(m.per_kilogram).values()
    return [ca.densify(ca.SX(term)) for term in terms]


def of_motion(chain, payload):
    """(q, speed) -> the terms."""
    count = sum(link.follows is None for link in chain.links)
    q, w = ca.SX.sym("q", count), ca.SX.sym("w", count)
    return ca.Function("motion", [q, w], terms_of(chain.equations(q, w, payload)))


def numbers(function, *arguments):
    """The results of a function as arrays without dimensions of length 1."""
    return [result.full().squeeze() for result in function.call([ca.DM(a) for a in arguments])]


def same(ours, theirs, accuracy):
    """Each pair agrees within `accuracy` of its largest entry."""
    for own, expected in zip(ours, theirs, strict=True):
        np.testing.assert_allclose(own, expected, rtol=0, atol=accuracy * max(np.abs(expected).max(), 1.0))


def by_pinocchio(pin, model, q, w):
    """M, V and G by Newton-Euler, and both energies."""
    mass, gravity = mass_and_weight(pin, *model, q)
    coriolis = pin.rnea(*model, q, w, np.zeros(len(q))) - gravity
    energies = pin.computeKineticEnergy(*model, q, w), pin.computePotentialEnergy(*model, q)
    return [mass, coriolis, gravity, *energies]


def payload_by_pinocchio(pin, model, q, w):
    """Place, Jacobian and velocity of the payload."""
    tree, data = model
    frame, axes = tree.getFrameId("payload"), pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
    jacobian = pin.computeFrameJacobian(tree, data, q, frame, axes)[:3]
    pin.framesForwardKinematics(tree, data, q)
    return data.oMf[frame].translation.copy(), jacobian, jacobian @ w


def test_gravity_on_a_slope_is_that_of_a_turned_base(pin):
    """By the turns of Pinocchio; z of the base is upwards in the world."""
    for pitch, roll in np.random.default_rng(1).uniform(-0.5, 0.5, (20, 2)):
        turn = pin.rpy.rpyToMatrix(roll, pitch, 0.0)
        found = [float(g) for g in gravity_on_slope(9.81, pitch, roll)]
        np.testing.assert_allclose(found, turn.T @ [0, 0, -9.81], atol=1e-14)  # rounding


def point(rng, size=1.0):
    """A random place [m] or direction."""
    return tuple(rng.uniform(-size, size, 3).tolist())


def random_inertia(rng):
    """Moments of inertia of some body: the six numbers of (tr S) 1 - S, S positive definite."""
    places = rng.uniform(-2, 2, (3, 3))
    second = places @ places.T
    inertia = np.trace(second) * np.eye(3) - second
    return (*np.diag(inertia).tolist(), *inertia[np.triu_indices(3, 1)].tolist())


def line(ratio, offset, q):
    """The coordinate of a link that follows another one."""
    return ratio * q + offset


def random_links(rng):
    """A tree of two to seven links; about one in four follows another link with a ratio."""
    links = []
    for i in range(rng.integers(2, 8)):
        free = [j for j, link in enumerate(links) if link.follows is None]
        link = Link(
            f"link {i}",
            str(rng.choice(["revolute", "prismatic"])),
            str(rng.choice(["x", "y", "z", "-x", "-y", "-z"])),
            point(rng, 2.0),
            None if i == 0 or rng.random() < 0.1 else int(rng.integers(i)),
            float(rng.uniform(0, 100)),
            point(rng),
            "bar" if rng.random() < 0.3 else random_inertia(rng),
        )
        if free and rng.random() < 0.3:
            ratio, offset = rng.uniform(-3, 3, 2).tolist()
            link = replace(link, follows=int(rng.choice(free)), law=partial(line, ratio, offset))
        links.append(link)
    return tuple(links)


def joints_of(chain):
    """Matrix and column from q to the coordinates of all joints."""
    free = [i for i, link in enumerate(chain.links) if link.follows is None]
    matrix, column = np.zeros((len(chain.links), len(free))), np.zeros(len(chain.links))
    for i, link in enumerate(chain.links):
        column[i] = link.law(0.0)
        matrix[i, free.index(i if link.follows is None else link.follows)] = link.law(1.0) - column[i]
    return matrix, column


@examples(60)
@given(seed=seeds)
def test_any_tree_is_pinocchio_s(pin, seed):
    """Trees with revolute and prismatic joints about all axes, also with joints that follow others."""
    rng = np.random.default_rng(seed)
    links, gravity, at = random_links(rng), point(rng, 7.0), point(rng)
    load = Payload(int(rng.integers(len(links))), at, float(rng.uniform(0, 100)))
    chain = Chain(links, gravity)
    turn, shift = joints_of(chain)
    q, w = rng.uniform(-3, 3, turn.shape[1]), rng.uniform(-2, 2, turn.shape[1])
    model = bodies(pin, links, gravity, load)
    mass, coriolis, weight, *energies = by_pinocchio(pin, model, turn @ q + shift, turn @ w)
    place, jacobian, velocity = payload_by_pinocchio(pin, model, turn @ q + shift, turn @ w)
    theirs = [turn.T @ mass @ turn, turn.T @ coriolis, turn.T @ weight, *energies]
    theirs += [turn.T @ jacobian.T @ velocity, velocity @ velocity / 2, -np.array(gravity) @ place]
    # exact identities; 1e-12 of the largest entry is 1e4 rounding errors; its terms are larger than their sum
    same(numbers(of_motion(chain, load), q, w), [np.squeeze(t) for t in theirs], 1e-12)
    f, (angles, speeds) = rng.uniform(-1e3, 1e3, 3), (ca.SX.sym(n, len(q)) for n in "qw")
    terms = [chain.position(angles, load.link, at), chain.velocity(angles, speeds, load.link, at)]
    terms += [chain.generalised_force(angles, ca.DM(f), load.link, at)]
    terms += [entry for frame in chain.frames(angles) for entry in (frame.origin, frame.rotation)]
    frames = [entry for frame in [*model[1].oMi][1:] for entry in (frame.translation, frame.rotation)]
    theirs = [place, velocity, np.squeeze(turn.T @ jacobian.T @ f), *frames]
    same(numbers(ca.Function("points", [angles, speeds], terms), q, w), theirs, 1e-12)


def test_what_is_not_stated_is_zero():
    """A link without numbers has no mass and its parent's origin; points are origins, the base is level."""
    zero, chain, q, w, f = (0, 0, 0), Chain(CRANE), ca.DM(range(7)), ca.DM(range(7)), ca.DM([5, 6, 7])
    bare, none = Link("a", "revolute", "y"), {"parent": None, "mass": 0, "follows": None}
    assert bare == replace(bare, at=zero, centre=zero, inertia=2 * zero, **none)
    for method, *of in ((chain.position, q), (chain.velocity, q, w), (chain.generalised_force, q, f)):
        np.testing.assert_array_equal(ca.DM(method(*of, 6)).full(), ca.DM(method(*of, 6, zero)).full())
    assert tuple(map(float, gravity_on_slope(9.81))) == chain.gravity


@cache
def crane_at_rest(passive):
    """(q, pitch, roll, load) -> q at rest, acceleration, and dU, d2U over the passive joints."""
    q, s, load = ca.SX.sym("q", 7), ca.SX.sym("s", 7), Payload(6, TIP, LOAD)
    rest, held = SLOPE.at_rest(q, passive, load), ca.SX.ones(7)
    held[[*passive]] = 0
    motion = SLOPE.equations(rest, ca.SX.zeros(7), load)
    curvature, slope = ca.hessian(SLOPE.potential(s, load), s)
    local = ca.substitute([slope[[*passive]], curvature[[*passive], [*passive]]], [s], [rest])
    terms = [rest, motion.acceleration(held * motion.gravity), *local]
    return ca.Function("rest", [q, PITCH, ROLL, LOAD], terms)


@pytest.mark.parametrize(("passive", "within"), [((4, 5), math.pi), ((4, 5, 6), 0.5)])
@given(seed=seeds)
def test_passive_joints_of_a_crane_on_a_slope_start_at_rest(passive, within, seed):
    """Whatever pose, slope and load: held by its other joints, the crane does not accelerate.

    within   distance of the guess from the rest; the rotator's load is eccentric, so it has one
    """
    rng, find = np.random.default_rng(seed), crane_at_rest(passive)
    q, slope, load = rng.uniform(-math.pi, math.pi, 7), rng.uniform(-0.5, 0.5, 2), rng.uniform(0, 800)
    for _ in range(10):  # some rest, from anywhere
        q, acceleration, _, stiffness = numbers(find, q, *slope, load)
    assume(np.abs(acceleration).max() < 1e-9 and np.linalg.eigvalsh(stiffness).min() > 0)
    guess = q.copy()
    guess[[*passive]] += rng.uniform(-within, within, len(passive))
    rest, acceleration, slopes, stiffness = numbers(find, guess, *slope, load)
    held = [i for i in range(7) if i not in passive]
    assert [*rest[held]] == [*guess[held]]
    # rounding of torques up to 1e4 N.m, over inertias of some kg.m2
    assert np.abs(acceleration).max() < 1e-9
    # rounding of the same torques, over stiffnesses of 1e3 N.m/rad
    assert np.abs(np.linalg.solve(stiffness, slopes)).max() < 1e-12
    assert np.linalg.eigvalsh(stiffness).min() > 0  # it hangs, and does not stand on its head


def test_joint_that_gravity_does_not_turn_keeps_its_angle():
    """A rotator with its centre of mass on its axis, joints without gravity and joints held keep their q."""
    links = (*CRANE[:6], replace(CRANE[6], centre=(0, 0, -0.5)))
    guess = ca.DM([0.1, 0.5, -1.0, 0.3, 0.4, 0.2, 0.7])
    rest = Chain(links).at_rest(guess, (4, 5, 6))
    assert float(rest[6]) == 0.7
    assert float(rest[4]) == pytest.approx(0.5, abs=1e-14)  # hangs from boom and jib: their sum is -0.5
    without = Chain(links, (0, 0, 0)).at_rest(guess, (4, 5))
    np.testing.assert_array_equal(ca.DM(without).full(), guess.full())
    assert float(Chain(links[:1]).at_rest(guess[:1], ())) == 0.1


MISTAKES = {
    "joint": ({"joint": "fixed"}, "jib: joint: expected revolute or prismatic, found 'fixed'"),
    "axis": ({"axis": "w"}, "jib: axis: expected one of x, y, z, -x, -y, -z, found 'w'"),
    "parent": ({"parent": 2}, "jib: parent: expected None or an index below 2, found 2"),
    "follows": ({"follows": 2}, "jib: follows: expected None or one of [0, 1, 3, 4, 5, 6], found 2"),
    "inertia": ({"inertia": (1, 2, 3)}, 'jib: inertia: expected "bar" or six numbers, found (1, 2, 3)'),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_mistake_in_a_link_is_named(mistake):
    """A link that makes no tree is refused with its name, what was expected and what was found."""
    changed, message = MISTAKES[mistake]
    assert message in problem(lambda: Chain((*CRANE[:2], replace(CRANE[2], **changed), *CRANE[3:])))


def test_sliding_joint_has_no_rest():
    """Gravity has no rest for a prismatic joint."""
    told = "telescope: expected a revolute joint at rest, found a prismatic one"
    problem(lambda: Chain(CRANE).at_rest(ca.DM.zeros(7), (3, 4)), told)
