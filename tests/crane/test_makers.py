"""What cranes of makers have: cylinders about any axis, several at a joint, with masses, linkages beside."""

from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from crane.rigid_bodies import bodies, mass_and_weight
from kit.equations import Part
from kit.mistakes import entry, problem

from fmus.contract import nested
from fmus.crane.axes import Capacity, modes
from fmus.crane.check import check, table
from fmus.crane.description import read
from fmus.crane.manipulator import manipulator
from fmus.parameters import values

# a king post turned by a cylinder, a boom on two cylinders with masses, a bucket over a linkage with masses
# whose rod is beside the joint of its bars, on a slope
DIGGER = entry(__file__, "digger")
# axis -> pins of the post in the plane of its other coordinates; the same cylinder each time
POSTS = {
    "z": ("[-0.5, 0.25]", "[0.1, 0.18]"),
    "-z": ("[-0.5, -0.25]", "[0.1, -0.18]"),
    "x": ("[-0.5, 0.25]", "[0.1, 0.18]"),
    "-x": ("[-0.5, -0.25]", "[0.1, -0.18]"),
    "-y": ("[-0.5, 0.25]", "[0.1, 0.18]"),
    "y": ("[-0.5, -0.25]", "[0.1, -0.18]"),
}


def digger(axis="z", *changes):
    """With its post about an axis, and other texts."""
    base, pin = POSTS[axis]
    text = DIGGER.replace("AXIS", axis).replace("BASE", base).replace("PIN", pin)
    for old, by in changes:
        assert old in text
        text = text.replace(old, by)
    return read(Path("digger.toml"), text.encode())


def model(crane):
    """Its chain with numbers, and the parameters."""
    sub = manipulator(crane)
    p = nested(sub.model.parameters, values(sub).p)
    return sub.model.chain(p), sub.model, p


def place(pin, tree, data, link, at):
    """Of a point of a link, and its Jacobian, by Pinocchio."""
    turn, origin = data.oMi[link + 1].rotation, data.oMi[link + 1].translation
    jacobian = pin.getJointJacobian(tree, data, link + 1, pin.LOCAL_WORLD_ALIGNED)
    arm = turn @ at
    return origin + arm, jacobian[:3] + np.cross(jacobian[3:].T, arm).T


@pytest.mark.parametrize("axis", POSTS)
def test_bars_close_and_move_as_pinocchio_s(pin, axis):
    """Rods meet their pins, rocker and coupler theirs; M and G are those of the tree, held by these closures.

    The tree has each barrel, rod, rocker and coupler as a joint of its own; speeds follow from the closures.
    """
    crane = digger(axis)
    chain, of, _ = model(crane)
    names = [link.name for link in chain.links]
    u, v, side = crane.joint("post").plane
    post = np.zeros(3)
    post[["xyz".index(u), "xyz".index(v)]] = crane.joint("post")[f"pin_{u}"], crane.joint("post")[f"pin_{v}"]
    assert side == (-1.0 if axis in ("y", "-x", "-z") else 1.0)
    ends = [  # two points that are one, with their links
        ("post_rod", np.zeros(3), "post", post),
        ("boom_rod", np.zeros(3), "boom", np.array([0.8, 0, 0.3])),
        ("bucket_rod", np.zeros(3), "bucket_rocker", np.array([0.3, 0, 0.06])),
        ("bucket_coupler", np.array([0.36, 0, 0]), "bucket", np.array([0.05, 0, 0.22])),
    ]
    tree, data = bodies(pin, chain.links, chain.gravity)
    s = ca.SX.sym("s", 3)
    motion = chain.equations(s, 0 * s)
    own = ca.Function("own", [s], [motion.mass, motion.gravity, ca.vertcat(*chain.joints(s))])
    rng = np.random.default_rng(1)
    for q in rng.uniform([-0.2, -0.1, -0.4], [0.1, 0.3, 0.1], (20, 3)):
        mass, gravity, joints = (x.full() for x in own(q))
        at = joints[:, 0]
        pin.computeJointJacobians(tree, data, at)
        rows = []
        for one, here, other, there in ends:
            (a, left), (b, right) = (
                place(pin, tree, data, names.index(n), x) for n, x in ((one, here), (other, there))
            )
            np.testing.assert_allclose(a, b, atol=1e-12)  # rounding
            rows.append(left - right)
        closures = np.vstack(rows)
        free = [names.index(j.name) for j in of.free]
        rest = [k for k in range(len(names)) if k not in free]
        turn = np.zeros((len(names), 3))
        turn[free] = np.eye(3)
        turn[rest] = -np.linalg.lstsq(closures[:, rest], closures[:, free], rcond=None)[0]
        inertia, weight = mass_and_weight(pin, tree, data, at)
        np.testing.assert_allclose(mass, turn.T @ inertia @ turn, atol=1e-9 * mass.max())
        np.testing.assert_allclose(gravity[:, 0], turn.T @ weight, atol=1e-9 * np.abs(gravity).max())


