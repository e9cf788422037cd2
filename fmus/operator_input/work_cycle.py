"""Work cycle and other programs of the operator, as lists of joystick strokes with linear ramps.

An electronic joystick amplifier ramps its valve current linearly; `Move` is one stroke of a joystick axis. A
scenario is a list of moves, sampled at 200 Hz (the rate of the paper). All corners are samples, so linear
interpolation between the samples is exact.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fmus.contract import Subsystem, quantities
from fmus.operator_input.model import LEVERS, PAYLOADS, STROKES, Stroke, operator
from fmus.parameters import Number
from orchestrator.base.errors import Problem

RATE = 200.0  # Hz, sampling rate in section 4 of the paper
COMMANDS = ("swing_command", "boom_command", "stick_command")


@dataclass(frozen=True)
class Move:
    """One stroke of a joystick axis: from `start` [s] ramp to `command` [V], hold, ramp back to zero.

    rise, hold, fall: durations [s]. A swing needs a long fall, because the valve brakes the inertia of the
    arm.
    """

    axis: str
    start: float
    command: float
    rise: float
    hold: float
    fall: float

    def sample(self, time: NDArray[np.float64]) -> NDArray[np.float64]:
        """Command [V] at `time` [s], shape (n,)."""
        corners = np.cumsum([self.start, self.rise, self.hold, self.fall])
        return np.interp(time, corners, [0.0, self.command, self.command, 0.0])


@dataclass(frozen=True)
class Stem:
    """One payload: the head takes it up at `start` [s] and lets it go after `hold` [s]; mass [kg]."""

    start: float
    mass: float
    hold: float

    def sample(self, time: NDArray[np.float64]) -> NDArray[np.float64]:
        """Mass [kg] at `time` [s], shape (n,)."""
        return np.where((self.start <= time) & (time < self.start + self.hold), self.mass, 0.0)


# Two trees: slew out and reach, place the head, grip and cut, lift and fold, slew back, set down.
# Without a payload: only the motion of the arm. With stems: WORK_CYCLE_STEMS.
WORK_CYCLE: tuple[Move, ...] = (
    Move("boom", 1.0, 3.2, 0.30, 0.70, 0.50),  # lift the head off the ground
    Move("swing", 1.5, 3.6, 0.50, 1.50, 1.50),  # slew out to the left ...
    Move("stick", 2.0, -3.4, 0.40, 1.30, 0.50),  # ... while reaching out
    Move("boom", 4.2, -2.6, 0.40, 1.10, 0.60),  # lower next to the tree
    Move("stick", 5.4, -2.2, 0.30, 0.50, 0.40),  # last bit of reach
    Move("swing", 6.6, 1.8, 0.40, 0.40, 0.80),  # close in sideways: grip and cut until 10 s
    Move("boom", 10.0, 4.2, 0.40, 1.30, 0.60),  # lift the stem
    Move("stick", 10.6, 3.4, 0.40, 1.60, 0.50),  # fold in
    Move("swing", 11.2, -3.8, 0.60, 1.60, 1.60),  # slew back
    Move("boom", 14.0, -2.6, 0.40, 1.40, 0.60),  # set down
    Move("swing", 15.2, -2.0, 0.40, 0.50, 0.90),  # aim: feed and buck until 20 s
    Move("stick", 17.2, 1.8, 0.30, 0.40, 0.30),
    Move("boom", 20.0, 3.6, 0.30, 0.90, 0.50),  # second tree, to the right, farther out
    Move("swing", 20.4, -3.4, 0.60, 1.70, 1.70),
    Move("stick", 20.9, -4.0, 0.50, 1.90, 0.60),
    Move("boom", 23.4, -2.4, 0.40, 1.20, 0.60),
    Move("swing", 25.2, -1.6, 0.40, 0.50, 0.80),
    Move("boom", 26.4, 1.5, 0.30, 0.40, 0.50),  # correct upwards: grip and cut until 30 s
    Move("boom", 30.0, 4.0, 0.50, 1.00, 1.20),
    Move("stick", 30.4, 4.0, 0.50, 1.90, 0.60),
    Move("swing", 31.0, 3.8, 0.70, 1.90, 1.80),
    Move("boom", 34.2, -2.8, 0.40, 1.20, 0.60),
    Move("swing", 35.6, 2.0, 0.40, 0.60, 0.90),
    Move("stick", 37.4, -1.8, 0.30, 0.50, 0.30),
)
WORK_CYCLE_STOP = 42.0  # s
# The same strokes with a stem of each tree: grabbed after the cut, let go when it has been fed and bucked.
# A spruce of 0.35 m3 weighs 300 kg (fresh, 850 kg/m3); the head holds it in the middle of its mass.
STEMS = (Stem(9.4, 300.0, 9.6), Stem(29.4, 250.0, 9.6))

# programs of the operator by name; all but still are also scenarios in data/scenarios
DEFAULT = "work_cycle"
WITH_STEMS = "work_cycle_stems"
PROGRAMS: Mapping[str, tuple[Move | Stem, ...]] = {
    DEFAULT: WORK_CYCLE,
    WITH_STEMS: (*WORK_CYCLE, *STEMS),
    "boom_up": (Move("boom", 1.0, 5.0, 0.3, 1.0, 0.5),),
    "still": (),
}


def sample(moves: Sequence[Move | Stem], stop: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Time (n,) [s] at 200 Hz and commands (n, 3) [V] in the order of COMMANDS; moves of one axis add up."""
    time = np.arange(round(stop * RATE) + 1) / RATE
    strokes = [m for m in moves if isinstance(m, Move)]
    columns = [
        sum((m.sample(time) for m in strokes if f"{m.axis}_command" == name), np.zeros(time.size))
        for name in COMMANDS
    ]
    return time, np.column_stack(columns)


