"""What the commands of the command line do; prints results, raises Problem for mistakes."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from orchestrator.coupling.grid import RECORD, communication_step, thinned
from orchestrator.errors import Problem
from orchestrator.files.trace import Trace, check_suffix, write
from orchestrator.runs.sidecar import write_facts
from orchestrator.runs.simulation import Interrupted, Result, RunFailed
from orchestrator.runs.simulation import run as simulate
from orchestrator.system.ssp import load

BUILT, MAKE = Path("build/harvester.ssp"), "harvester build"


def run(system: Path, scenario: Path | None, out: Path, **options: Any) -> None:
    """Co-simulate, write the trace, print the accuracy card; an aborted run leaves its trace too."""
    save(simulated(system, scenario, out, **options), out, given(scenario=scenario, **options))


def given(coupling: Mapping[str, Any] | None = None, **options: Any) -> dict[str, Any]:
    """What the user asked for, in one mapping, to note beside a trace."""
    return {**options, **(coupling or {})}


def simulated(
    system: Path,
    scenario: Path | Trace | None,
    out: Path,
    step: float | None = None,
    record_step: float | None = None,
    coupling: Mapping[str, Any] | None = None,
    everywhere: bool = True,
    cut: Sequence[str] = (),
    swap: Mapping[str, str] | None = None,
    **options: Any,
) -> Result:
    """Co-simulate with a progress bar; a run that ends early is saved to the file `out`.

    record_step   [s]; default: 5 ms or as near below it as the step allows, at least one step
    coupling      choices that the user makes, named like the fields of `Coupling`
    everywhere    without a record step an adaptive run records every communication point, else every 5 ms
    cut           patterns of the inputs whose connections are left out, before anything else
    swap          other FMUs: component -> name of a variant, or path
    """
    check_suffix(out)
    loaded = load(there(system)).without(*cut).swapped(swap or {})
    loaded = loaded.coupled(coupling) if coupling else loaded
    if record_step is None and loaded.coupling and loaded.coupling.adaptive is not None:
        interval = None if everywhere else RECORD
    else:
        interval = thinned(communication_step(loaded, step)) if record_step is None else record_step
    folder(out.parent)
    try:
        return simulate(loaded, scenario, step=step, record_step=interval, progress=True, **options)
    except (RunFailed, Interrupted) as ended:
        own = {"step": step, "record_step": record_step, "cut": cut, "swap": swap}
        file = None if isinstance(scenario, Trace) else scenario
        save(ended.result, out, given(coupling, scenario=file, **own, **options))
        raise


def there(system: Path) -> Path:
    """The system, if there is such a file."""
    if not system.exists():
        raise Problem(f"{system}: no such file" + (f"; make it with: {MAKE}" if system == BUILT else ""))
    return system


def folder(path: Path) -> None:
    """Make a folder for files to come, before work is spent on them."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise Problem(f"{path}: expected a folder, and none can be made: {error.strerror}") from None
    if not os.access(path, os.W_OK):
        raise Problem(f"{path}: expected a folder to write to, got no permission")


def save(result: Result, out: Path, given: Mapping[str, Any]) -> None:
    """Write the trace and, beside it, what the run was; print the card."""
    write(result.trace, out)
    write_facts(result, out, given)
    print(result.card.text())
    end = f"up to t = {result.trace.time[-1]:.6g} s " if len(result.trace.time) else ""
    kept = "" if result.complete else f"the run ended early; what was recorded {end}is kept in "
    print(f"\n{kept}{contents(result, out)}")


def contents(result: Result, out: Path) -> str:
    """The file of a trace and what is in it."""
    trace, card = result.trace, result.card
    thin = card.record_step > card.step or (card.adaptive is not None and card.record_step > 0)
    every = f", every {card.record_step:g} s" if thin else ""
    return f"{out}: {len(trace.signals)} signals, {len(trace.time)} rows{every}"


def signals(system: Path, kind: str | None = None, swap: Mapping[str, str] | None = None) -> None:
    """Print the variables of a system, `swap` as in `simulated`."""
    from orchestrator.system.signals import lines

    print("\n".join(lines(load(there(system)).swapped(swap or {}), kind)))


def compare(traces: Sequence[Path], out: Path, **options: Any) -> None:
    """Compare traces with one of them, print tables, write the picture and the numbers."""
    from orchestrator import comparison

    found = comparison.compare(traces, **options)
    folder(out)
    picture, numbers = comparison.write(found, out)
    print(f"{comparison.text(found)}\n\npicture: {picture}\nnumbers: {numbers}")
