"""A live machine: its physics runs in a process of its own, this is who drives and watches it."""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orchestrator.errors import Problem, suggest
from orchestrator.files.trace import Trace
from orchestrator.live.board import Orders
from orchestrator.live.limits import check
from orchestrator.live.session import Session
from orchestrator.live.setup import Array, Frame, Setup
from orchestrator.live.speed import factor_of

APART = 10_000  # frames between the numbers of two sessions: the old one goes on while the new one is started
POLL = 2e-3  # [s] between two looks at a machine that is awaited


class Station:
    """A machine in real time, see `setup.Machine`.

    Every session (start or restart) has a process and memory of its own. Numbers of frames go on counting.
    """

    drives = True

    def __init__(self, setup: Setup, playing: bool = True, speed: float = 1.0) -> None:
        """Returns when the machine is ready; raises Problem for a mistake in the setup."""
        self._playing, self._speed, self._serial = playing, factor_of(speed), 0
        self._lock = threading.Lock()  # among the threads of this process
        self._ending: list[threading.Thread] = []
        self._session = self._open(setup, 0)
        try:
            frame = self.ready()
            if frame.state == "failed":
                raise Problem(frame.message)
        except BaseException:
            self.close()
            raise

    # ---- what it is

    @property
    def setup(self) -> Setup:
        """What runs now."""
        return self._session.setup

    @property
    def axes(self) -> tuple[str, ...]:
        return self._session.axes

    @property
    def signals(self) -> tuple[str, ...]:
        return self._session.setup.signals

    @property
    def units(self) -> Mapping[str, str]:
        """Of axes and signals; empty until the machine is ready."""
        return self._session.units

    @property
    def notes(self) -> tuple[str, ...]:
        """What there is to say about how this session runs."""
        return self._session.notes

    @property
    def pid(self) -> int:
        """Number of the process that steps the machine."""
        return self._session.pid

    # ---- driving

    def command(self, values: Mapping[str, float]) -> None:
        """New values by axis; what is not named goes to rest. They expire after `patience`."""
        with self._lock:
            wanted = {axis.name: float(axis.rest) for axis in self.setup.axes}
            for name, value in values.items():
                if name not in wanted:
                    raise Problem(f"unknown axis {str(name)[:40]!r}{suggest(str(name)[:40], wanted)}")
                wanted[name] = _number(name, value)
            self._serial += 1
            self._wanted = np.array([*wanted.values()], dtype=np.float64)
            self._order(self._session)

    def play(self) -> None:
        """Go on."""
        self._set(True, self._speed)

    def pause(self) -> None:
        """Stand still; nothing is forgotten."""
        self._set(False, self._speed)

    def speed(self, factor: float) -> None:
        """How many times as fast as real time, 0.1 to 10."""
        self._set(self._playing, factor_of(factor))

    def restart(self, setup: Setup | None = None) -> None:
        """From the beginning, perhaps with another setup; returns at once, the state is "starting".

        It plays or stays paused as before. A setup that does not work makes the state "failed".
        """
        with self._lock:
            old = self._session
            if old.closed:
                raise Problem("the machine is closed")
            self._session = self._open(setup or old.setup, old.latest().number + APART)
            ending = threading.Thread(target=old.close, daemon=True)
            ending.start()
            self._ending = [t for t in self._ending if t.is_alive()] + [ending]

    def close(self) -> None:
        """End the process. May be repeated; the frames stay readable."""
        with self._lock:
            self._session.close()
            for ending in self._ending:
                ending.join()

    # ---- watching

    def latest(self) -> Frame:
        """What is known now; before the first frame of a session the numbers in it are NaN."""
        return self._session.latest()

    def since(self, number: int) -> tuple[NDArray[np.int64], Array, Array, Array]:
        """Numbers (n,), times (n,), axes (n, axes), values (n, signals) of the frames after a number.

        Of this session only; what is no longer in memory is left out.
        """
        return self._session.since(number)

    def trace(self) -> Trace:
        """The session, as far as it is in memory (see `notes`): axes and signals over time."""
        return self._session.trace()

    def ready(self, patience: float = 60.0) -> Frame:
        """Wait until the machine has started, or failed to; at most `patience` [s]."""
        until = time.monotonic() + patience
        while (frame := self.latest()).state == "starting":
            if time.monotonic() > until:
                raise Problem(f"{self.setup.system}: not ready within {patience:g} s")
            time.sleep(POLL)
        return frame

    # ---- inside

    def _open(self, setup: Setup, before: int) -> Session:
        """A session; `before` is the number of what is shown before its first frame."""
        plain = _plain(setup)
        check(plain)
        session = Session(plain, before + 1, self._serial)
        self._wanted = np.array([axis.rest for axis in plain.axes], dtype=np.float64)
        self._order(session)
        return session

    def _set(self, playing: bool, speed: float) -> None:
        with self._lock:
            self._playing, self._speed = playing, speed
            self._order(self._session)

    def _order(self, session: Session) -> None:
        session.board.order(Orders(self._playing, self._speed, self._serial, self._wanted))


def _plain(setup: Setup) -> Setup:
    """The same setup in types that any process reads."""
    return replace(
        setup,
        system=str(setup.system),
        axes=tuple(setup.axes),
        signals=tuple(setup.signals),
        swap={name: str(fmu) for name, fmu in setup.swap.items()},
        parameters=tuple(str(name) for name in setup.parameters),
        set=dict(setup.set),
    )


def _number(name: str, value: Any) -> float:
    """A finite number, or a Problem."""
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        number = np.nan
    if not np.isfinite(number):
        raise Problem(f"axis {name}: expected a finite number, got {repr(value)[:40]}")
    return number
