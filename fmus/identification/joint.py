"""The joint refinement as a step on the way: what is told while it runs, and of its result."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from fmus.identification import machine
from fmus.identification.known import Known
from fmus.identification.recordings.recording import Recording
from fmus.identification.refinement.advice import advice
from fmus.identification.refinement.refine import refine
from fmus.identification.refinement.result import Refined
from fmus.identification.refinement.starts import SPREAD, Starts, from_random_starts

Tell = Callable[[str], None]


def together(recordings: Sequence[Recording], known: Known, names: Sequence[str], tell: Tell) -> Refined:
    """All parameters against all recordings of the machine."""
    task = machine.problem(recordings, known, names)
    seconds = sum(float(run.time[-1] - run.time[0]) for run in task.training)
    tell(f"joint refinement: {len(task.free)} parameters, {len(task.outputs)} signals, {seconds:.0f} s;")
    for line in machine.assumed(recordings):
        tell(f"  {line}")
    tell("  predictions over half a second first, then whole recordings, then their weights")
    found = refine(
        task,
        progress=lambda p: tell(f"  iteration {p.iteration}: {p.predicted:.2g} standard deviations to go"),
    )
    size = found.history[-1].residual if found.history else float("nan")
    tell(f"  {found.reason}; residuals are {size:.3g} times what the sensors explain")
    for line in advice(found):
        tell(f"  {line}")
    return found


def again(refined: Refined, count: int, tell: Tell) -> Starts:
    """The same search from random starts."""
    found = from_random_starts(refined, count=count)
    if not found.starts:
        return found
    reached = round(found.share * len(found.starts))
    tell(
        f"random starts, up to {100 * SPREAD:.0f} % away or twice the standard deviation known before: "
        f"{reached} of {len(found.starts)} lead to the same result, on every fourth sample"
    )
    return found