def test_two_cylinders_are_one_of_their_areas():
    """Twice the force, flow, dead volume, friction and masses; bore and rod of one as in the file."""
    two, one = (digger("z", *c) for c in ((), [("count = 2, ", "")]))
    joints = [crane.joint("boom") for crane in (two, one)]
    for area in ("bore", "rod"):
        assert joints[0][area] ** 2 == pytest.approx(2 * joints[1][area] ** 2)
    for name in ("dead_volume", "piston_damping", "barrel_mass", "rod_mass"):
        assert joints[0][name] == pytest.approx(2 * joints[1][name])
    assert check(two)[1].push == pytest.approx(2 * check(one)[1].push)


@pytest.mark.parametrize("axis", ["z", "-z", "x"])
def test_energy_closes_with_bars_stops_and_friction(axis):
    """At random states: power of the cylinders less heat is the rate of all energies, as identity.

    A passive slide with dry friction and stops that are not alike, and one that follows it with damping.
    """
    slides = entry(__file__, "slides")
    of = Part(manipulator(digger(axis, ('[payload]\non = "bucket"\n', slides))))
    stored = ("kinetic_energy", "potential_energy", "stop_energy", "elastic_energy")
    y = ca.vertcat(*(of.expressions["y"][n] for n in stored))
    rates = of.of(ca.jtimes(y, of.model.x, of.model.dx))
    rng, stopped, rubbed = np.random.default_rng(3), 0, 0
    for _ in range(30):
        state = {n: rng.uniform(-0.1, 0.1) for n in of.states} | {"held_mass": 50.0, "payload_flow": 0.0}
        state |= {n: rng.uniform(-1e-4, 1e-4) for n in of.states if n.endswith("bristle")}
        state["slide_extension"] = rng.uniform(-0.08, 0.23)
        u = dict.fromkeys(of.inputs, 0.0)
        u |= {f"{n}_force": rng.uniform(-1e4, 1e4) for n in ("post", "boom", "bucket")}
        x = np.array([state[n] for n in of.states])
        _, s = of(x, **u)
        given = sum(u[f"{n}_force"] * s[f"{n}_velocity"] for n in ("post", "boom", "bucket"))
        (changes,) = rates(x, **u)
        size = np.abs(changes).sum() + abs(given) + s["dissipated_power"]
        assert abs(changes.sum() - given + s["dissipated_power"]) < 1e-9 * size  # identity
        assert s["second_extension"] == pytest.approx(0.1 - 0.5 * state["slide_extension"])
        stopped += abs(s["slide_stop_torque"]) > 1
        rubbed += abs(s["slide_friction_joint_force"]) > 10
    assert min(stopped, rubbed) > 3


