"""From functions to the driven inputs of a machine.

levers   swing, boom and stick command [V], or the levers of a controller that is not engaged
tip      velocity of the tip in cylinder coordinates [m/s, rad/s], for a controller that is engaged:
         radial = -stick, vertical = boom, swing = swing, so that each hand keeps its direction

What the machine is told: what the sticks mean while it can follow them, else rest.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass

from orchestrator.base.errors import Problem
from orchestrator.realtime.setup import Frame, Machine
from orchestrator.view.driving.sticks import Curve, Functions, StickAxes, functions, pattern

LEVERS, TIP = "levers", "tip"
ENGAGED = "engaged"
VELOCITIES = ("radial_velocity", "vertical_velocity", "swing_velocity")
LEVER_NAMES = {name: (f"{name}_lever", f"{name}_command") for name in ("swing", "boom", "stick")}


@dataclass(frozen=True)
class Full:
    """What full deflection means: levers [V], tip along the radius and up [m/s], swing [rad/s]. Our choice.

    4 V swing this machine at 0.84 rad/s, as fast as the work cycle does; 6 V would be 1.35 rad/s, and a stop
    either hard or 50 degrees long.
    """

    swing_lever: float = 4.0
    lever: float = 6.0
    tip: float = 1.0
    swing: float = 0.4


def modes(axes: Sequence[str]) -> tuple[str, ...]:
    """The modes in which a machine with these axes can be driven."""
    known = {_tail(name) for name in axes}
    levers = any(names & known for names in map(set, LEVER_NAMES.values()))
    tip = {*VELOCITIES, ENGAGED} <= known
    return (*([LEVERS] if levers else []), *([TIP] if tip else []))


def commands(wanted: Functions, mode: str, axes: Sequence[str], full: Full) -> dict[str, float]:
    """Values of the driven inputs, by axis. An axis that the mode does not need is left out: it rests."""
    if mode not in modes(axes):
        possible = " or ".join(modes(axes)) or "nothing that sticks can drive"
        raise Problem(f"mode: this machine takes {possible}, found {mode}")
    values = _tip(wanted, full) if mode == TIP else _levers(wanted, full)
    return {name: values[_tail(name)] for name in axes if _tail(name) in values}


def left_over(named: Collection[str], axes: Sequence[str], values: Iterable[float]) -> bool:
    """Is an axis still away from rest that a mode does not name? Then another mode has the machine."""
    return any(value != 0 for name, value in zip(axes, values, strict=True) if name not in named)


def _levers(wanted: Functions, full: Full) -> Mapping[str, float]:
    most = {"swing": full.swing_lever, "boom": full.lever, "stick": full.lever}
    return {alias: most[name] * getattr(wanted, name) for name, both in LEVER_NAMES.items() for alias in both}


def _tip(wanted: Functions, full: Full) -> Mapping[str, float]:
    velocity = (0.0 - full.tip * wanted.stick, full.tip * wanted.boom, full.swing * wanted.swing)
    return {ENGAGED: 1.0, **dict(zip(VELOCITIES, velocity, strict=True))}


def _tail(name: str) -> str:
    return name.rpartition(".")[2]


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

    def steer(self, sticks: StickAxes) -> bool:
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
