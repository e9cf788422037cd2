"""What a crane can do, axis by axis, from its description: range, lever, forces, holding pressures, loads.

The range of a joint is followed from its start pose in both directions, until the piston is at an end of its
stroke, its lever passes zero, or the linkage no longer closes; the last two are mistakes.

Holding pressures are those of the start pose with the payload of the file, the other side at 0 bar.
Speeds are those of `fmus.crane.speeds`. The mode of an axis is that of its mass on the oil of both
sides, with the hoses, at the start pose; all other joints are locked:

    f = sqrt((A_h^2/C_h + A_r^2/C_r) J^2 / M_ii) / (2 pi)           C = V/beta

A load can be held where no piston and no motor needs more than the pressure of the supply, or of relief
valves of its own, the other side at 0 bar. `capacity`
computes it for a grid of poses over the strokes; passive joints hang at rest under this load.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache, partial
from typing import Any, TypeAlias

import casadi as ca
import numpy as np

from fmus.components.cylinder import areas, volumes
from fmus.contract import Scalar, Subsystem, Symbolic, nested, symbolic
from fmus.crane.description import (
    LARGEST_LENGTH,
    CraneDescription,
    JointDescription,
)
from fmus.crane.manipulator import manipulator
from fmus.joints import Mechanics
from fmus.machine.poses import outputs_at_start
from fmus.parameters import values
from orchestrator.base.errors import Mistakes, Problem
from orchestrator.data.table import Array

STEP = {"revolute": math.radians(0.25), "prismatic": 2e-3}  # rad, m: of the search for the ends of a range
NEWTON = 6  # steps from the last pose inside to the end: each doubles the digits
FARTHEST = {"revolute": 2 * math.pi, "prismatic": 1.1 * LARGEST_LENGTH}
DENT = 1e-3  # m: depth of the tip in the ground at the start, of a rounded height
LEAST_LEVER = 0.02  # m: a smaller one is near zero
POSES, MOST_STEPS = 150_000, 200  # of the grid of loads, in all and of one piston
# of the search for the best pose with a radius: of the grid's edges, of finer grids, cells between these
CANDIDATES, STARTS, APART, ROUNDS, CLOSER = 3000, 10, 2, 20, 0.7
SAME = 1e-6  # of a reach
# steps to the load under which a hanging tip is in balance: each leaves the share of the last one's error by
# which the radii of tip and hook differ; kg that no crane lifts
BALANCES, HEAVY = 2, 1e6
SUPPLIES = {"lumped": "ideal", "compensated": "load_sensing"}  # of the drives whose speeds are told
# fidelity -> speeds with the piston out and in [rad/s or m/s], and of the oil in a hose [m/s]
Speeds: TypeAlias = Mapping[str, tuple[float, float, float]]


@dataclass(frozen=True)
class Start:
    """Of a crane: its mechanics, their parameters, coordinates of the joints as the file has them."""

    mechanics: Mechanics
    p: Any
    q: ca.SX

    @classmethod
    def of(cls, crane: CraneDescription) -> Start:
        """The start of a crane."""
        sub = manipulator(crane)
        of = sub.model
        p = nested(of.parameters, values(sub).p)
        return cls(of, p, of.start(p))

    def inertia(self, joint: JointDescription) -> float:
        """M_ii [kg.m2 or kg] without payload."""
        of, k = self.mechanics, self.mechanics.index(joint.name)
        motion = of.chain(self.p).equations(self.q, 0 * self.q, of.payload(0, self.p))
        return float(ca.evalf(motion.mass[k, k]))

    def transmission(self, joint: JointDescription) -> ca.Function:
        """q -> position, lever."""
        q = ca.SX.sym("q")
        t = self.mechanics.transmission(joint.name, q, self.p)
        return ca.Function("transmission", [q], [t.position, ca.SX(t.arm)])


@dataclass(frozen=True)
class AxisCheck:
    """One driven joint.

    low, high         range of its coordinate [rad or m], infinite for a motor
    levers            least and largest |J| over it [m], of a motor 1
    push, pull        largest forces of the piston, or torque of the motor to both sides [N or N.m]
    holding           pressure that holds the start pose [Pa], on the side that carries
    lever, inertia    dx/dq, of a motor 1, and M_ii at the start pose [m or 1, kg.m2 or kg]
    damping           viscous friction of the joint and of those that follow it [N.m.s/rad or N.s/m]
    stiffness         of the oil on both sides at the start pose, on the joint [N.m/rad or N/m]
    mode              first mode of the axis [Hz]
    """

    joint: JointDescription
    low: float
    high: float
    levers: tuple[float, float]
    push: float
    pull: float
    holding: float
    lever: float
    inertia: float
    damping: float
    stiffness: float
    mode: float


@dataclass(frozen=True)
class Capacity:
    """A grid of poses over the strokes of all pistons.

    poses   coordinates of the pistons, shape (n, ...)
    held    of poses: reach and height of the tip [m], payload that can be held [kg], shape (3, ...)
    """

    poses: Array
    held: Callable[[Array], Array]

    @cached_property
    def values(self) -> Array:
        """What is held in the poses of the grid."""
        return self.held(self.poses)

    @cached_property
    def ends(self) -> list[tuple[Array, float]]:
        """Poses of the least and the largest reach, and their reach [m]."""
        found = []
        for sign in (-1, 1):
            first = _flat(self.poses)[:, np.argmax(sign * self.values[0])]
            pose, score = self._climb(first, partial(self._reaches, sign))
            found.append((pose, sign * score))
        return found

    def _reaches(self, sign: int, box: Array) -> tuple[Array, Array]:
        return box, sign * self.held(box)[0]

    def at(self, reach: float) -> float | None:
        """Largest load [kg] of the poses with exactly this reach, None if there are none.

        Poses with it are where an edge of the grid passes it; around the best ones the grid is made finer.
        """
        least, most = (x for _, x in self.ends)
        if not least * (1 - SAME) <= reach <= most * (1 + SAME):
            return None
        reach, starts = min(max(reach, least), most), list[Array]()
        poses, bounds = _passing(self.poses, self.values, reach)
        poses = poses[:, np.argsort(-bounds)[:CANDIDATES]]
        for pose in poses[:, np.argsort(-self.held(poses)[2])].T:
            apart = (np.abs(pose - other) > APART * self._cell for other in starts)
            if len(starts) < STARTS and all(x.any() for x in apart):
                starts.append(pose)
        starts = starts or [min(self.ends, key=lambda x: abs(x[1] - reach))[0]]

        def loads(box: Array) -> tuple[Array, Array]:
            found = _passing(box, self.held(box), reach)[0]
            return found, self.held(found)[2]

        return max(self._climb(pose, loads)[1] for pose in starts)

    def _climb(self, pose: Array, of: Callable[[Array], tuple[Array, Array]]) -> tuple[Array, float]:
        """The best pose near one, and its score; of: a box of 3^n poses -> poses in it, their scores."""
        score, axes = 0.0, tuple(range(1, self.poses.ndim))
        low, high = self.poses.min(axis=axes), self.poses.max(axis=axes)
        for k in range(ROUNDS):
            steps = CLOSER**k * self._cell
            lines = np.clip([pose - steps, pose, pose + steps], low, high).T
            poses, scores = of(_grid(lines))
            if scores.size:
                best = np.argmax(scores)
                pose, score = _flat(poses)[:, best], float(scores.flat[best])
        return pose, score

    @cached_property
    def _cell(self) -> Array:
        """Size of a cell of the grid (n,)."""
        return np.array([np.ptp(x) / (len(x) - 1) for x in self.poses])


def _grid(lines: Sequence[Array]) -> Array:
    """All combinations of some numbers, shape (n, ...)."""
    return np.array(np.meshgrid(*lines, indexing="ij"))


def _flat(values: Array) -> Array:
    """Shape (n, ...) as (n, m), of no numbers, too."""
    return values.reshape(len(values), math.prod(values.shape[1:]))


def _passing(poses: Array, values: Array, reach: float) -> tuple[Array, Array]:
    """Where the edges of a grid pass a reach: poses (n, m), the larger load of the ends (m,)."""
    found, bounds = [np.empty((len(poses), 0))], [np.empty(0)]
    for axis in range(1, poses.ndim):
        begin, low = (_flat(np.delete(x, -1, axis)) for x in (poses, values))
        end, high = (_flat(np.delete(x, 0, axis)) for x in (poses, values))
        before, behind = low[0] - reach, high[0] - reach
        passes = (before * behind <= 0) & (before != behind)
        share = before[passes] / (before - behind)[passes]
        found.append(begin[:, passes] + share * (end - begin)[:, passes])
        bounds.append(np.maximum(low[2], high[2])[passes])
    return np.hstack(found), np.hstack(bounds)


@lru_cache(maxsize=16)
def at_start(crane: CraneDescription, payload: float = 0.0) -> Mapping[str, float]:
    """Outputs of the manipulator at its start, with a payload [kg]."""
    sub, known = _mechanics(crane)
    return outputs_at_start(sub, payload, known)


@lru_cache(maxsize=16)
def _mechanics(crane: CraneDescription) -> tuple[Subsystem, Symbolic]:
    sub = manipulator(crane)
    return sub, symbolic(sub)


def axes_of(crane: CraneDescription, start: Mapping[str, float] | None = None) -> list[AxisCheck]:
    """All axes; a Problem with a line for each mistake.

    start   outputs of a manipulator with other numbers than those of the file, with the payload
    """
    load, pose = crane.numbers["payload"]["payload_mass"].value, Start.of(crane)
    start = at_start(crane, load) if start is None else start
    found, mistakes = list[AxisCheck](), list[str]()
    for joint in crane.driven:
        try:
            found.append(_axis(crane, pose, joint, start))
        except Problem as problem:
            mistakes.append(f"{crane.file}: [{joint.name}] {problem}")
    ground, tip = crane.numbers["ground"].get("ground_height"), start["tip_height"]
    if ground and ground.value > tip + DENT:
        expected = f"at most {tip:.4g} m, where the tip is at the start"
        mistakes.append(f"{crane.file}: [ground] height: expected {expected}, got {ground.value:g} m")
    if mistakes:
        raise Mistakes(mistakes)
    return found


def stops(joint: JointDescription) -> tuple[float, float]:
    """Where the end stops of a joint begin [rad or m], infinite without some."""
    high = joint["stop_at"] if "stop_at" in joint.numbers else math.inf
    return joint["stop_from"] if "stop_from" in joint.numbers else -high, high


def _axis(
    crane: CraneDescription, pose: Start, joint: JointDescription, start: Mapping[str, float]
) -> AxisCheck:
    pressure = crane.numbers["supply"]["pressure_setting"].value
    hose = math.pi / 4 * joint["hose_bore"] ** 2 * joint["hose_length"]
    if joint.motor:
        low, high = stops(joint)
        levers, lever = (1.0, 1.0), 1.0
        head = rod = joint["motor_displacement"] * joint["gear_ratio"]
        sizes, effort, larger = (joint["motor_volume"],) * 2, "torque", "a larger motor, more ratio"
    else:
        low, high, levers = _range(pose, joint)
        position, lever = map(float, pose.transmission(joint)(joint.start.value))
        head, rod = (float(x) for x in areas(joint["bore"], joint["rod"]))
        sizes = volumes(position, joint["stroke"], head, rod, joint["dead_volume"])
        effort, larger = "force", "a larger bore, a larger lever"
    holds = start[f"{joint.name}_holding_{effort}"]
    of_head, of_rod = _limits(joint, pressure)
    for holding, limit in ((holds / head, of_head), (-holds / rod, of_rod)):
        if holding > limit:
            whose = "the supply's" if limit == pressure else "its relief valve's"
            raise Problem(
                f"holds the arm at the start with {holding / 1e5:.0f} bar, expected at most {whose} "
                f"{limit / 1e5:.0f} bar: {larger}, or another start pose"
            )
    push, pull, holding = of_head * head, of_rod * rod, max(holds / head, -holds / rod)
    modulus, inertia = crane.numbers["oil"]["bulk_modulus"].value, pose.inertia(joint)
    c_head, c_rod = ((x + hose) / modulus for x in sizes)
    stiffness = (head**2 / c_head + rod**2 / c_rod) * lever**2
    mode = math.sqrt(stiffness / inertia) / (2 * math.pi)
    slopes = map(float, map(ca.evalf, map(ca.SX, pose.mechanics.chain(pose.p).slopes(pose.q))))
    own = [
        (j, slope)
        for j, slope in zip(crane.joints, slopes, strict=False)
        if joint.name in (j.name, j.follows)
    ]
    damping = sum(j["damping"] * slope**2 for j, slope in own)
    of_oil = (lever, inertia, damping, stiffness, mode)
    return AxisCheck(joint, low, high, levers, push, pull, holding, *of_oil)


def _limits(joint: JointDescription, pressure: float) -> tuple[float, float]:
    """Largest pressures of the head and the rod side [Pa]: of the supply [Pa], or of own relief valves."""
    if "reliefs" not in joint.additions:
        return pressure, pressure
    own = joint["reliefs_pressure"]
    of_rod = joint["reliefs_rod_pressure"] or own if joint.cylinder else own
    return min(pressure, own), min(pressure, of_rod)


def modes(crane: CraneDescription, found: Sequence[AxisCheck]) -> Array:
    """Frequencies of all axes together on their oil at the start pose [Hz], ascending.

    The other joints move freely without friction: K v = (2 pi f)^2 M v, with springs in K, and the weight of
    those that hang; without payload, as the modes of the single axes.
    """
    pose = Start.of(crane)
    of, p = pose.mechanics, pose.p
    s = ca.SX.sym("q", pose.q.shape[0])
    motion = of.chain(p).equations(s, 0 * s, of.payload(0, p))
    rest = of.at_rest(pose.q, 0, p)
    terms = ca.evalf(ca.vertcat(*ca.substitute([motion.mass, ca.jacobian(motion.gravity, s)], [s], [rest])))
    mass, stiffness = np.split(terms.full(), 2)
    driven = [of.index(a.joint.name) for a in found]
    stiffness[driven] = stiffness[:, driven] = (
        0.0  # pistons bear the weight; its slope is small beside the oil
    )
    for k, j in enumerate(of.free):
        stiffness[k, k] += float(j.stiffness(p)) if j.stiffness else 0.0
    for k, a in zip(driven, found, strict=True):
        stiffness[k, k] += a.stiffness
    inverse = np.linalg.inv(np.linalg.cholesky(mass))
    squares: Array = np.linalg.eigvalsh(inverse @ stiffness @ inverse.T)
    return np.sqrt(np.clip(squares, 0.0, None)) / (2 * math.pi)


def _hanging(
    start: Start, found: Sequence[AxisCheck], driven: ca.SX, mass: Scalar
) -> tuple[ca.SX, Scalar, Scalar]:
    """Coordinates with passive joints at rest under a payload [kg].

    With the least margin of all axes to their limits there without payload [N or N.m], and the largest
    payload [kg] that they hold.
    """
    of, p = start.mechanics, start.p
    q, chain = of.at_rest(driven, mass, p), of.chain(p)
    empty, both = (chain.equations(q, 0 * q, of.payload(m, p)).gravity for m in (0, 1))
    margin = largest = ca.SX.inf()
    for a in found:
        k, name = of.index(a.joint.name), a.joint.name
        lever = of.transmission(name, q[k], p).arm if a.joint.cylinder else 1
        force, kilogram = empty[k] / lever, (both[k] - empty[k]) / lever
        limit = ca.if_else(kilogram > 0, a.push - force, -a.pull - force) / kilogram
        margin = ca.fmin(margin, ca.fmin(a.push - force, a.pull + force))
        largest = ca.fmin(largest, ca.if_else(kilogram == 0, ca.inf, limit))  # 0: it does not carry it
    return q, margin, ca.fmax(largest, 0)


def capacity(crane: CraneDescription, found: Sequence[AxisCheck]) -> Capacity:
    """Loads over the strokes of all pistons; a crane without one holds no load."""
    start, axes = Start.of(crane), [a for a in found if a.joint.cylinder]
    of, p, s, driven = start.mechanics, start.p, ca.SX.sym("s", len(axes)), ca.SX(start.q)
    for k, a in enumerate(axes):
        driven[of.index(a.joint.name)] = s[k]
    q, margin, load = _hanging(start, found, driven, 0)
    turned = ca.Function("turned", [s], [of.at_rest(driven, HEAVY, p) - q])
    ends = np.array([[a.low, a.high] for a in axes])
    for _ in range(BALANCES if axes and np.abs(np.array(turned(ends))).max() > SAME else 0):
        q, _, load = _hanging(start, found, driven, ca.fmin(load, HEAVY))
    place = of.payload(0, p)
    tip = of.chain(p).position(q, place.link, place.at)
    results = ca.vertcat(ca.norm_2(tip[:2]), tip[2], ca.if_else(margin >= 0, load, 0) if axes else 0)
    function = ca.Function("held", [s], [results], {"cse": True})

    def held(poses: Array) -> Array:
        count = math.prod(poses.shape[1:])
        found = function.map(count)(_flat(poses)).full() if count else np.empty((3, 0))
        return np.asarray(found.reshape(3, *poses.shape[1:]))

    steps = min(MOST_STEPS, int(POSES ** (1 / max(1, len(axes)))))
    return Capacity(_grid([np.linspace(a.low, a.high, steps) for a in axes]), held)


def lifting_moment(found: Sequence[AxisCheck]) -> float:
    """Gross: largest moment of the first cylinder about its joint [N.m], 0 without one."""
    first = next((a for a in found if a.joint.axis[-1] == "y" and a.joint.cylinder), None)
    return first.push * first.levers[1] if first else 0.0


def _range(pose: Start, joint: JointDescription) -> tuple[float, float, tuple[float, float]]:
    """Ends of the coordinate over the stroke, least and largest lever."""
    unit, scale = ("deg", 180 / math.pi) if joint.revolute else ("mm", 1e3)
    function, step = pose.transmission(joint), STEP[joint.kind]
    first, lever = (float(x) for x in function(joint.start.value))
    at = f"start {scale * joint.start.value:.4g} {unit}"
    if not math.isfinite(first):
        raise Problem(f"{at}: the four-bar linkage does not close there")
    if not 0 <= first <= joint["stroke"]:
        raise Problem(
            f"{at}: the piston is at {1e3 * first:.0f} mm, expected 0 to {1e3 * joint['stroke']:.0f} mm"
        )
    ends, levers = list[float](), [abs(lever)]
    for sign in (-1.0, 1.0):
        inside = joint.start.value
        grid = joint.start.value + sign * step * np.arange(1, round(FARTHEST[joint.kind] / step))
        positions, arms = (np.asarray(x)[0] for x in function(grid[None, :]))
        for q, x, arm in zip(grid, positions, arms, strict=True):
            if not (math.isfinite(x) and math.isfinite(arm)):
                raise Problem(
                    f"the four-bar linkage does not close from {scale * q:.4g} {unit} on, at "
                    f"{1e3 * positions[np.isfinite(positions)][-1]:.0f} mm of {1e3 * joint['stroke']:.0f} mm"
                )
            if not 0 <= x <= joint["stroke"]:
                break
            if arm * lever <= 0 or abs(arm) < LEAST_LEVER:
                raise Problem(
                    f"the lever passes zero at {1e3 * x:.0f} mm of {1e3 * joint['stroke']:.0f} mm: the "
                    f"cylinder cannot move the joint through {scale * q:.4g} {unit}"
                )
            levers.append(abs(float(arm)))
            inside = q
        end = 0.0 if x < 0 else joint["stroke"]
        for _ in range(NEWTON):
            at_end, arm = map(float, function(inside))
            inside -= (at_end - end) / arm
        ends.append(float(inside))
        levers.append(abs(arm))
    return min(ends), max(ends), (min(levers), max(levers))
