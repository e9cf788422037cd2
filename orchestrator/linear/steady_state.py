"""Steady states of a system: joints at rest or at given speeds, all other states at rest.

States are classified by the linearised equations and by their names:

- A position is a state whose time derivative is exactly one other state, its speed.
- A joint is a position with an input whose name begins with the same word: boom_angle and boom_command. Its
  position is held, its speed is given (default 0), and its input is unknown.
- A state on which nothing depends, such as the oil in a tank, keeps its value and need not be steady.

The unknowns are all other states and the inputs of the joints. The equations require zero time derivatives of
all states except the positions of the joints. If they leave directions undetermined, such as a command in its
dead band, the values of the transient remain.

Newton's method alone does not converge from a machine at rest, because the derivatives of a valve in its dead
band do not show where it opens. The search is therefore a transient with the joints held at their speeds, in
which each input acts against the acceleration of its joint (pseudo-transient continuation: C. T. Kelley and
D. E. Keyes 1998, SIAM J. Numer. Anal. 35(2) 508-523). The steps grow, and Newton's method is tried after long
steps.

Behind a check valve the pressure rises with the input in milliseconds and falls by leakage in hours, so an
input that acts at once overshoots again and again. An integral controller that is slower than all modes of a
stable plant settles (E. J. Davison 1976, IEEE Trans. Autom. Control 21(1) 35-47): joints at rest get one.
"""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from orchestrator.base.errors import Problem
from orchestrator.base.units import BASES
from orchestrator.data.table import Array
from orchestrator.engine.plant import Matrices
from orchestrator.linear.cut_system import CutPlant

MAX_ITERATIONS, MAX_HALVINGS = 40, 8
RESIDUAL_TOLERANCE = 1e-11  # of a time derivative, relative to the sum of its terms
RANK_TOLERANCE = 1e-13  # relative to the largest singular value
STEP_TOLERANCE = 1e-14  # of a Newton step, relative to nominal


@dataclass(frozen=True)
class HeldJoint:
    """A joint: indices of its position and its speed in the states, and of its input in the inputs."""

    name: str
    position: int
    speed: int
    input: int


class SteadyEquations:
    """Equations of a steady state: the time derivatives of the states `rows` are zero.

    states, inputs   indices of the unknowns, which are the states followed by the inputs
    nominal          nominal values of the unknowns, shape (n,)
    free             number of undetermined directions at the last solution
    """

    def __init__(self, plant: CutPlant, joints: Iterable[HeldJoint], idle: Iterable[int]) -> None:
        """`idle`: indices of states that need not be steady."""
        self.plant, self.joints, self.free = plant, list(joints), 0
        fixed = {*idle, *(i for j in self.joints for i in (j.position, j.speed))}
        self.states = [i for i in range(len(plant.x)) if i not in fixed]
        self.rows = [*self.states, *(j.speed for j in self.joints)]
        self.inputs = [j.input for j in self.joints]
        ports = [inlet.targets[0][0] for inlet in plant.cut.inputs]
        input_nominals = [plant.system.variable(ports[i]).nominal or 1.0 for i in self.inputs]
        self.nominal = np.concatenate([plant.nominal[self.states], input_nominals])

    @property
    def residual(self) -> Array:
        """The current time derivatives of the states `rows`."""
        return self.plant.f[self.rows]

    def evaluate(self, x: Array, u: Array) -> bool:
        """Evaluate the plant; False if it cannot be evaluated."""
        try:
            self.plant.settle(x, u)
        except Problem:
            return False
        return bool(np.isfinite(self.plant.f).all())

    def shifted(self, x: Array, u: Array, change: Array) -> tuple[Array, Array]:
        """States and inputs after a change of the unknowns, relative to nominal."""
        x, u, increment, n = x.copy(), u.copy(), change * self.nominal, len(self.states)
        x[self.states] += increment[:n]
        u[self.inputs] += increment[n:]
        return x, u

    def matrix(self) -> tuple[Array, Array]:
        """The scaled Jacobian and the scale of its rows.

        Columns are scaled by the nominal values of the unknowns, rows by the sums of the magnitudes of their
        terms.
        """
        m = self.plant.matrices()
        jacobian = np.hstack([m.a[np.ix_(self.rows, self.states)], m.b[np.ix_(self.rows, self.inputs)]])
        jacobian = jacobian * self.nominal
        sums = np.abs(m.a) @ np.maximum(np.abs(self.plant.x), self.plant.nominal)
        scale = sums[self.rows] + np.abs(jacobian).sum(axis=1)
        scale[scale == 0.0] = 1.0
        return jacobian / scale[:, None], scale

    def worst(self) -> str:
        """The state with the largest rate relative to its nominal value."""
        relative = np.abs(self.residual / self.plant.nominal[self.rows])
        return str(self.plant.states[self.rows[int(np.argmax(relative))]])

    def solve(self) -> bool:
        """Newton's method from the current state; if it does not converge, restore the state."""
        x, u = before = self.plant.x.copy(), self.plant.u
        for _ in range(MAX_ITERATIONS):
            matrix, scale = self.matrix()
            converged = (np.abs(self.residual / scale) <= RESIDUAL_TOLERANCE).all()
            point = self._step(x, u, np.linalg.pinv(matrix, rcond=RANK_TOLERANCE) / scale)
            if converged:  # with one step more if possible, as the tolerance is coarse for fast states
                self.free = matrix.shape[1] - int(np.linalg.matrix_rank(matrix, rtol=RANK_TOLERANCE))
                if point is None:
                    self.evaluate(x, u)
                return True
            if point is None:
                break
            x, u = point
        self.evaluate(*before)
        return False

    def _step(self, x: Array, u: Array, inverse: Array) -> tuple[Array, Array] | None:
        """A damped Newton step to (x, u); None if no damping factor passes the monotonicity test.

        The test requires that the next correction with the same matrix is smaller. It does not depend on the
        scaling of the equations (Deuflhard, Newton Methods for Nonlinear Problems, 2011, 3.3: natural level
        function).
        """
        change = -inverse @ self.residual
        length = float(np.linalg.norm(change))
        for damping in 0.5 ** np.arange(MAX_HALVINGS if length > STEP_TOLERANCE else 0):
            point = self.shifted(x, u, damping * change)
            limit = (1.0 - damping / 4.0) * length
            if self.evaluate(*point) and np.linalg.norm(inverse @ self.residual) <= limit:
                return point
        return None


