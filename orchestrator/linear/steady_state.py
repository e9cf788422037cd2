"""Steady states: joints held or moving at given speeds, all the rest at rest.

Which states are which is read off the linearised equations and the names, not off the machine:

- a position is a state whose time derivative is another state, its speed, and nothing else;
- a joint is a position with an input whose name begins with the same word: boom_angle and boom_command.
  Its angle is held where it is, its speed is given (default 0), and the input is found;
- a state on which nothing depends, such as oil in a tank, stays where it is and need not be steady.

All other states and the inputs of the joints are found, so that the time derivatives of all states but the
positions of joints are zero. Where that leaves directions free, such as a command in its dead band, they are
where settling left them.

Newton's method alone finds none from a machine at rest: a valve in its dead band does not show where it
opens. So the machine settles in time, with the joints held at their speeds, while each input goes against the
acceleration of its joint (pseudo-transient continuation: C. T. Kelley and D. E. Keyes 1998, SIAM J. Numer.
Anal. 35(2) 508-523). The steps grow, and at long ones Newton's method is tried.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from orchestrator.base.errors import Problem
from orchestrator.base.units import BASES, DeclaredUnit
from orchestrator.linear.plant import Array, Matrices, Plant

MAX_ITERATIONS, MAX_HALVINGS = 40, 8
RESIDUAL_TOLERANCE = 1e-11  # of what the terms of a time derivative amount to: rounding
RANK_TOLERANCE = 1e-13  # of the largest singular value: a direction in which nothing changes
STEP_TOLERANCE = 1e-14  # of the size of the unknowns: rounding


@dataclass(frozen=True)
class HeldJoint:
    """Places of a position and its speed among the states, and of the input that moves them."""

    name: str
    position: int
    speed: int
    input: int


class SteadyEquations:
    """Unknowns: the states `states`, then `inputs`. To be zero: the time derivatives of the states `rows`.

    size   magnitudes of the unknowns, shape (n,); those of the inputs are the last ones
    free   directions that are steady anyway, at the last solution
    """

    def __init__(self, plant: Plant, joints: Iterable[HeldJoint], idle: Iterable[int]) -> None:
        """idle: states that need not be steady."""
        self.plant, self.joints, self.free = plant, list(joints), 0
        fixed = {*idle, *(i for j in self.joints for i in (j.position, j.speed))}
        self.states = [i for i in range(len(plant.x)) if i not in fixed]
        self.rows = [*self.states, *(j.speed for j in self.joints)]
        self.inputs = [j.input for j in self.joints]
        ports = [inlet.targets[0][0] for inlet in plant.cut.inputs]
        magnitude = [plant.system.variable(ports[i]).nominal or 1.0 for i in self.inputs]
        self.nominal = np.concatenate([plant.nominal[self.states], magnitude])

    @property
    def residual(self) -> Array:
        """The time derivatives that are to be zero, now."""
        return self.plant.f[self.rows]

    def evaluate(self, x: Array, u: Array) -> bool:
        """Ask the plant there; False where it has no answer."""
        try:
            self.plant.settle(x, u)
        except Problem:
            return False
        return bool(np.isfinite(self.plant.f).all())

    def shifted(self, x: Array, u: Array, change: Array) -> tuple[Array, Array]:
        """States and inputs, changed by a change of the unknowns in their size."""
        x, u, by, n = x.copy(), u.copy(), change * self.nominal, len(self.states)
        x[self.states] += by[:n]
        u[self.inputs] += by[n:]
        return x, u

    def matrix(self) -> tuple[Array, Array]:
        """The Jacobian by the size of the unknowns, each row by what its terms amount to; and that."""
        m = self.plant.matrices()
        own = np.hstack([m.a[np.ix_(self.rows, self.states)], m.b[np.ix_(self.rows, self.inputs)]])
        own = own * self.nominal
        amount = np.abs(m.a) @ np.maximum(np.abs(self.plant.x), self.plant.nominal)
        scale = amount[self.rows] + np.abs(own).sum(axis=1)
        scale[scale == 0.0] = 1.0
        return own / scale[:, None], scale

    def worst(self) -> str:
        """The state that is furthest from rest."""
        off = np.abs(self.residual / self.matrix()[1])
        return str(self.plant.states[self.rows[int(np.argmax(off))]])

    def solve(self) -> bool:
        """Newton's method from where the plant is; where it does not get there, the plant is put back."""
        x, u = before = self.plant.x.copy(), self.plant.u
        for _ in range(MAX_ITERATIONS):
            matrix, scale = self.matrix()
            done = (np.abs(self.residual / scale) <= RESIDUAL_TOLERANCE).all()
            found = self._step(x, u, np.linalg.pinv(matrix, rcond=RANK_TOLERANCE) / scale)
            if done:  # with one more step if it helps: of the large terms of fast states ENOUGH is much
                self.free = matrix.shape[1] - int(np.linalg.matrix_rank(matrix, rtol=RANK_TOLERANCE))
                if found is None:
                    self.evaluate(x, u)
                return True
            if found is None:
                break
            x, u = found
        self.evaluate(*before)
        return False

    def _step(self, x: Array, u: Array, inverse: Array) -> tuple[Array, Array] | None:
        """Go as far as the next correction, with the same matrix, gets smaller; None where none does.

        That test does not depend on how the equations are scaled (Deuflhard, Newton Methods for Nonlinear
        Problems, 2011, 3.3: the natural level function).
        """
        change = -inverse @ self.residual
        length = float(np.linalg.norm(change))
        for share in 0.5 ** np.arange(MAX_HALVINGS if length > STEP_TOLERANCE else 0):
            there = self.shifted(x, u, share * change)
            if (
                self.evaluate(*there)
                and np.linalg.norm(inverse @ self.residual) <= (1.0 - share / 4.0) * length
            ):
                return there
        return None


