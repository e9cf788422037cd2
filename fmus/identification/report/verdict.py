"""What an attribution says, in whole sentences for whoever ran the test."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from fmus.identification.report.attribution import Share

LEAST = 0.2  # share from which an effect is named
CLOSE = 0.8  # of the largest share: an effect that explains as much cannot be told from it
SMALL = 1e-3  # of the range: a residual below needs no effect to explain it, whatever the sensor resolves


def nothing(small: bool) -> str:
    """No signal has a residual worth an explanation; `small`: some are just small, not within the noise."""
    to = f" or to {100 * SMALL:g} % of its range" if small else ""
    return (
        f"Nothing is left to explain: each signal is predicted to the noise of its sensor{to}, "
        "so the residual shows no effect."
    )


def verdict(found: Sequence[Share], together: float, parameters: float, noise: float) -> str:
    """Shares as in `Explanation`, largest alone first."""
    first = found[0]
    if first.alone < LEAST:
        told = (
            f"None of the effects below explains what the prediction misses: the largest share is "
            f"{_percent(first.alone)} ({first.effect}), all of them together explain {_percent(together)}."
        )
    else:
        told = (
            f"The residual shows one effect most: {first.effect}, {_percent(first.alone)} of it, "
            f"{first.coefficient:.2g} times as strong as in the variant. "
            f"All effects together explain {_percent(together)}."
        )
        close = [s.effect for s in found[1:] if s.alone >= CLOSE * first.alone]
        if close:
            told += f" The data hardly tell it from {' and '.join(close)}."
    return told + _rest(together, parameters, noise)


def _rest(together: float, parameters: float, noise: float) -> str:
    """Where what the effects do not explain is from."""
    told, left = "", 1 - together - parameters - noise
    if parameters > LEAST / 2:
        told += (
            f" {_percent(parameters)} would go if the identified parameters had slightly other values: that "
            "part is their uncertainty, or an effect that looks like it."
        )
    if noise > LEAST / 2:
        told += f" {_percent(noise)} is noise of the sensors."
    if left > LEAST / 2:
        told += f" The other {_percent(left)} has a cause that is not in the list."
    return told


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %"
