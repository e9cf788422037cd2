"""What has to be said of a refinement: did it end by itself, how far do its intervals hold?"""

from __future__ import annotations

from fmus.identification.refinement.result import Refined
from fmus.identification.refinement.solver import INTERRUPTED
from fmus.identification.refinement.step import STUCK

FEW = 10  # segments: a standard deviation from so many is known to a quarter, 1 / sqrt(2 (n - 1))


def advice(refined: Refined) -> tuple[str, ...]:
    """Whole sentences, with what to do; none if all is well."""
    return (*_ended(refined), *_intervals(refined))


def _ended(refined: Refined) -> tuple[str, ...]:
    if refined.converged:
        return ()
    told = f"The search did not converge: {refined.reason}"
    if refined.reason == INTERRUPTED:
        return (f"{told}. Values and intervals are those of the best point so far.",)
    if refined.reason == STUCK:
        return (
            f"{told}, because a parameter hardly acts or something switches there, such as dry friction or a "
            "stop. The values are the best so far. Hold what the data cannot tell (--free names the others), "
            "or begin from other numbers.",
        )
    return (
        f"{told} were not enough. The values are the best so far, the intervals are too narrow. "
        "Look for a signal with a wrong sign or unit, and free fewer parameters (--free).",
    )


def _intervals(refined: Refined) -> tuple[str, ...]:
    found = refined.statistics
    if not refined.robust or found.clusters >= FEW:
        return ()
    if found.clusters == 1:
        return (
            "There is a single segment, so that nothing tells how far residuals with a memory move values: "
            "the intervals are a guess, and wide. Longer recordings help.",
        )
    return (
        f"The intervals rest on the scatter between {found.clusters} segments, fewer than {FEW}: "
        "they are wide, and known roughly. Longer recordings help.",
    )
