"""What cranes of makers have: cylinders about any axis, several at a joint, with masses, linkages beside."""

from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from crane.rigid_bodies import bodies, mass_and_weight

from fmus.contract import nested
from fmus.crane.description import read
from fmus.crane.manipulator import manipulator
from fmus.parameters import values

# a king post turned by a cylinder, a boom on two cylinders with masses, a bucket over a linkage with masses
# whose rod is beside the joint of its bars, on a slope
DIGGER = """
[post]
axis = "AXIS"
at = [1.0, 0.1, 0.4]
mass = 60
centre = [0.1, 0.02, 0.1]
inertia = [3, 4, 3]
drive = "cylinder"
hydraulics = { valve = "8 mm2" }
[post.cylinder]
base = BASE
pin = PIN
closed = 0.45
stroke = 0.14
bore = "60 mm"
rod = "35 mm"
barrel_mass = 9
rod_mass = 5
[boom]
axis = "-y"
at = [0.3, -0.05, 0.2]
mass = 150
centre = [1.0, 0.01, 0.3]
inertia = [4, 60, 60]
drive = "cylinder"
cylinder = { base = [0.1, -0.6], pin = [0.8, 0.3], closed = 0.7, stroke = 0.45, \
bore = "60 mm", rod = "40 mm", count = 2, barrel_mass = 12, rod_mass = 8 }
[bucket]
axis = "-y"
at = [2.1, 0, 0.1]
mass = 70
centre = [0.3, 0, -0.1]
inertia = [4, 5, 5]
drive = "four-bar"
cylinder = { base = [-1.3, 0.5], closed = 0.95, stroke = 0.55, bore = "55 mm", rod = "30 mm", rod_mass = 6 }
four_bar = { pivot = [-0.25, 0.02], rocker = 0.35, coupler = 0.36, pin = [0.05, 0.22], rod = [0.3, 0.06], \
assembly = "above", rocker_mass = 7, coupler_mass = 4 }
[payload]
on = "bucket"
at = [0.7, 0, -0.2]
[base]
pitch = "5 deg"
roll = "-8 deg"
"""
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
