"""Which axis of which stick means which function of the machine.

Sticks, as the hand moves them: x to the right, y away from the operator. Functions, as the machine counts
them: swing positive to the left, boom positive up, stick positive folds in, curl positive closes.

    pattern   left stick: sideways, fore and aft   right stick: sideways, fore and aft
    ISO       swing, stick away and in             curl, boom down and up
    SAE       swing, boom down and up              curl, stick away and in

ISO is the pattern of ISO 10968 and SAE J1177, the excavator's. SAE is that of SAE J1814, the backhoe's: the
hands for boom and stick are exchanged. In both, left swings to the left, and pulling back raises the boom or
draws the stick in. Neither standard is about harvesters. Their makers have patterns of their own, mostly
like ISO, with a rotator instead of the curl and thumb switches for feeding and cutting; this is not one of
them. The model has no rotator and no curl, so that axis does nothing here, and it is shown as such.

From the deflection of one axis to the share of full speed that is meant.

    s(x) = sign(x) ((1 - c) u + c u^3),   u = max(0, (|x| - d) / (1 - d))

d  dead zone: a worn stick does not come back to zero exactly
c  progression: 0 is a straight line, 1 a pure cubic; small movements stay small, full is still full

s is odd, never falls, continuous, and 1 at full deflection. The form is ours; linear plus cubic is what
remote controls call "expo".
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from orchestrator.base.errors import Problem, suggest


@dataclass(frozen=True)
class StickAxes:
    """Deflections [1], -1 to 1: x to the right, y away from the operator."""

    left_x: float = 0.0
    left_y: float = 0.0
    right_x: float = 0.0
    right_y: float = 0.0


@dataclass(frozen=True)
class Functions:
    """Shares of full speed [1], -1 to 1: swing to the left, boom up, stick in, curl closed."""

    swing: float = 0.0
    boom: float = 0.0
    stick: float = 0.0
    curl: float = 0.0


@dataclass(frozen=True)
class Pattern:
    """Which stick raises the boom; the other one moves the stick. The rest is the same in both."""

    name: str
    source: str
    boom: str


PATTERNS: Mapping[str, Pattern] = {
    "ISO": Pattern("ISO", "ISO 10968, SAE J1177: excavator", boom="right"),
    "SAE": Pattern("SAE", "SAE J1814: backhoe", boom="left"),
}


def pattern(name: str) -> Pattern:
    """The pattern of this name; Problem if there is none."""
    if name not in PATTERNS:
        raise Problem(f"pattern: expected {' or '.join(PATTERNS)}, found {name}{suggest(name, PATTERNS)}")
    return PATTERNS[name]


def functions(sticks: StickAxes, chosen: Pattern, curve: Curve) -> Functions:
    """What the hands mean. The curve comes first, so that it is the same for each function."""
    left, right = shaped(sticks.left_y, curve), shaped(sticks.right_y, curve)
    boom, stick = (right, left) if chosen.boom == "right" else (left, right)
    return Functions(  # 0 - x is no -0
        swing=0.0 - shaped(sticks.left_x, curve),
        boom=0.0 - boom,
        stick=0.0 - stick,
        curl=0.0 - shaped(sticks.right_x, curve),
    )


def legend(chosen: Pattern, mode: str) -> dict[str, str]:
    """What each end of each axis does, for the page: `left_up`, `left_down`, ... -> words."""
    tip = mode == "tip"
    boom = {"up": "tip down" if tip else "boom down", "down": "tip up" if tip else "boom up"}
    stick = {"up": "tip out" if tip else "stick out", "down": "tip in" if tip else "stick in"}
    hands = {chosen.boom: boom, "left" if chosen.boom == "right" else "right": stick}
    return {
        "left_left": "swing left",
        "left_right": "swing right",
        "right_left": "(no curl)",
        "right_right": "(no curl)",
        **{f"{hand}_{end}": words for hand, ends in hands.items() for end, words in ends.items()},
    }


@dataclass(frozen=True)
class Curve:
    """Dead zone and progression [1] of all four axes."""

    dead_zone: float = 0.08
    progression: float = 0.6

    def __post_init__(self) -> None:
        if not 0 <= self.dead_zone < 1:
            raise Problem(f"curve: expected a dead zone from 0 to below 1, found {self.dead_zone}")
        if not 0 <= self.progression <= 1:
            raise Problem(f"curve: expected a progression from 0 to 1, found {self.progression}")


def shaped(deflection: float, curve: Curve) -> float:
    """Share of full speed [1], -1 to 1, that a deflection means; beyond the stop is the stop."""
    beyond = (min(abs(deflection), 1.0) - curve.dead_zone) / (1 - curve.dead_zone)
    if not beyond > 0:  # also where the deflection is not a number
        return 0.0
    return math.copysign((1 - curve.progression) * beyond + curve.progression * beyond**3, deflection)