FIRST_STEP, SHORTEST_STEP = 1e-4, 1e-9  # [s], steps of the transient
LONG_STEP = 10.0  # [s], shortest step after which Newton's method is tried
MAX_TIME = 1e9  # [s], length of the transient
RAMP_TIME = 0.5  # [s] until the joints have their speeds
# [s], inputs change by nominal / lag at full acceleration of their joints. Pairs of lags, of joints that move
# and at rest, are tried in turn, each with a number of steps: the second to fifth for slow spools and
# compensators, the last ones for oil behind check valves, which leaks away in hours.
LAGS = {
    **dict.fromkeys(((0.005, 0.005), (0.05, 0.05), (0.1, 0.1), (0.05, 0.005), (10.0, 10.0)), 3000),
    **dict.fromkeys(((10.0, 1e3), (0.005, 1e3), (0.005, 1e4)), 1200),
}
JERK_TIME = 0.005  # [s], T of the control law of the inputs
# relative to nominal, [s], number of steps: step of an input to find its sign
TEST_INPUT, TEST_TIME, TEST_STEPS = 0.3, 0.5, 600
MAX_INPUT_STEP = 0.05  # relative to nominal, largest change of an input in one step
# Norm of the next correction over the norm of the step: a step is repeated above the first value, and the
# following step is longer below the second one.
MAX_NONLINEARITY, SMALL_NONLINEARITY = 0.5, 0.05
# A step is also repeated if the terms of a rate shrink below this share: the rates vanish in a large cavity,
# where a step that is too long would end as if it were at rest.
MAX_SHRINK = 0.1


