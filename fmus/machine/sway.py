"""Moves that leave the hanging head at rest: the time law of a path, shaped by impulses.

A head that hangs from the tip swings in modes with a period T and a damping ratio z. The motion of the tip,
convolved with the impulses of zero vibration and derivative,

    A = (1, 2 K, K^2)/(1 + K)^2    at    t = 0, T_d/2, T_d        K = exp(-pi z/sqrt(1 - z^2))

with T_d = T/sqrt(1 - z^2), leaves no sway of this mode behind, and little if T is wrong by a tenth (Singer
and Seering, J. Dyn. Syst. Meas. Control 112, 1990, 76). Convolved with the impulses of several modes, it
leaves none of any of them. Shaped is the distance along the path, of one move from rest to rest:

    s(t) = sum A_i s_0(t - t_i)

So the tip stays on its path, and each move lasts the sum of all T_d longer. Validity: small angles of the
head. On a straight path this is the shaped motion of the tip; on a curved one the acceleration across the
path is not shaped.
"""

import math
from collections.abc import Iterable, Sequence
from itertools import pairwise
from typing import TypeAlias

import casadi as ca
import numpy as np

from fmus.contract import Subsystem, nested
from fmus.joints import Mechanics
from fmus.parameters import values
from orchestrator.data.table import Array
from orchestrator.data.trace import Trace
from orchestrator.ssp.system import Component

RATE = 200.0  # Hz, of a shaped path
TURNS = 1e-3  # 1/s2: square of the frequency below which a passive joint turns freely, as a rotator
REST = 0.01  # of the highest speed: slower, a path rests
ALIKE = 0.1  # of the frequency: modes that are as near have one shaper, which leaves 1 % of them
SWINGS = 1e-3  # of a sway that is left after half a period: with less a mode comes to rest by itself
Mode: TypeAlias = tuple[float, float]  # undamped period [s], damping ratio


def impulses(period: float, damping: float) -> tuple[Array, Array]:
    """Times [s] and amplitudes [1] of the shaper for an undamped period [s] and a damping ratio."""
    root = math.sqrt(1 - damping**2)
    k = math.exp(-math.pi * damping / root)
    return np.array([0.0, 0.5, 1.0]) * period / root, np.array([1.0, 2 * k, k**2]) / (1 + k) ** 2


def together(modes: Iterable[Mode]) -> list[Mode]:
    """Those that swing, the slowest first; modes that are alike as their mean."""
    groups = list[list[Mode]]()
    for mode in sorted((m for m in modes if m[1] < 1 and impulses(*m)[1][1] > 2 * SWINGS), reverse=True):
        (slow, ratio), (period, damping) = groups[-1][0] if groups else (math.inf, 0.0), mode
        if math.hypot(slow / period - 1, ratio - damping) <= ALIKE:
            groups[-1].append(mode)
        else:
            groups.append([mode])
    means = (np.mean(group, axis=0) for group in groups)
    return [(float(period), float(damping)) for period, damping in means]


def shaper(modes: Iterable[Mode]) -> tuple[Array, Array]:
    """Times [s] and amplitudes of the convolved impulses of these modes, shape (n,)."""
    times, weights = np.zeros(1), np.ones(1)
    for mode in modes:
        late, share = impulses(*mode)
        times, weights = np.add.outer(times, late).ravel(), np.outer(weights, share).ravel()
    return times, weights


def remaining(times: Array, weights: Array, mode: Mode) -> float:
    """Sway of a mode after these impulses over that after a single one at their end."""
    period, damping = mode
    root = damping - 1j * math.sqrt(1 - damping**2)
    return float(abs(weights @ np.exp(2 * math.pi / period * root * (times - times.max()))))


def sway(manipulator: Subsystem, component: Component) -> list[Mode]:
    """Modes of the passive joints that are not overdamped, with the arm at rest; empty: none swings.

    In the start pose, with the payload: of M q'' + D q' + (dG/dq + k) q = 0 about their rest.

    manipulator   with the equations of the component
    """
    of: Mechanics = manipulator.model
    own, free = component.real_parameters(), of.free
    p = nested(of.parameters, {n: own.get(n, x) for n, x in values(manipulator).p.items()})
    passive = [j for j in free if not j.driven and j.link(p).joint == "revolute"]
    if not passive:
        return []
    held, rows = float(component.value("payload_mass")), [free.index(j) for j in passive]
    q = ca.SX.sym("q", len(free))
    motion = of.chain(p).equations(q, ca.SX.zeros(len(free)), of.payload(held, p))
    terms = ca.Function("terms", [q], [motion.mass, ca.jacobian(motion.gravity, q)])
    rest = ca.Function("rest", [q], [of.at_rest(q, held, p, [of.joints.index(j) for j in passive])])
    at = rest(ca.evalf(of.of_joints(of.start(p))))
    mass, stiffness = (ca.DM(m).full()[np.ix_(rows, rows)] for m in terms(at))
    springs = np.diag([float(j.stiffness(p)) if j.stiffness else 0.0 for j in passive])
    losses, n = np.diag([float(j.damping(p)) for j in passive]), len(passive)
    rates = np.linalg.solve(mass, np.hstack([stiffness + springs, losses]))
    roots = np.linalg.eigvals(np.vstack([np.eye(n, 2 * n, n), -rates]))
    swinging = roots[(roots.imag > 0) & (abs(roots) ** 2 > TURNS)]
    return [(float(2 * math.pi / abs(r)), float(-r.real / abs(r))) for r in swinging]


def shaped(scenario: Trace, path: Sequence[str], velocity: Sequence[str], modes: Iterable[Mode]) -> Trace:
    """The scenario with its moves shaped for these modes of the head.

    path       columns: radius [m], height [m] and angle [rad]
    velocity   columns that are left out: the derivatives of the path
    """
    late, weights = shaper(modes)
    radius, out, up, turn = scenario[path[0]], *(np.diff(scenario[n]) for n in path)
    steps = np.sqrt(out**2 + up**2 + ((radius[1:] + radius[:-1]) / 2 * turn) ** 2)
    distance = np.concatenate([[0.0], np.cumsum(steps)])
    ways, sources = list[Array](), list[Array]()
    for begin, end in pairwise(_ends(scenario.time, distance)):
        time = begin + np.arange(math.ceil((end - begin + late.max()) * RATE)) / RATE
        shifted = (np.interp(np.clip(time - t, begin, end), scenario.time, distance) for t in late)
        ways.append(sum(a * s for a, s in zip(weights, shifted, strict=True)))
        sources.append(np.minimum(time, end))
    way = np.append(np.concatenate(ways), distance[-1])
    source = np.append(np.concatenate(sources), scenario.time[-1])
    once, rows = np.unique(distance, return_index=True)
    signals = dict(scenario.at(source).signals)
    signals |= {n: np.interp(way, once, scenario[n][rows]) for n in path}
    time = scenario.time[0] + np.arange(way.size) / RATE
    return Trace(time, {n: v for n, v in signals.items() if n not in velocity}, dict(scenario.units))


def _ends(time: Array, distance: Array) -> list[float]:
    """Begin of the path, the middle of each rest on it, and its end [s]."""
    speed = np.diff(distance) / np.diff(time)
    moving = (speed > REST * speed.max(initial=0.0)).astype(int)
    change = np.flatnonzero(np.diff(moving)) + 1  # rows at which it begins to move or to rest
    rests = change[moving[0] ^ 1 :]  # from the first stop on
    stops, starts = rests[::2], rests[1::2]
    middles = (time[stops[: starts.size]] + time[starts]) / 2
    return [float(time[0]), *middles.tolist(), float(time[-1])]
