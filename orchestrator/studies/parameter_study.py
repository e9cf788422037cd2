"""`harvester sweep`: run the missing runs of a parameter study, and store the results.

from orchestrator.studies import Factor, Output, Study, sweep

mass = Factor("manipulator.head_mass", "uniform", {"minimum": 300, "maximum": 400})
peak = Output("peak", "swing.swing_pressure_a", "maximum")
study = Study("Head mass", "build/harvester.ssp", runs=50, stop=5.0, factors=(mass,), outputs=(peak,))
table = sweep(study).table  # pandas table with one row per run
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, TextIO

from orchestrator.base.errors import Problem, Stopped
from orchestrator.base.processes import available_cores
from orchestrator.base.progress import Doing
from orchestrator.lanes.group import Status
from orchestrator.lanes.many import ClusterLost, compiles, connected, many
from orchestrator.studies import store
from orchestrator.studies.runs import STORE_TIME, PreparedStudy, RunOutcome, StudyRuns, prepare
from orchestrator.studies.study import Study, read

if TYPE_CHECKING:
    from distributed import Client

FOLDER = Path("build/sweeps")

# all runs, finished runs, outcomes of the last batch
Watch = Callable[[int, int, Sequence[RunOutcome]], None]


def sweep(
    study: Study | str | Path,
    folder: str | Path | None = None,
    *,
    workers: int | None = None,
    scheduler: str | None = None,
    client: Client | None = None,
    fresh: bool = False,
    watch: Watch | None = None,
) -> store.Results:
    """Run the runs of a study that its folder lacks; returns the results, with a pandas table of all runs.

    study      a study or the path of its TOML file
    folder     folder of the results, or its URL; default: build/sweeps/ and the name of the file or the title
    workers    number of parallel runs on this computer; default: one per core
    scheduler  address of a Dask cluster for the runs, such as tcp://host:8786
    client     a connection to a Dask cluster for the runs; it stays open
    fresh      delete the results of a study in the folder
    watch      called before the first run and after each batch: all, finished runs, outcomes of the batch
    """
    study = study if isinstance(study, Study) else read(study)
    folder = store.place(folder or FOLDER / (Path(study.source).stem or study.title or "study"))
    prepared = prepare(study)
    with ExitStack() as stack:
        if not client and (fresh or not store.finished(folder)):
            # connect first: if no scheduler answers, nothing is written or deleted
            client = stack.enter_context(connected(scheduler))
        stack.enter_context(store.locked(folder))
        if fresh:
            store.clear(folder)
        results = store.Store(folder, prepared)
        results.forget_stopped()
        if not store.finished(folder):
            _run_missing(
                prepared, results, client or workers or available_cores(), watch or (lambda *_: None)
            )
            results.finish()
        return store.read(folder)


def _run_missing(prepared: PreparedStudy, results: store.Store, where: int | Client, watch: Watch) -> None:
    """Run the samples without stored results."""
    done, total = results.done(), len(prepared.samples)
    count = len(done)
    watch(total, count, ())
    if count == total:
        return

    def keep(found: Iterable[Sequence[RunOutcome]]) -> None:
        nonlocal count
        batch = [outcome for outcomes in found for outcome in outcomes if outcome.run not in done]
        results.add(batch)
        count += len(batch)
        watch(total, count, batch)

    try:
        with closing(StudyRuns(prepared)) as runs:
            units = runs.units(prepared.samples, compiles(where))
            missing = [unit for unit in units if any(run not in done for run in unit.rows)]
            many(runs, missing, keep, where, STORE_TIME)
    except (KeyboardInterrupt, ClusterLost) as end:
        stored = f"{len(results.done())} of {total} runs are stored in {results.folder}"
        line = f"{stored}; the same command continues the study"
        raise (Problem(f"{end}; {line}") if isinstance(end, ClusterLost) else Stopped(line)) from None


# ---- the command line


@contextmanager
def progress(stream: TextIO | None = None) -> Iterator[Watch]:
    """A line about the runs on standard error, or on `stream`, while they go on."""
    began, new, failed = time.perf_counter(), 0, 0
    line = Doing("starting", stream)

    def watch(total: int, done: int, batch: Sequence[RunOutcome]) -> None:
        nonlocal began, new, failed
        began = began if batch else time.perf_counter()
        new, failed = new + len(batch), failed + sum(r.status == Status.FAILED for r in batch)
        rate = new / (time.perf_counter() - began)
        speed = f", {rate:.1f} runs/s, {(total - done) / rate:.0f} s left" if new else ""
        line.update(f"{done} of {total} runs{speed}{f', {failed} failed' if failed else ''}")

    try:
        yield watch
    finally:
        line.end()
