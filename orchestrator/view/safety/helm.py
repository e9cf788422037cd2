"""What the machine is told: what the sticks mean while it can follow them, else rest."""

from __future__ import annotations

import logging
from collections.abc import Callable

from orchestrator.errors import Problem
from orchestrator.live.setup import Frame, Machine
from orchestrator.view.controls.drive import Full, commands, left_over, modes
from orchestrator.view.controls.patterns import Sticks, functions, pattern
from orchestrator.view.controls.shape import Curve

STILL = 0.5  # s without a new frame: a machine that hangs must not go on by itself when it comes back
log = logging.getLogger(__name__)


class Helm:
    """The only way from a browser to `Machine.command`.

    live   the machine follows the sticks now
    why    it does not, in a few words
    """

    def __init__(self, machine: Machine, full: Full, curve: Curve, clock: Callable[[], float]) -> None:
        """clock: [s], never goes back"""
        self.machine, self.full, self.curve = machine, full, curve
        self.live, self.why = False, "nobody drives"
        self._clock, self._frame, self._seen = clock, -1, clock()
        self._pattern, self._mode = pattern("ISO"), ""

    # ---- what the sticks mean

    @property
    def pattern(self) -> str:
        """The name of the pattern."""
        return self._pattern.name

    @property
    def modes(self) -> tuple[str, ...]:
        """In which the machine can be driven."""
        return modes(self.machine.axes)

    @property
    def mode(self) -> str:
        """The chosen mode, or the first that the machine has: a restart may have changed it."""
        return self._mode if self._mode in self.modes else next(iter(self.modes), "")

    def choose(self, name: str | None, mode: str | None) -> None:
        """Another pattern or mode; Problem for one that there is not."""
        if name is not None:
            self._pattern = pattern(name)
        if mode is not None:
            if mode not in self.modes:
                raise Problem(f"mode: expected one of {', '.join(self.modes)}, found {mode}")
            self._mode = mode

    # ---- what the machine does

    def steer(self, sticks: Sticks) -> bool:
        """The sticks as they are now; False if something is wrong, so that nothing may go on by itself."""
        try:
            frame = self.machine.latest()
            if halt := self._halt(frame):
                return self._refused(halt)
            wanted = functions(sticks, self._pattern, self.curve)
            values = commands(wanted, self.mode, self.machine.axes, self.full)
            if left_over(values, self.machine.axes, frame.axes):
                self.rest("the machine comes to rest before it changes the mode")
                return True
            self.machine.command(values)
        except Problem as error:
            return self._refused(str(error))
        except Exception:  # a machine that breaks must not take the server with it
            log.exception("the machine takes no command")
            return self._refused("the machine takes no command")
        self.live, self.why = True, ""
        return True

    def rest(self, why: str) -> None:
        """All driven inputs to rest."""
        self.live, self.why = False, why
        try:
            self.machine.command({})
        except Exception:
            log.exception("the machine takes no command")

    def _refused(self, why: str) -> bool:
        self.rest(why)
        return False

    def _halt(self, frame: Frame) -> str:
        """Why the machine does not go on; empty if it does."""
        now = self._clock()
        if frame.number != self._frame:
            self._frame, self._seen = frame.number, now
        if frame.state != "running":
            return f"the machine is {frame.state}"
        return "the machine stands still" if now - self._seen > STILL else ""
