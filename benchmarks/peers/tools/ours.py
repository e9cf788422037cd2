"""Our own orchestrator, with its record, accuracy card and energy monitor.

Without recording it has none of them. With an accuracy in place of master and step its trial counts too.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from pathlib import Path
from statistics import median
from typing import Any

from benchmarks.peers.tools import Run, Spent, nothing
from orchestrator import System, load
from orchestrator import run as simulate


def run(system: Path, stop: float, record: Sequence[str], judged: Sequence[str], **options: Any) -> Run:
    """One run; `options` go to `orchestrator.run`."""
    if not record:
        options["bonds"] = ()
    begin = Spent.until_now()
    options = {"isolate": False, **options}  # in this process, as the other tools
    result = simulate(loaded(system), stop=stop, record=list(record), **options)
    whole = Spent.until_now() - begin
    card, trace = result.card, result.trace
    # the card knows the wall time of the loop; the processor is taken to serve it as it does the whole call
    spent = Spent(card.wall, card.wall * whole.cpu / whole.wall)
    if "accuracy" in options:
        spent = whole - opening(system)
    if not record:
        return nothing(spent, card.steps)
    return Run(spent, card.steps, trace.time, {name: trace[name] for name in judged})


@cache
def loaded(system: Path) -> System:
    """Read once."""
    return load(system)


@cache
def opening(system: Path) -> Spent:
    """What it takes to load and initialise the FMUs: the medians of five runs of one step."""
    spent = []
    for _ in range(5):
        begin = Spent.until_now()
        simulate(loaded(system), stop=1e-3, step=1e-3, master="jacobi", isolate=False)
        spent.append(Spent.until_now() - begin)
    return Spent(median(s.wall for s in spent), median(s.cpu for s in spent))
