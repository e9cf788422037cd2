"""PyFMI's `Master`: Jacobi with a fixed step, inputs held or extrapolated; results in memory.

It reads no SSP, so FMUs, connections and start values are handed over. Its wall time is that which
it prints.
"""

from __future__ import annotations

import contextlib
import io
import re
import tempfile
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pyfmi import load_fmu
from pyfmi.master import Master

from benchmarks.peers.tools import Run, Spent, nothing
from orchestrator import load

ELAPSED = re.compile(r"Elapsed simulation time\s*: (\S+) seconds")


def run(
    system: Path, stop: float, record: Sequence[str], judged: Sequence[str], step: float, order: int = 0
) -> Run:
    """One run."""
    described, steps, said = load(system), round(stop / step), io.StringIO()
    with (
        tempfile.TemporaryDirectory() as folder,
        contextlib.chdir(folder),  # logs of the FMUs
        contextlib.redirect_stdout(said),
        zipfile.ZipFile(system) as archive,
    ):
        models = {}
        for name, component in described.components.items():
            fmu = archive.extract(f"resources/{name}.fmu", folder)
            models[name] = load_fmu(fmu, kind="CS", log_level=0, log_file_name=f"{name}.txt")
            for variable, value in component.start.items():
                models[name].set(variable, value)
        master = Master(list(models.values()), _connections(models, described))
        options = master.simulate_options()
        chosen: dict[str, Any] = {
            "step_size": step,
            "extrapolation_order": order,
            "result_handling": "memory",
        }
        chosen["block_initialization"] = True  # without it an output that feeds two inputs is an error
        chosen["filter"] = {
            m: [_variable(r) for r in record if r.startswith(f"{n}.")] for n, m in models.items()
        }
        options.update(chosen)
        begin = Spent.until_now()
        results = master.simulate(0.0, stop, options=options)
        whole = Spent.until_now() - begin
        signals = {n: np.array(results[models[n.partition(".")[0]]][_variable(n)]) for n in judged if record}
        time = np.array(results[next(iter(models.values()))]["time"])
    found = ELAPSED.search(said.getvalue())
    assert found is not None
    wall = float(found[1])
    spent = Spent(wall, wall * whole.cpu / whole.wall)
    return Run(spent, steps, time, signals) if record else nothing(spent, steps)


def _variable(signal: str) -> str:
    return signal.partition(".")[2]


def _connections(models: dict[str, Any], described: Any) -> list[tuple[Any, str, Any, str]]:
    return [
        (models[c.source.component], c.source.variable, models[c.target.component], c.target.variable)
        for c in described.connections
    ]
