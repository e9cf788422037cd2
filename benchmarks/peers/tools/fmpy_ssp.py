"""FMPy's `simulate_ssp`. It records every connector, always, and has no options.

Its loop lies between the last `instantiate_fmu` and the first `free_fmu`.
"""

from __future__ import annotations

import contextlib
import io
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any
from unittest.mock import patch

from fmpy.ssp import simulation

from benchmarks.peers.tools import Run, Spent


class NoChoice(ValueError):
    """What the tool cannot do."""


def run(system: Path, stop: float, record: Sequence[str], judged: Sequence[str], step: float) -> Run:
    """One run."""
    if not record:
        raise NoChoice("FMPy always records")
    stamps: list[Spent] = []
    ready = _stamped(simulation.instantiate_fmu, stamps, after=True)
    done = _stamped(simulation.free_fmu, stamps, after=False)
    with (
        contextlib.redirect_stdout(io.StringIO()),  # what the FMUs say
        patch.object(simulation, "instantiate_fmu", ready),
        patch.object(simulation, "free_fmu", done),
    ):
        # half a step: its sum of steps may fall short of the stop time and then goes on
        rows = simulation.simulate_ssp(str(system), stop_time=stop - step / 2, step_size=step)
    components = len(stamps) // 2
    spent = stamps[components] - stamps[components - 1]
    # a row has the time before the step and the values after it
    return Run(spent, len(rows), rows["time"] + step, {name: rows[name] for name in judged})


def _stamped(call: Callable[..., Any], stamps: list[Spent], after: bool) -> Callable[..., Any]:
    def wrapped(*arguments: Any, **options: Any) -> Any:
        if not after:
            stamps.append(Spent.until_now())
        result = call(*arguments, **options)
        if after:
            stamps.append(Spent.until_now())
        return result

    return wrapped
