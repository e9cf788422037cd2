"""`harvester sweep`: run a parameter study."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from orchestrator.base.errors import Problem
from orchestrator.base.extras import require
from orchestrator.base.options import Kind
from orchestrator.cli.options import Folder, command, tell_built


@command
def sweep(
    study: Annotated[Path, Kind("STUDY.toml", positional=True)],
    out: Folder | None = None,
    workers: Annotated[int | None, Kind("N", least=1)] = None,
    scheduler: Annotated[str | None, Kind("URL")] = None,
    fresh: bool = False,
    no_report: bool = False,
) -> bool:
    """Run a parameter study on all cores.

    An interrupted study continues when it is started again. The exit status is 1 if no run succeeded.

    study       Description of the study: what is varied, what is run, and which results are kept.
    out         Folder of the results; default: build/sweeps/STUDY.
    workers     Number of runs at the same time on this computer; default: one per core.
    scheduler   Run on this Dask cluster instead, such as tcp://host:8786; default: this computer.
    fresh       Delete earlier results in DIR and start again.
    no_report   Leave out the page report.html.
    """
    require("sweep", "harvester sweep")
    from orchestrator.studies import read_study
    from orchestrator.studies.parameter_study import run

    chosen = read_study(study)
    tell_built(chosen.system_file, {})
    if workers and scheduler:
        cluster = "whose cluster determines the number of workers"
        raise Problem(f"--workers: expected none with --scheduler, {cluster}")
    return run(chosen, out, report=not no_report, workers=workers, scheduler=scheduler, fresh=fresh)
