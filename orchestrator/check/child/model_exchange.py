"""Model exchange: events, and an explicit integrator with step control that is good enough to move a model.

Bogacki and Shampine, order 3(2), four stages, the last of which is the first of the next step
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Sequence

from orchestrator.check.child.binary import Refused
from orchestrator.check.child.instance import EventInfo, Instance

TOLERANCE = 1e-4
EVENTS = 100  # iterations of one event
DISCARD = 2


class Exchange:
    """Continuous states of an instance for model exchange."""

    def __init__(self, instance: Instance) -> None:
        self.instance, declared = instance, instance.declared
        self.count, self.indicators = len(declared.derivatives), declared.indicators
        if declared.major == 3:
            self.count = self._number("GetNumberOfContinuousStates")
            self.indicators = self._number("GetNumberOfEventIndicators")
        self._x = (ctypes.c_double * max(self.count, 1))()
        self._dx = (ctypes.c_double * max(self.count, 1))()
        self._z = (ctypes.c_double * max(self.indicators, 1))()
        self.time, self.next, self.trial = 0.0, math.inf, 0.0
        self.nominal = [1.0] * self.count

    def _number(self, name: str) -> int:
        value = ctypes.c_size_t(0)
        self.instance.call(name, ctypes.byref(value))
        return value.value

    # ---- events

    def begin(self, time: float) -> None:
        """From event mode, where the initialisation ends, to continuous time."""
        self.time = time
        self._iterate()
        self.instance.call("EnterContinuousTimeMode")
        if self.count:
            self.instance.call("GetNominalsOfContinuousStates", self._x, ctypes.c_size_t(self.count))
            self.nominal = [abs(n) or 1.0 for n in self._x]

    def _iterate(self) -> None:
        """Discrete states until they rest."""
        for _ in range(EVENTS):
            needed, terminate, defined, following = self._update()
            self.next = following if defined else math.inf
            self.instance.ended = self.instance.ended or terminate
            if not needed or terminate:
                return
        raise Refused(f"the event iteration, {EVENTS} calls", 3, "new discrete states are needed for ever")

    def _update(self) -> tuple[bool, bool, bool, float]:
        if self.instance.declared.major == 2:
            info = EventInfo()
            self.instance.call("NewDiscreteStates", ctypes.byref(info))
            return bool(info.needed), bool(info.terminate), bool(info.defined), info.next
        flags, following = [ctypes.c_bool(False) for _ in range(5)], ctypes.c_double(0.0)
        self.instance.call("UpdateDiscreteStates", *(ctypes.byref(f) for f in flags), ctypes.byref(following))
        return flags[0].value, flags[1].value, flags[4].value, following.value

    def _event(self) -> None:
        self.instance.call("EnterEventMode")
        self._iterate()
        self.instance.call("EnterContinuousTimeMode")

    # ---- the state vector

    def states(self) -> list[float]:
        """Continuous states."""
        if self.count:
            self.instance.call("GetContinuousStates", self._x, ctypes.c_size_t(self.count))
        return list(self._x[: self.count])

    def put(self, time: float, x: Sequence[float]) -> None:
        """Set time and continuous states."""
        self.put_time(time)
        self.put_states(x)

    def put_time(self, time: float) -> None:
        """Set the time."""
        self.instance.binary.beacon.time = time
        self.instance.call("SetTime", ctypes.c_double(time))

    def put_states(self, x: Sequence[float]) -> None:
        """Set the continuous states."""
        if self.count:
            self._x[:] = list(x)
            self.instance.call("SetContinuousStates", self._x, ctypes.c_size_t(self.count))

    def derivatives(self) -> list[float]:
        """Derivatives of the continuous states, as they are set."""
        if self.count:
            self.instance.call("GetContinuousStateDerivatives", self._dx, ctypes.c_size_t(self.count))
        return list(self._dx[: self.count])

    def _signs(self) -> list[bool]:
        if self.indicators:
            self.instance.call("GetEventIndicators", self._z, ctypes.c_size_t(self.indicators))
        return [z > 0 for z in self._z[: self.indicators]]

    # ---- steps

    def advance(self, length: float, most: int) -> None:
        """Over `length`, or `most` inner steps, whatever ends first."""
        end = self.time + length
        for _ in range(most):
            if self.instance.ended or self.time >= end:
                return
            limit = min(end, self.next) - self.time
            signs = self._signs()
            self._inner(max(limit, 0.0))
            flags = [self.instance.flag(), self.instance.flag()]
            self.instance.call(
                "CompletedIntegratorStep", self.instance.flag(True), *(ctypes.byref(f) for f in flags)
            )
            self.instance.ended = bool(flags[1].value)
            if flags[0].value or self.time >= self.next or signs != self._signs():
                self._event()

    def _inner(self, limit: float) -> None:
        """One accepted step of at most `limit`."""
        x = self.states()
        if not self.count or limit == 0.0:
            self.time += limit
            self.put(self.time, x)
            return
        h = min(limit, self.trial or 1e-3 * limit)
        while True:
            new, error = self._try(x, h)
            growth = 0.9 * error ** (-1 / 3) if error > 0 else 5.0
            if error <= 1.0:
                break
            h *= max(0.1, min(growth, 0.5))
            if h < 1e-14 * max(limit, abs(self.time)):
                raise Refused("the integration with explicit steps", 3, "no step is short enough")
        self.trial = h * min(5.0, growth)
        self.time = limit + self.time if h == limit else self.time + h
        self.put(self.time, new)

    def _try(self, x: Sequence[float], h: float) -> tuple[list[float], float]:
        """States after h, and error over tolerance: infinite when something is not finite or refused."""
        try:
            k1 = self._slope(self.time, x)
            k2 = self._slope(self.time + h / 2, _along(x, h / 2, k1))
            k3 = self._slope(self.time + 3 * h / 4, _along(x, 3 * h / 4, k2))
            new = [a + h / 9 * (2 * b + 3 * c + 4 * d) for a, b, c, d in zip(x, k1, k2, k3, strict=True)]
            k4 = self._slope(self.time + h, new)
        except Refused as refusal:
            if refusal.status != DISCARD:
                raise
            return list(x), math.inf
        errors = [
            abs(h / 72 * (-5 * b + 6 * c + 8 * d - 9 * e)) / (TOLERANCE * max(abs(a), n))
            for a, b, c, d, e, n in zip(x, k1, k2, k3, k4, self.nominal, strict=True)
        ]
        worst = max(errors)
        return new, worst if math.isfinite(sum(errors)) else math.inf

    def _slope(self, time: float, x: Sequence[float]) -> list[float]:
        self.put(time, x)
        return self.derivatives()


def _along(x: Sequence[float], h: float, k: Sequence[float]) -> list[float]:
    return [a + h * b for a, b in zip(x, k, strict=True)]
