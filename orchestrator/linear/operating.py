"""The operating point at a time of a co-simulation: its states and inputs, by name."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from orchestrator.errors import Problem
from orchestrator.files.trace import Trace
from orchestrator.linear.plant import Plant
from orchestrator.runs.simulation import run
from orchestrator.system.system import System


def along(
    plant: Plant, system: System, scenario: Trace | str | Path | None, time: float, step: float | None
) -> tuple[str, ...]:
    """Bring the plant to where a run of the system is at `time` [s]. Returns notes.

    The wires of the plant carry what the outputs are there. In the run an input that follows another
    component lags behind by part of a step, so the time derivatives may differ from those of the run.
    """
    start = system.start or 0.0
    if not np.isfinite(time) or time < start:
        raise Problem(f"--time {time:g}: expected a time from {start:g} s on")
    if time == start:
        plant.settle(plant.x.copy(), plant.u)
        return ()
    names = [str(p) for p in (*plant.states, *plant.inputs)]
    result = run(system, scenario, step=step, stop=time, record=names, record_step=None)
    last = {name: float(result.trace[name][-1]) for name in names}
    if abs(float(result.trace.time[-1]) - time) > 1e-9 * max(1.0, time):
        end = f"the run ends at {result.trace.time[-1]:g} s"
        raise Problem(f"--time {time:g}: expected a multiple of the communication step, {end}")
    plant.at(time)
    plant.v[:] = [last[str(p)] for p in plant.inputs]
    plant.constant[~plant.fed] = plant.v[~plant.fed]
    plant.settle(np.array([last[str(p)] for p in plant.states]), plant.u)
    return ()