def test_modes_of_all_axes_are_those_of_masses_and_oil():
    """K v = w^2 M v, the eigenvalues of M^-1 K; of a single axis its own entries of both."""
    text = DIGGER.partition("[bucket]")[0] + '[payload]\non = "boom"\nat = [2, 0, 0]\n'
    crane = read(
        Path("two.toml"),
        text.replace("AXIS", "-y").replace("BASE", POSTS["-y"][0]).replace("PIN", POSTS["-y"][1]).encode(),
    )
    axes, (chain, *_) = check(crane), model(crane)
    q = np.array([0.0, 0.0])
    mass = ca.Function("m", [s := ca.SX.sym("s", 2)], [chain.equations(s, 0 * s).mass])(q).full()
    stiffness = np.diag([a.stiffness for a in axes])
    squares = np.linalg.eigvals(np.linalg.solve(mass, stiffness))
    assert modes(crane, axes) == pytest.approx(np.sqrt(np.sort(squares)) / (2 * np.pi), rel=1e-9)
    for k, a in enumerate(axes):
        assert a.mode == pytest.approx(np.sqrt(a.stiffness / mass[k, k]) / (2 * np.pi), rel=1e-9)


def test_what_has_no_controller_is_told():
    """A post that a cylinder turns is no slewing motor; said by the check, before the build."""
    crane = digger()
    nothing = Capacity(np.zeros((1, 2)), lambda poses: np.zeros((3, *poses.shape[1:])))
    told = table(crane, check(crane), nothing, {})
    assert "note: without a controller of its tip: digger.toml: the controller needs a slewing joint" in told


STOPS = {"low": "stop = { from = -0.5 }", "high": "stop = { at = -0.1, from = -0.5 }"}


def test_stops_that_are_not_alike_need_both_ends():
    """The upper end is a key that a file must have; the start is between both."""
    text = DIGGER.replace("AXIS", "z").replace("BASE", POSTS["z"][0]).replace("PIN", POSTS["z"][1])
    lines = [
        problem(lambda s=s: read(Path("a.toml"), f'{text}[hook]\naxis = "x"\nmass = 1\n{s}\n'.encode()))
        for s in STOPS.values()
    ]
    assert "[hook.stop] at: expected a number in rad, got nothing" in lines[0]
    assert "[start] hook: expected between the end stops of the joint, got 0" in lines[1]


# extension -> coordinates of the stages and their slopes, between the corners
SEQUENCE = {
    0.3: ((0.3, 0.0), (1.0, 0.0)),
    0.8: ((0.8, 0.3), (1.0, 1.5)),
    1.7: ((1.1, 1.65), (0.0, 1.5)),
    2.6: ((1.1, 2.25), (0.0, 0.0)),
}


@pytest.mark.parametrize("out", SEQUENCE)
def test_stages_of_a_telescope_move_one_after_the_other(pin, out):
    """Each in its part of the way of the outer one: masses, weights, damping; by Pinocchio and by hand."""
    text = entry(__file__, "telescope") + f"[start]\nboom = 0.2\nlast = {out}\n"
    crane = read(Path("telescope.toml"), text.encode())
    chain, *_ = model(crane)
    tree, data = bodies(pin, chain.links, chain.gravity)
    s = ca.SX.sym("s", 2)
    motion = chain.equations(s, 0 * s)
    own = ca.Function("own", [s], [motion.mass, motion.gravity, ca.vertcat(*chain.joints(s))])
    mass, gravity, joints = (x.full() for x in own([0.2, out]))
    (stage, middle), slopes = SEQUENCE[out]
    assert joints[:, 0] == pytest.approx([0.2, out, stage, middle], abs=1e-12)  # exact off the corners
    turn = np.array([[1, 0], [0, 1], [0, slopes[0]], [0, slopes[1]]])
    inertia, weight = mass_and_weight(pin, tree, data, joints[:, 0])
    np.testing.assert_allclose(mass, turn.T @ inertia @ turn, atol=1e-9 * mass.max())
    np.testing.assert_allclose(gravity[:, 0], turn.T @ weight, atol=1e-9 * np.abs(gravity).max())
    axis = check(crane)[1]
    assert axis.damping == pytest.approx(700 + 500 * slopes[0] ** 2 + 300 * slopes[1] ** 2)
    assert axis.holding == pytest.approx(gravity[1, 0] / (np.pi / 4 * 0.08**2), rel=1e-9)


