"""OSP's libcosim by its Python package: its fixed-step algorithm, a time series observer records in memory.

Worker threads are set in the SSP. Without workers the FMUs are stepped by the caller, one after the other.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from libcosimpy.CosimEnums import CosimVariableType
from libcosimpy.CosimExecution import CosimExecution
from libcosimpy.CosimLogging import CosimLogLevel, log_output_level
from libcosimpy.CosimObserver import CosimObserver

from benchmarks.peers.ssp import for_libcosim
from benchmarks.peers.tools import Run, Spent, nothing

Place = tuple[int, int]  # slave, value reference


def run(
    system: Path, stop: float, record: Sequence[str], judged: Sequence[str], step: float, workers: int
) -> Run:
    """One run. The first step initialises too and is not timed."""
    log_output_level(CosimLogLevel.FATAL)
    steps = round(stop / step)
    with tempfile.TemporaryDirectory() as folder:
        copy = for_libcosim(system, Path(folder) / "system.ssp", step, workers)
        execution = CosimExecution.from_ssp_file(str(copy))
        places = _places(execution)
        if record:
            observer = CosimObserver.create_time_series(steps + 1)
            execution.add_observer(observer)
            for name in record:
                observer.start_time_series(*places[name], CosimVariableType.REAL)
        _checked(execution.step(1))
        begin = Spent.until_now()
        done = execution.step(steps - 1)
        spent = Spent.until_now() - begin
        _checked(done)
        if not record:
            return nothing(spent, steps - 1)
        values = {name: _series(observer, places[name], steps) for name in judged}
        return Run(spent, steps - 1, np.arange(1, steps + 1) * step, values)


def _places(execution: CosimExecution) -> dict[str, Place]:
    """Where each variable is."""
    return {
        f"{slave.name.decode()}.{variable.name.decode()}": (slave.index, variable.reference)
        for slave in execution.slave_infos()
        for variable in execution.slave_variables(slave.index)
    }


def _series(observer: CosimObserver, place: Place, steps: int) -> np.ndarray:
    _, _, values = observer.time_series_real_samples(*place, from_step=1, sample_count=steps)
    return np.array(values)


def _checked(done: bool) -> None:
    if not done:
        raise RuntimeError("libcosim: a step failed")
