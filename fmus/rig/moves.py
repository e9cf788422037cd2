"""What the levers do in the experiments on the whole machine. All corners lie on the 200 Hz grid.

Training covers the work space, small and large commands and all pairs of axes together; the test is the
project's own work cycle, which no part of the training repeats.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from fmus.poses import Pose
from fmus.scenarios import Move

# strokes there and back, slow and fast; (command [V], hold [s]) of each
_STROKES: Mapping[str, Sequence[tuple[float, float]]] = {
    "swing": ((2.0, 1.5), (-3.0, 1.2), (3.5, 1.0), (-2.5, 1.0), (1.5, 1.5), (-3.2, 0.8)),
    "boom": ((2.2, 1.4), (-1.6, 1.8), (3.0, 1.0), (-2.4, 1.2), (1.5, 1.6), (-1.4, 1.4), (3.2, 0.7)),
    "stick": ((2.0, 1.6), (-2.0, 1.6), (3.0, 1.1), (-2.6, 1.2), (1.5, 1.8), (-1.5, 1.8), (3.2, 0.8)),
}
_RISE = {"swing": 0.5, "boom": 0.3, "stick": 0.4}  # s
_FALL = {"swing": 1.3, "boom": 0.5, "stick": 0.6}
_PAUSE = 0.3  # s between strokes


def strokes(joint: str, sign: int = 1) -> list[Move]:
    """One joint there and back from 1 s on, several times; `sign` -1 begins the other way."""
    moves, start = [], 1.0
    for command, hold in _STROKES[joint]:
        moves.append(Move(joint, start, sign * command, _RISE[joint], hold, _FALL[joint]))
        start = round(stop(moves[-1:]) + _PAUSE, 3)
    return moves


def stop(moves: Sequence[Move]) -> float:
    """When the last move is over [s]."""
    return round(max(m.start + m.rise + m.hold + m.fall for m in moves), 3)


# start poses of the damping runs and the way they begin: inside the stroke of the joint that moves, and with
# different levers dl/dq in the two runs, so that friction of piston and joint can be told apart
DAMPING: Mapping[str, Sequence[tuple[Pose, int]]] = {
    "swing": ((Pose(0.2, -1.4), 1), (Pose(0.4, -1.9), -1)),
    "boom": ((Pose(0.0, -1.4), 1), (Pose(0.5, -1.8), 1)),
    "stick": ((Pose(0.4, -1.1), 1), (Pose(0.3, -2.0), -1)),
}

TRAIN_1: tuple[Move, ...] = (  # low and near, then high and far
    Move("boom", 1.0, 2.8, 0.4, 0.9, 0.6),
    Move("swing", 1.6, 2.6, 0.5, 1.3, 1.4),
    Move("stick", 2.6, -2.8, 0.4, 1.2, 0.6),
    Move("boom", 4.0, 4.2, 0.5, 0.7, 0.9),
    Move("swing", 5.2, -1.6, 0.4, 1.0, 0.8),
    Move("stick", 5.6, -1.5, 0.4, 1.4, 0.5),
    Move("boom", 7.4, -2.2, 0.4, 1.4, 0.6),
    Move("swing", 8.2, -3.6, 0.6, 1.5, 1.6),
    Move("stick", 9.0, 3.2, 0.4, 1.0, 0.6),
    Move("boom", 10.8, 1.4, 0.3, 1.0, 0.4),
    Move("stick", 12.0, 1.6, 0.3, 0.9, 0.4),
    Move("swing", 12.4, 1.4, 0.4, 1.2, 0.8),
    Move("boom", 13.6, 3.2, 0.4, 0.8, 0.7),
    Move("swing", 15.2, 3.8, 0.7, 1.2, 1.8),
    Move("stick", 15.6, -3.4, 0.5, 1.0, 0.8),
    Move("boom", 17.6, -1.5, 0.4, 1.6, 0.5),
    Move("stick", 18.6, 2.4, 0.4, 1.3, 0.6),
    Move("swing", 19.6, -2.2, 0.5, 0.9, 1.0),
    Move("boom", 21.0, -2.8, 0.5, 0.9, 0.8),
    Move("stick", 22.0, 4.2, 0.6, 0.7, 1.0),
    Move("swing", 23.0, -2.8, 0.5, 1.0, 1.4),
    Move("boom", 24.2, 1.8, 0.3, 0.8, 0.5),
    Move("stick", 25.2, -1.8, 0.4, 1.0, 0.5),
    Move("swing", 26.4, 1.8, 0.4, 0.6, 0.9),
    Move("boom", 27.0, -1.6, 0.4, 0.8, 0.5),
)
TRAIN_2: tuple[Move, ...] = (  # far and high, then near and low
    Move("stick", 1.0, 2.6, 0.4, 1.3, 0.6),
    Move("swing", 1.4, -3.0, 0.6, 1.4, 1.5),
    Move("boom", 2.2, -2.6, 0.4, 1.2, 0.7),
    Move("stick", 4.4, 1.5, 0.3, 1.2, 0.4),
    Move("boom", 5.0, 1.6, 0.3, 1.1, 0.5),
    Move("swing", 5.6, 2.0, 0.4, 1.0, 1.0),
    Move("stick", 7.2, 3.6, 0.5, 0.9, 0.8),
    Move("boom", 8.0, -1.4, 0.4, 1.2, 0.5),
    Move("swing", 8.6, 3.4, 0.6, 1.3, 1.6),
    Move("boom", 10.6, 4.0, 0.5, 0.7, 0.9),
    Move("stick", 11.4, -2.2, 0.4, 1.2, 0.6),
    Move("swing", 12.8, 1.5, 0.4, 0.9, 0.8),
    Move("boom", 13.4, -2.4, 0.4, 1.1, 0.6),
    Move("stick", 14.6, -1.6, 0.4, 1.4, 0.5),
    Move("swing", 15.4, -3.8, 0.7, 1.4, 1.8),
    Move("boom", 16.2, 2.2, 0.4, 1.0, 0.5),
    Move("stick", 17.8, 2.9, 0.4, 0.9, 0.6),
    Move("boom", 19.2, -1.8, 0.4, 1.3, 0.5),
    Move("swing", 20.2, -1.5, 0.4, 1.2, 0.8),
    Move("stick", 20.8, -3.2, 0.5, 0.9, 0.8),
    Move("boom", 22.6, 3.0, 0.4, 0.9, 0.7),
    Move("swing", 23.2, 2.8, 0.6, 1.0, 1.4),
    Move("stick", 24.2, 1.8, 0.3, 1.0, 0.5),
    Move("boom", 25.6, -2.0, 0.4, 1.1, 0.6),
    Move("stick", 26.2, -2.4, 0.4, 0.8, 0.6),
)
TRAINING = ((TRAIN_1, Pose(-0.1, -1.5, -0.4)), (TRAIN_2, Pose(0.7, -0.95, 0.5)))
TRAINING_STOP = 30.0  # s each
