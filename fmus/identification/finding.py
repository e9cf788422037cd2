"""Tests of what a procedure takes for granted, and which of them say that the data contradict it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

LEVEL = 0.01  # probability that any finding is named although no assumption is wrong


@dataclass(frozen=True)
class Finding:
    """The result of one test.

    fault      what is wrong if the data contradict the assumption, a name such as "zero of a pressure sensor"
    p          probability of data that contradict it as much or more, if it holds
    sentence   the fault with its place and size, for the user
    """

    fault: str
    p: float
    sentence: str


def named(findings: Iterable[Finding]) -> list[Finding]:
    """The findings that the data show, most certain first: Holm's method over all tests of a machine.

    However many tests there are, all assumptions hold and one is named in at most `LEVEL` of all machines
    (S. Holm, A simple sequentially rejective multiple test procedure, Scand. J. Statistics 6, 1979, 65-70).
    """
    ordered = sorted(findings, key=lambda finding: finding.p)
    for n, finding in enumerate(ordered):
        if finding.p * (len(ordered) - n) > LEVEL:
            return ordered[:n]
    return ordered
