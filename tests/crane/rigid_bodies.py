"""Links as a model of Pinocchio, a rigid-body library with algorithms of its own."""

import numpy as np


def unit(axis):
    """The unit vector of an axis such as "-y"."""
    return np.eye(3)["xyz".index(axis[-1])] * (-1.0 if axis[0] == "-" else 1.0)


def mass_and_weight(pin, tree, data, q):
    """M and G by Newton-Euler: the composite bodies of Pinocchio need depth-first numbers."""
    rest = np.zeros(tree.nv)
    weight = pin.computeGeneralizedGravity(tree, data, q).copy()
    return np.array([pin.rnea(tree, data, q, rest, one) - weight for one in np.eye(tree.nv)]), weight


def bodies(pin, links, gravity, payload=None):
    """The links as a Pinocchio model, with a frame at the payload."""
    tree = pin.Model()
    tree.gravity.linear = np.array([float(g) for g in gravity])
    for i, link in enumerate(links):
        revolute, prismatic = pin.JointModelRevoluteUnaligned, pin.JointModelPrismaticUnaligned
        joint = (revolute if link.joint == "revolute" else prismatic)(unit(link.axis))
        parent = 0 if link.parent is None else link.parent + 1
        number = tree.addJoint(parent, joint, pin.SE3(np.eye(3), np.array(link.at, float)), link.name)
        centre = np.array(link.centre, float)
        if link.inertia == "bar":  # a uniform bar of the length 2 |c|: m L^2/12 across
            square = link.mass * 4 * (centre @ centre * np.eye(3) - np.outer(centre, centre)) / 12
        else:
            xx, yy, zz, xy, xz, yz = link.inertia
            square = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]], float)
        tree.appendBodyToJoint(number, pin.Inertia(link.mass, centre, square), pin.SE3.Identity())
        if payload and payload.link == i:
            place = pin.SE3(np.eye(3), np.array(payload.at, float))
            tree.appendBodyToJoint(number, pin.Inertia(payload.mass, np.zeros(3), np.zeros((3, 3))), place)
            tree.addFrame(pin.Frame("payload", number, 0, place, pin.FrameType.OP_FRAME))
    return tree, tree.createData()