FIRST_STEP, SHORTEST_STEP, MAX_STEPS = 1e-4, 1e-9, 600  # first and shortest step [s], and how many
LONG_STEP, MAX_TIME = (
    10.0,
    1e9,
)  # from steps of this length on Newton's method may do, and when to give up [s]
RAMP_TIME = 0.5  # until the joints have their speeds [s]
LAGS = (0.005, 0.02, 0.1)  # of an input over its magnitude, where nothing balances a joint [s], to be tried
JERK_TIME = 0.005  # the T of the law of the inputs [s]
TEST_INPUT, TEST_TIME = 0.3, 0.5  # of an input's magnitude, and how long [s], to see where it pushes
MAX_INPUT_STEP = 0.05  # of its magnitude, the furthest that an input goes in one step
MAX_NONLINEARITY, SMALL_NONLINEARITY = (
    0.5,
    0.05,
)  # the next correction over the step: too far, and hardly seen


class Search:
    """One search; inputs are looked for within their magnitude, the nominal value that the FMU tells."""

    def __init__(self, plant: Plant, joints: Iterable[HeldJoint], idle: Iterable[int]) -> None:
        """idle: states that need not be steady."""
        self._plant, self.equations = plant, SteadyEquations(plant, joints, idle)

    def run(self, speeds: Mapping[str, float]) -> bool:
        """Find the steady state; False where there is none, and the plant is left where the search ended."""
        e, start = self.equations, (self._plant.x.copy(), self._plant.u)
        signs = np.array([self._sign(joint, *start) for joint in e.joints])
        wanted = {joint.speed: speeds.get(joint.name, 0.0) for joint in e.joints}
        for lag in LAGS:
            e.evaluate(*start)
            for _ in self._settle(signs / lag, wanted, MAX_TIME):
                if e.solve():
                    return True
        return False

    def _sign(self, joint: HeldJoint, x: Array, u: Array) -> float:
        """1 where a larger input soon pushes a joint forwards, -1 backwards; the joints are held."""
        pushed = []
        at = self.equations.inputs.index(joint.input) - len(self.equations.inputs)
        for side in (TEST_INPUT, -TEST_INPUT):
            change = np.zeros(len(self.equations.nominal))
            change[at] = side
            self.equations.evaluate(*self.equations.shifted(x, u, change))
            for _ in self._settle(np.zeros(len(self.equations.inputs)), {}, TEST_TIME):
                pass
            pushed.append(float(self._plant.f[joint.speed]))
        return float(np.sign(pushed[0] - pushed[1]))

    def _settle(self, push: Array, speeds: Mapping[int, float], until: float) -> Iterator[float]:
        """Let time pass; yields it after long steps.

        push   rate of each input, in its magnitude, where nothing balances its joint [1/s]; with a sign

        Linearly implicit Euler steps, as long as the equations are nearly linear over them: as long as the
        next correction with the same matrix is small next to the step.
        """
        e, x, u, h, t = self.equations, self._plant.x.copy(), self._plant.u, FIRST_STEP, 0.0
        limit = e.nominal[len(e.states) :]
        for _ in range(MAX_STEPS):
            mix, jacobian = self._law(push)
            implicit = np.eye(len(jacobian)) / h - jacobian
            change = np.asarray(np.linalg.solve(implicit, mix @ e.residual), np.float64)
            at, by = e.shifted(x, u, change)
            by[e.inputs] = np.clip(by[e.inputs], -limit, limit)
            for place, speed in speeds.items():
                at[place] = speed * min((t + h) / RAMP_TIME, 1.0)
            bent = np.inf
            if (np.abs(change[len(e.states) :]) <= MAX_INPUT_STEP).all() and e.evaluate(at, by):
                left = np.linalg.solve(implicit, mix @ e.residual - change / h)
                bent = float(np.linalg.norm(left) / (np.linalg.norm(change) + STEP_TOLERANCE))
            if bent > MAX_NONLINEARITY and h > SHORTEST_STEP:
                h *= 0.25
                e.evaluate(x, u)
                continue
            x, u, t = at, by, t + h
            if h > LONG_STEP:
                yield t
            if t >= until:
                return
            h = min(
                h * (5.0 if bent < SMALL_NONLINEARITY else 1.5 if bent < MAX_NONLINEARITY / 2 else 0.8), until
            )

    def _law(self, push: Array) -> tuple[Array, Array]:
        """How time derivatives make rates of the unknowns, in their size; and the Jacobian of these rates.

        Inputs go against acceleration and jerk: u' = -k (a + T a'). Without the second term they would swing,
        because a pressure adds up the flow that an input lets in, and an input adds up accelerations.
        """
        e = self.equations
        matrix, scale = e.matrix()
        own, n = matrix * scale[:, None], len(e.states)
        mix = np.diag(1.0 / e.nominal)
        slow = -push / scale[n:]
        mix[n:, n:] = np.diag(slow)
        mix[n:, :n] = slow[:, None] * (JERK_TIME * own[n:, :n] / e.nominal[:n])
        return mix, mix @ own