class Search(SteadyEquations):
    """Search of a solution by a transient; the inputs are limited to their nominal values."""

    def run(self, speeds: Mapping[str, float]) -> bool:
        """Find a steady state; without success return False and leave the plant as it is then."""
        start = self.plant.x.copy(), self.plant.u
        signs = np.array([self._sign(joint, *start) for joint in self.joints])
        joint_speeds = {joint.speed: speeds.get(joint.name, 0.0) for joint in self.joints}
        for lags, steps in self._lags([bool(joint_speeds[joint.speed]) for joint in self.joints]).items():
            self.evaluate(*start)
            for _ in self._settle(signs / np.array(lags), joint_speeds, MAX_TIME, steps):
                if self.solve():
                    return True
        return False

    @staticmethod
    def _lags(moves: Sequence[bool]) -> dict[tuple[float, ...], int]:
        """The lags of all joints to try, each once, and their numbers of steps."""
        found: dict[tuple[float, ...], int] = {}
        for (moving, resting), steps in LAGS.items():
            found.setdefault(tuple(moving if move else resting for move in moves), steps)
        return found

    def _sign(self, joint: HeldJoint, x: Array, u: Array) -> float:
        """1 if a larger input accelerates the joint forwards, -1 if backwards, with all joints held."""
        accelerations = []
        index = self.inputs.index(joint.input) - len(self.inputs)
        for side in (TEST_INPUT, -TEST_INPUT):
            change = np.zeros(len(self.nominal))
            change[index] = side
            self.evaluate(*self.shifted(x, u, change))
            for _ in self._settle(np.zeros(len(self.inputs)), {}, TEST_TIME):
                pass
            accelerations.append(float(self.plant.f[joint.speed]))
        return float(np.sign(accelerations[0] - accelerations[1]))

    def _settle(
        self, push: Array, speeds: Mapping[int, float], until: float, steps: int = TEST_STEPS
    ) -> Iterator[float]:
        """Integrate the transient until a time [s], in at most `steps` steps; yield the time after long ones.

        push     signed rate of each input, relative to nominal, at full acceleration of its joint [1/s]
        speeds   index of a speed -> its value, reached by a ramp

        The steps are linearly implicit Euler steps. Their length is limited by the nonlinearity: the next
        correction with the same matrix must be small relative to the step.
        """
        x, u, h, t = self.plant.x.copy(), self.plant.u, FIRST_STEP, 0.0
        limit = self.nominal[len(self.states) :]
        law, jacobian, sizes = self._law(push)
        for _ in range(steps):
            implicit = np.eye(len(jacobian)) / h - jacobian
            change = np.asarray(np.linalg.solve(implicit, law @ self.residual), np.float64)
            next_x, next_u = self.shifted(x, u, change)
            next_u[self.inputs] = np.clip(next_u[self.inputs], -limit, limit)
            for index, speed in speeds.items():
                next_x[index] = speed * min((t + h) / RAMP_TIME, 1.0)
            nonlinearity, size = np.inf, np.linalg.norm(change) + STEP_TOLERANCE
            if (np.abs(change[len(self.states) :]) <= MAX_INPUT_STEP).all() and self.evaluate(next_x, next_u):
                correction = np.linalg.solve(implicit, law @ self.residual - change / h)
                nonlinearity = float(np.linalg.norm(correction) / size)
            shortest = h <= SHORTEST_STEP
            if nonlinearity <= MAX_NONLINEARITY or shortest:
                next_law, next_jacobian, next_sizes = self._law(push)
                if (next_sizes < MAX_SHRINK * sizes).any():
                    nonlinearity = np.inf
            if nonlinearity > MAX_NONLINEARITY and not shortest:
                h *= 0.25
                self.evaluate(x, u)
                continue
            x, u, t = next_x, next_u, t + h
            law, jacobian, sizes = next_law, next_jacobian, next_sizes
            if h > LONG_STEP:
                yield t
            if t >= until:
                return
            factor = 1.5 if nonlinearity < MAX_NONLINEARITY / 2 else 0.8
            h = min(h * (5.0 if nonlinearity < SMALL_NONLINEARITY else factor), until)

    def _law(self, push: Array) -> tuple[Array, Array, Array]:
        """The matrix from time derivatives to relative rates of the unknowns, and the Jacobian of the rates.

        Third, the sums of the magnitudes of the terms of each time derivative.

        The control law of the inputs is u' = -k (a + T a') with the acceleration a of the joint. Without the
        second term the inputs would oscillate, because a pressure is the integral of the flow that an input
        controls, and the input is the integral of the acceleration.
        """
        matrix, scale = self.matrix()
        jacobian, n = matrix * scale[:, None], len(self.states)
        law = np.diag(1.0 / self.nominal)
        gains = -push / scale[n:]
        law[n:, n:] = np.diag(gains)
        law[n:, :n] = gains[:, None] * (JERK_TIME * jacobian[n:, :n] / self.nominal[:n])
        return law, law @ jacobian, np.where(jacobian.any(axis=1), scale, 0.0)


