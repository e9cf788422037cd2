"""The search for a steady state: let time pass until Newton's method does the rest.

Newton's method alone finds none from a machine at rest: a valve in its dead band tells nothing of where it
opens. So the machine settles in time, with the joints held at their speeds, while each input goes against the
acceleration of its joint (pseudo-transient continuation: C. T. Kelley and D. E. Keyes 1998, SIAM J. Numer.
Anal. 35(2) 508-523). The steps grow, and at long ones Newton's method is tried.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

import numpy as np

from orchestrator.linear.member import Array
from orchestrator.linear.newton import TINY, Equations, Joint
from orchestrator.linear.plant import Plant

FIRST, SHORTEST, STEPS = 1e-4, 1e-9, 600  # first and shortest step [s], and how many
LONG, FAR = 10.0, 1e9  # from steps of this length on Newton's method may do, and when to give up [s]
RAMP = 0.5  # until the joints have their speeds [s]
LAGS = (0.005, 0.02, 0.1)  # of an input over its magnitude, where nothing balances a joint [s], to be tried
JERK = 0.005  # the T of the law of the inputs [s]
PUSH, SOON = 0.3, 0.5  # of an input's magnitude, and how long [s], to see where it pushes
MOVE = 0.05  # of its magnitude, the furthest that an input goes in one step
BENT, STRAIGHT = 0.5, 0.05  # the next correction over the step: too far, and hardly seen


class Search:
    """One search; inputs are looked for within their magnitude, the nominal value that the FMU tells."""

    def __init__(self, plant: Plant, joints: Iterable[Joint], idle: Iterable[int]) -> None:
        """idle: states that need not be steady."""
        self._plant, self.equations = plant, Equations(plant, joints, idle)

    def run(self, speeds: Mapping[str, float]) -> bool:
        """Find the steady state; False where there is none, and the plant is left where the search ended."""
        e, start = self.equations, (self._plant.x.copy(), self._plant.u)
        signs = np.array([self._sign(joint, *start) for joint in e.joints])
        wanted = {joint.speed: speeds.get(joint.name, 0.0) for joint in e.joints}
        for lag in LAGS:
            e.look(*start)
            for _ in self._settle(signs / lag, wanted, FAR):
                if e.solve():
                    return True
        return False

    def _sign(self, joint: Joint, x: Array, u: Array) -> float:
        """1 where a larger input soon pushes a joint forwards, -1 backwards; the joints are held."""
        pushed = []
        at = self.equations.inputs.index(joint.input) - len(self.equations.inputs)
        for side in (PUSH, -PUSH):
            change = np.zeros(len(self.equations.size))
            change[at] = side
            self.equations.look(*self.equations.moved(x, u, change))
            for _ in self._settle(np.zeros(len(self.equations.inputs)), {}, SOON):
                pass
            pushed.append(float(self._plant.f[joint.speed]))
        return float(np.sign(pushed[0] - pushed[1]))

    def _settle(self, push: Array, speeds: Mapping[int, float], until: float) -> Iterator[float]:
        """Let time pass; yields it after long steps.

        push   rate of each input, in its magnitude, where nothing balances its joint [1/s]; with a sign

        Linearly implicit Euler steps, as long as the equations are nearly linear over them: as long as the
        next correction with the same matrix is small beside the step.
        """
        e, x, u, h, t = self.equations, self._plant.x.copy(), self._plant.u, FIRST, 0.0
        limit = e.size[len(e.states) :]
        for _ in range(STEPS):
            mix, jacobian = self._law(push)
            implicit = np.eye(len(jacobian)) / h - jacobian
            change = np.asarray(np.linalg.solve(implicit, mix @ e.off), np.float64)
            at, by = e.moved(x, u, change)
            by[e.inputs] = np.clip(by[e.inputs], -limit, limit)
            for place, speed in speeds.items():
                at[place] = speed * min((t + h) / RAMP, 1.0)
            bent = np.inf
            if (np.abs(change[len(e.states) :]) <= MOVE).all() and e.look(at, by):
                left = np.linalg.solve(implicit, mix @ e.off - change / h)
                bent = float(np.linalg.norm(left) / (np.linalg.norm(change) + TINY))
            if bent > BENT and h > SHORTEST:
                h *= 0.25
                e.look(x, u)
                continue
            x, u, t = at, by, t + h
            if h > LONG:
                yield t
            if t >= until:
                return
            h = min(h * (5.0 if bent < STRAIGHT else 1.5 if bent < BENT / 2 else 0.8), until)

    def _law(self, push: Array) -> tuple[Array, Array]:
        """How time derivatives make rates of the unknowns, in their size; and the Jacobian of these rates.

        Inputs go against acceleration and jerk: u' = -k (a + T a'). Without the second term they would swing,
        because a pressure adds up the flow that an input lets in, and an input adds up accelerations.
        """
        e = self.equations
        matrix, scale = e.matrix()
        own, n = matrix * scale[:, None], len(e.states)
        mix = np.diag(1.0 / e.size)
        slow = -push / scale[n:]
        mix[n:, n:] = np.diag(slow)
        mix[n:, :n] = slow[:, None] * (JERK * own[n:, :n] / e.size[:n])
        return mix, mix @ own
