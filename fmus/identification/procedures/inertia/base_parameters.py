"""Base parameters of the arm: the combinations of inertial parameters that its motion can tell at all.

Momenta and forces are linear in the standard parameters of the links (first row column, then boom and stick)

    J_0      m, m x, m z, S_xx, S_xz, S_zz         S_ab = int a b dm about the link's pivot

with slender links, all mass in the plane of the arm, and the head as part of the stick. Their columns are
derivatives of the manipulator's equations: m from the mass, m x from mass and centre, S_xx from the inertia,
S_xz and S_zz from the mass and the centre twice. Columns of which the others make a combination are found by
QR (Gautier 1991, J. Robotic Systems 8, 485) and their parameters added to the others.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import casadi as ca
import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from fmus.contract import symbols
from fmus.identification.procedures.balance.motion import JOINTS, PARAMETERS
from fmus.manipulator import MANIPULATOR, arm
from fmus.manipulator.design import POINT_MASS

Array = NDArray[np.float64]
MOMENTS = {"m": "kg", "m x": "kg.m", "m z": "kg.m", "S_xx": "kg.m2", "S_xz": "kg.m2", "S_zz": "kg.m2"}
STANDARD = ("column J_0", *(f"{link} {moment}" for link in ("boom", "stick") for moment in MOMENTS))
UNITS = ("kg.m2", *(unit for _ in ("boom", "stick") for unit in MOMENTS.values()))
# the first of these that are independent are kept: moments about the pivots before masses
PREFERRED = [0, 2, 3, 4, 5, 6, 8, 9, 10, 11, 12, 1, 7]
RANK = 1e-9  # of the largest diagonal of R, below which a column is a combination of others


@lru_cache(maxsize=1)
def regressor() -> ca.Function:
    """(q, q', q'', p) -> dh/dpi, df/dpi and torques by pi, each (3, 13) beside each other."""
    x, p = symbols(MANIPULATOR.states), symbols(MANIPULATOR.parameters)
    motion = arm.mechanics(x, p, POINT_MASS)
    q, w = (ca.vertcat(*(getattr(x, f"{j}_{k}") for j in JOINTS)) for k in ("angle", "speed"))
    momentum = motion.mass @ w
    force = ca.jtimes(momentum, q, w) - motion.coriolis - motion.gravity
    by_momentum, by_force = _columns(momentum, p), _columns(force, p)
    a = ca.SX.sym("a", 3)
    rate = ca.horzcat(*(ca.jtimes(h, q, w) + ca.jtimes(h, w, a) for h in ca.horzsplit(by_momentum)))
    machine = ca.SX.sym("p", len(PARAMETERS))
    own = ca.vertcat(*(machine[PARAMETERS.index(f"manipulator.{n}")] for n in vars(p)))
    terms = ca.substitute([by_momentum, by_force, rate - by_force], [ca.vertcat(*vars(p).values())], [own])
    return ca.Function("regressor", [q, w, a, machine], [ca.densify(t) for t in terms])


def _columns(term: ca.SX, p: object) -> ca.SX:
    """Derivatives of momenta or forces by the standard parameters, shape (3, 13)."""
    columns = [ca.jacobian(term, p.column_inertia)]  # type: ignore[attr-defined]
    for link in ("boom", "stick"):
        mass, inertia, cx, cz = (
            getattr(p, f"{link}_{n}") for n in ("mass", "inertia", "centre_x", "centre_z")
        )
        by_mass = ca.jacobian(term, mass)
        by_x, by_z = ca.jacobian(by_mass, cx), ca.jacobian(by_mass, cz)
        at_pivot = [by_mass, by_x, by_z, ca.jacobian(by_x, cz), ca.jacobian(by_z, cz) / 2]
        m, mx, mz, xz, zz = ca.substitute(at_pivot, [ca.vertcat(cx, cz)], [ca.DM.zeros(2)])
        columns += [m, mx, mz, ca.jacobian(term, inertia), xz, zz]
    return ca.horzcat(*columns)


def standard(p: Array) -> Array:
    """The standard parameters of the machine's, shape (13,)."""
    v = {n.partition(".")[2]: x for n, x in zip(PARAMETERS, p, strict=True) if n.startswith("manipulator.")}
    found = [v["column_inertia"]]
    for link in ("boom", "stick"):
        m, x, z = v[f"{link}_mass"], v[f"{link}_centre_x"], v[f"{link}_centre_z"]
        found += [m, m * x, m * z, v[f"{link}_inertia"] + m * x**2, m * x * z, m * z**2]
    head, length = v["head_mass"], v["stick_length"]
    found[7] += head
    found[8] += head * length
    found[10] += head * length**2
    return np.array(found)


@dataclass(frozen=True)
class Grouping:
    """Base parameters beta = pi[kept] + share pi[others]; `share` has shape (kept, others)."""

    kept: tuple[int, ...]
    others: tuple[int, ...]
    share: Array

    def values(self, pi: Array) -> Array:
        """beta."""
        found: Array = pi[list(self.kept)] + self.share @ pi[list(self.others)]
        return found

    def names(self) -> list[str]:
        """What each is made of."""
        found = []
        for k, row in zip(self.kept, self.share, strict=True):
            parts = [f"{c:+.4g} {STANDARD[o]}" for c, o in zip(row, self.others, strict=True) if c]
            found.append(" ".join([STANDARD[k], *parts]))
        return found


def grouping(p: Array, states: int = 200) -> Grouping:
    """Which standard parameters any motion can tell, from the regressor at random states."""
    random = np.random.default_rng(0)  # any states do: rank and combinations do not depend on them
    q, w, a = (random.uniform(-2.0, 2.0, (3, states)) for _ in range(3))
    full = np.array(regressor()(q, w, a, p)[2].full())
    y = full.reshape(3, states, len(STANDARD)).reshape(-1, len(STANDARD))
    scale = np.linalg.norm(y, axis=0)
    diagonal = np.abs(np.diag(scipy.linalg.qr((y / scale)[:, PREFERRED], mode="r")[0]))
    told = diagonal > RANK * diagonal.max()
    kept, others = np.array(PREFERRED)[told], np.array(PREFERRED)[~told]
    share = np.linalg.lstsq(y[:, kept] / scale[kept], y[:, others] / scale[others], rcond=None)[0]
    share = share * scale[others] / scale[kept][:, None]
    return Grouping(
        tuple(map(int, kept)), tuple(map(int, others)), np.where(np.abs(share) < 1e-9, 0.0, share)
    )