NOTE_DECIMALS = 12  # decimals of an input in a note
SETTLE_HINT = "use a time of a run instead, with --time"
METRE, RADIAN = (tuple(int(b == base) for b in BASES) for base in ("m", "rad"))


def find_steady_state(
    plant: CutPlant, speeds: Mapping[str, float] | None = None
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Bring the plant into a steady state, with `speeds` of joints by name; notes, positions that move."""
    speeds = speeds or {}
    for name, value in speeds.items():
        if not math.isfinite(value):
            raise Problem(f"--speed {name}={value}: expected a finite number")
    matrices = plant.matrices()
    joints = _joints(plant, matrices)
    for name in speeds:
        if name not in joints:
            raise Problem(f"--speed {name}: unknown joint, expected {', '.join(joints) or 'none'}")
    idle = [i for i in range(len(plant.x)) if not matrices.a[:, i].any()]
    search = Search(plant, joints.values(), idle)
    if not search.run(speeds):
        speed_names = {n: str(plant.states[j.speed]) for n, j in joints.items()}
        conditions = ", ".join(f"{name} = {speeds.get(n, 0.0):g}" for n, name in speed_names.items())
        worst = search.worst()
        hint = "use lower speeds" if any(speeds.values()) else SETTLE_HINT
        raise Problem(f"no steady state found with {conditions or 'all free'}: {worst} still changes; {hint}")
    moving = tuple(str(plant.states[joints[name].position]) for name, speed in speeds.items() if speed)
    return _notes(plant, joints, idle, search.free), moving


def _joints(plant: CutPlant, m: Matrices) -> dict[str, HeldJoint]:
    """The joints, by the first word of their names."""
    inputs = [inlet.name.rpartition(".")[2] for inlet in plant.cut.inputs]
    joints: dict[str, HeldJoint] = {}
    for i, j in _positions(m):
        word = _first_word(plant.states[i].variable)
        unit = plant.system.variable(plant.states[i]).unit
        if unit and unit.exponents not in (None, METRE, RADIAN):  # not a position; an unknown unit may be one
            continue
        candidates = [k for k, name in enumerate(inputs) if _first_word(name) == word]
        requested = [k for k in candidates if k < plant.cut.requested_count]
        candidates = requested or candidates
        if not candidates:
            continue
        if len(candidates) > 1 or word in joints:
            names = ", ".join(plant.cut.inputs[k].name for k in candidates)
            other = f"{SETTLE_HINT}, or choose one of the inputs with --input"
            raise Problem(f"--steady: {plant.states[i]} has more than one input, {names}: {other}")
        joints[word] = HeldJoint(word, i, j, candidates[0])
    return joints


def _positions(m: Matrices) -> Iterator[tuple[int, int]]:
    """(position, speed): indices of states whose time derivative is another state, and of that state."""
    for i, row in enumerate(m.a):
        columns = np.flatnonzero(row)
        if len(columns) == 1 and row[columns[0]] == 1.0 and columns[0] != i and not m.b[i].any():
            yield i, int(columns[0])


def _first_word(name: str) -> str:
    return name.partition("_")[0]


def _notes(plant: CutPlant, joints: Mapping[str, HeldJoint], idle: list[int], free: int) -> tuple[str, ...]:
    held = [str(plant.states[j.position]) for j in joints.values()]
    constant = [str(plant.states[i]) for i in idle if str(plant.states[i]) not in held]
    notes = ["no joint is held: all states are unknowns"]
    if held:
        notes = [f"joints held at their angles: {', '.join(held)}"]
    if constant:
        notes.append(f"states held constant, because nothing depends on them: {', '.join(constant)}")
    others = [plant.cut.inputs[j.input] for j in joints.values() if j.input >= plant.cut.requested_count]
    values = dict(zip((i.name for i in plant.cut.inputs), plant.u.round(NOTE_DECIMALS), strict=True))
    texts = (f"{i.name} = {values[i.name]:.6g} {i.unit.name if i.unit else ''}".rstrip() for i in others)
    notes += [f"constant inputs of the steady state: {', '.join(texts)}"] if others else []
    directions = "one value is" if free == 1 else f"{free} values are"
    notes += [f"{directions} not unique, such as a command in its dead band"] if free else []
    return tuple(notes)
