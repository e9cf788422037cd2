"""Small subsystems with known linear models: a mass, a spring between two, a lag with feed-through."""

# ruff: noqa: ARG005  (dynamics and observe take x, u, p, whatever a toy uses)

from __future__ import annotations

from fmus.contract import Subsystem, quantities
from fmus.parameters import Values
from kit.toy import toy


def values(sub: Subsystem) -> Values:
    """All parameters 1, all else 0."""
    p, x, u = (quantities(group) for group in (sub.parameters, sub.states, sub.inputs))
    return Values(dict.fromkeys(p, 1.0), dict.fromkeys(u, 0.0), dict.fromkeys(x, 0.0))


MASS = toy(
    "mass",
    p={"mass": "kg", "stiffness": "N/m", "damping": "N.s/m"},
    x={"position": "m", "speed": "m/s"},
    u={"force": "N", "pull": "N"},
    y={"position": "m", "speed": "m/s"},
    f=lambda x, u, p: {
        "position": x.speed,
        "speed": (u.force + u.pull - p.stiffness * x.position - p.damping * x.speed) / p.mass,
    },
    g=lambda x, u, p: {"position": x.position, "speed": x.speed},
)
SPRING = toy(
    "spring",
    p={"stiffness": "N/m"},
    x={},
    u={"left": "m", "right": "m"},
    y={"force": "N", "reaction": "N"},
    f=lambda x, u, p: {},
    g=lambda x, u, p: {
        "force": p.stiffness * (u.right - u.left),
        "reaction": p.stiffness * (u.left - u.right),
    },
)
LAG = toy(  # dx/dt = u - x,  y = x + gain u
    "lag",
    p={"gain": "1"},
    x={"x": "1"},
    u={"u": "1", "w": "1"},
    y={"y": "1"},
    f=lambda x, u, p: {"x": u.u + u.w - x.x},
    g=lambda x, u, p: {"y": x.x + p.gain * (u.u + u.w)},
)