def payload(moves: Sequence[Move | Stem], time: NDArray[np.float64]) -> NDArray[np.float64]:
    """Payload [kg] at `time` [s], shape (n,)."""
    return sum((m.sample(time) for m in moves if isinstance(m, Stem)), np.zeros(time.size))


UNSET = operator(LEVERS, Path(__file__).with_name("parameters.toml"))


def program(moves: Sequence[Move | Stem], operator: Subsystem = UNSET) -> dict[str, float]:
    """The moves as parameters of an operator; all parameters of unused strokes and payloads are zero."""
    values = dict.fromkeys(quantities(operator.parameters), 0.0)
    for lever in dict.fromkeys(move.axis for move in moves if isinstance(move, Move)):
        strokes = [move for move in moves if isinstance(move, Move) and move.axis == lever]
        if len(strokes) > len(STROKES):
            raise Problem(f"{lever} lever: {len(strokes)} strokes, expected at most {len(STROKES)}")
        for n, move in enumerate(strokes, 1):
            values |= {f"{lever}_{n}_{field}": getattr(move, field) for field in quantities(Stroke)}
    stems = [move for move in moves if isinstance(move, Stem)]
    if len(stems) > len(PAYLOADS):
        raise Problem(f"{len(stems)} stems, expected at most {len(PAYLOADS)}")
    for n, stem in enumerate(stems, 1):
        values |= {f"payload_{n}_{field}": value for field, value in vars(stem).items()}
    return values


def with_program(operator: Subsystem, moves: Sequence[Move | Stem], note: str) -> Subsystem:
    """The operator with these moves as default."""
    values, found = program(moves, operator), dict[str, Number]()
    for n, q in quantities(operator.parameters).items():
        stroke, kind = n.rpartition("_")[0], "payload" if n.startswith("payload") else "stroke"
        used = values[f"{stroke}_mass" if kind == "payload" else f"{stroke}_command"]
        found[n] = Number(values[n], q.unit, "assumed", note if used else f"{kind} not used")
    return replace(operator, numbers={"parameters": found, "start": {}})


OPERATOR = with_program(UNSET, WORK_CYCLE, "work cycle, fmus/operator_input/work_cycle.py")