# kind of the follower, keys -> coordinate of the leader, which turns: that of the follower
WAYS = {
    ("revolute", "from = 0"): {-0.4: 0.0, 0.3: 0.3},
    ("revolute", "to = 0"): {-0.4: -0.4, 0.3: 0.0},
    ("revolute", "from = -0.5\nto = 0"): {-0.6: 0.0, -0.2: 0.3, 0.3: 0.5},
    ("revolute", "to = -0.1"): {-0.4: -0.4, 0.3: -0.1},
    ("prismatic", 'ratio = 0.2\nfrom = "10 deg"\nto = "20 deg"'): {
        0.1: 0.0,
        np.radians(15): 0.2 * np.radians(5),
        0.5: 0.2 * np.radians(10),
    },
}


@pytest.mark.parametrize(("kind", "keys"), WAYS)
def test_the_part_of_a_way_has_the_ends_that_a_file_gives(kind, keys):
    """Also at 0, and in the unit of the joint that is followed; without a key there is no end."""
    wing = f'[wing]\njoint = "{kind}"\naxis = "z"\nmass = 5\nfollows = "last"\n{keys}\n[payload]'
    text = entry(__file__, "telescope").replace(
        'joint = "prismatic"\naxis = "x"\nat = [2,', 'axis = "z"\nat = [2,'
    )
    text = text.replace('"cylinder"\ncylinder = { stroke', '"motor"\nmotor = { displacement = 1e-3 } #')
    crane = read(Path("wing.toml"), text.replace("[payload]", wing).encode())
    chain, *_ = model(crane)
    s = ca.SX.sym("s", 2)
    joints = ca.Function("joints", [s], [ca.vertcat(*chain.joints(s))])
    for at, expected in WAYS[kind, keys].items():
        assert float(joints([0, at])[-1]) == pytest.approx(expected, abs=1e-12)  # exact off the corners
        assert crane.joint("wing").following(at) == pytest.approx(expected, abs=1e-12)


def test_a_load_on_a_hook_hangs_at_its_rope():
    """A rope is two passive joints, a winch a cylinder along it: its pull, and the modes of a pendulum."""
    crane = read(Path("hook.toml"), entry(__file__, "hook").encode())
    _, rope = axes = check(crane)
    gravity = 9.80665
    # it pulls with its rod side; gravity of the file of the paper
    assert rope.holding == pytest.approx(520 * gravity / (np.pi / 4 * (0.04**2 - 0.02**2)), rel=1e-4)
    assert (rope.low, rope.high) == (0, 6)
    chain, _, _ = model(crane)
    s, w = ca.SX.sym("s", 4), ca.SX.sym("w", 4)
    motion = chain.equations(s, w)
    pull = ca.Function("pull", [s, w], [motion.gravity[3], motion.coriolis[3]])
    # hook at 2.5 m + 1.5 m, aside by 0.3 rad, turning with 0.7 rad/s: m (g cos + l w^2)
    weight, swung = map(float, pull([0, 0.3, 0, 1.5], [0, 0.7, 0, 0]))
    assert (weight, swung) == pytest.approx((-20 * 9.81 * np.cos(0.3), -20 * 4 * 0.49), rel=1e-3)
    sway = np.sqrt(gravity / 2.5) / (2 * np.pi)
    assert modes(crane, axes)[:2] == pytest.approx([sway, sway], rel=1e-2)  # the hook's own inertia, its boom