NOTE_DECIMALS = 12  # digits after the point, of a command in a note
SETTLE_HINT = "let a run settle with --time in place of --steady"
METRE, RADIAN = (tuple(int(b == base) for b in BASES) for base in ("m", "rad"))


def find_steady_state(plant: Plant, speeds: Mapping[str, float] | None = None) -> tuple[str, ...]:
    """Bring the plant from where it is into a steady state; `speeds` of joints by name. Returns notes."""
    given = speeds or {}
    for name, value in given.items():
        if not math.isfinite(value):
            raise Problem(f"--speed {name}={value}: expected a finite number")
    matrices = plant.matrices()
    joints = _joints(plant, matrices)
    for name in given:
        if name not in joints:
            raise Problem(f"--speed {name}: no such joint, expected {', '.join(joints) or 'none'}")
    idle = [i for i in range(len(plant.x)) if not matrices.a[:, i].any()]
    search = Search(plant, joints.values(), idle)
    if not search.run(given):
        wanted = ", ".join(f"{plant.states[j.speed]} = {given.get(n, 0.0):g}" for n, j in joints.items())
        worst = search.equations.worst()
        other = "expected slower joints" if any(given.values()) else SETTLE_HINT
        raise Problem(f"no steady state found with {wanted or 'all free'}: {worst} is not at rest; {other}")
    return _notes(plant, joints, idle, search.equations.free)


def _joints(plant: Plant, m: Matrices) -> dict[str, HeldJoint]:
    """The joints by the first word of their names."""
    inputs = [inlet.name.rpartition(".")[2] for inlet in plant.cut.inputs]
    found: dict[str, HeldJoint] = {}
    for i, j in _positions(m):
        word = _first_word(plant.states[i].variable)
        if not _is_position_unit(plant.system.variable(plant.states[i]).unit):
            continue
        mine = [k for k, name in enumerate(inputs) if _first_word(name) == word]
        mine = [
            k for k in mine if k < plant.cut.requested_count
        ] or mine  # a named input goes before a usual one
        if not mine:
            continue
        if len(mine) > 1 or word in found:
            names = ", ".join(plant.cut.inputs[k].name for k in mine)
            other = f"{SETTLE_HINT}, or name one with --input"
            raise Problem(f"--steady: {plant.states[i]} has more than one input, {names}: {other}")
        found[word] = HeldJoint(word, i, j, mine[0])
    return found


def _positions(m: Matrices) -> Iterator[tuple[int, int]]:
    """States whose time derivative is another state, with that state."""
    for i, row in enumerate(m.a):
        places = np.flatnonzero(row)
        if len(places) == 1 and row[places[0]] == 1.0 and places[0] != i and not m.b[i].any():
            yield i, int(places[0])


def _is_position_unit(unit: DeclaredUnit | None) -> bool:
    """Is this the unit of an angle or a length?"""
    if unit is None or unit.exponents is None:
        return True
    return unit.exponents in (METRE, RADIAN)


def _first_word(name: str) -> str:
    return name.partition("_")[0]


def _notes(plant: Plant, joints: Mapping[str, HeldJoint], idle: list[int], free: int) -> tuple[str, ...]:
    held = [str(plant.states[j.position]) for j in joints.values()]
    rest = [str(plant.states[i]) for i in idle if str(plant.states[i]) not in held]
    notes = [f"held: {', '.join(held)}" if held else "no joint is held: all states were found"]
    notes += [f"nothing depends on these states, they stay: {', '.join(rest)}"] if rest else []
    others = [plant.cut.inputs[j.input] for j in joints.values() if j.input >= plant.cut.requested_count]
    values = dict(zip((i.name for i in plant.cut.inputs), plant.u.round(NOTE_DECIMALS), strict=True))
    found = (f"{i.name} = {values[i.name]:.6g} {i.unit.name if i.unit else ''}".rstrip() for i in others)
    notes += [f"found, and constant: {', '.join(found)}"] if others else []
    what = "one direction is" if free == 1 else f"{free} directions are"
    notes += [f"{what} steady anywhere, such as a command in its dead band"] if free else []
    return tuple(notes)
