"""How large the error of a run is, by running again at other steps."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

from orchestrator.coupling.grid import Grid
from orchestrator.runs.card import Card, compare
from orchestrator.runs.job import Job
from orchestrator.runs.result import Interrupted, Result, RunFailed


def estimated(job: Job, times: Grid, result: Result, progress: bool) -> Card:
    """The card of a complete run with error estimates; what happens to the other runs does not harm it."""
    if times.free:
        note = "no error estimate: two adaptive runs only meet at the points of a record step, give one"
        return replace(result.card, notes=(*result.card.notes, note))
    adaptive = job.coupling.adaptive is not None
    try:
        finer = (job.stricter(), times) if adaptive else (job, times.finer())
        fine, coarse = finer[0].run(finer[1], progress).trace, None
        if not adaptive and times.steps >= 4:
            with suppress(RunFailed):
                coarse = job.run(times.coarser(), progress).trace
    except RunFailed as failed:
        which = "a tenth of the tolerance" if adaptive else "half the step"
        note = f"no error estimate, the run at {which} failed: {failed}"
        return replace(result.card, notes=(*result.card.notes, note))
    except Interrupted:
        raise Interrupted(result) from None
    nominals = {str(p): job.system.variable(p).nominal for p in job.system.ports("output")}
    shown = result.trace.select(name for name in nominals if name in result.trace.signals)
    errors = compare(fine, shown, coarse, nominals)
    told = () if errors else ("no error estimate: no output moves",)
    return replace(result.card, errors=errors, notes=(*result.card.notes, *told))
