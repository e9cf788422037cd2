"""What would spoil every run of a study, found before the first one."""

from __future__ import annotations

from collections.abc import Mapping

from orchestrator.coupling.grid import Grid, free_grid, grid
from orchestrator.errors import Problem
from orchestrator.settings import Coupling
from orchestrator.sweep import design
from orchestrator.sweep.cases import Case, Options, driven
from orchestrator.sweep.factors import nominals
from orchestrator.sweep.study import Study
from orchestrator.system.system import Port

MOST = 1_000_000  # runs: some gigabytes, when their numbers are put into one table


def check(study: Study, cases: Mapping[Options, Case]) -> None:
    """Problem where no run could do what the study asks for."""
    if (count := design.count(study)) > MOST:
        raise Problem(f"expected at most {MOST:,} runs, got {count:,}")
    for options, case in cases.items():
        _free(study, options, case)
        _once(study, case)
        nominals(study, case.system)
    _windows(study, [_times(study, case) for case in cases.values()])


def _free(study: Study, options: Options, case: Case) -> None:
    """Nothing that a scenario drives is set: it would have no effect."""
    if found := driven(case, [*study.fixed, *(f.name for f in study.factors)]):
        told = f"{', '.join(options)}: the scenario drives {found[0]}"
        raise Problem(f"choices: {told}, expected none that is fixed or a factor")


def _once(study: Study, case: Case) -> None:
    """No variable is set twice, as one of the two would have no effect; a share may be of what is fixed."""
    there = [f for f in study.factors if case.system.has(f.name)]
    setters = [(f"factors.{f.name}", f.name) for f in there]
    absolute = {port for f in there if not f.relative for port, _ in case.system.targets(f.name)}
    seen: dict[Port, str] = {}
    for told, name in setters:
        for port, _ in case.system.targets(name):
            if port in seen:
                raise Problem(f"{told}: sets {port}, expected one that {seen[port]} does not set")
            seen[port] = told
    for name in study.fixed:
        for port, _ in case.system.targets(name) if case.system.has(name) else ():
            if port in absolute:
                raise Problem(f"fixed: {name}: expected none that {seen[port]} sets")


def _times(study: Study, case: Case) -> Grid:
    """The communication points of the runs of a case, as `run` finds them."""
    coupling = case.system.coupling or Coupling()
    coupling.check(case.system.components)
    given = case.system, case.scenario, study.step, None, study.stop, study.record_step
    return grid(*given) if coupling.adaptive is None else free_grid(*given, ())


def _windows(study: Study, times: list[Grid]) -> None:
    """Each output has a window that some run reaches."""
    begin, end = min(t.start for t in times), max(t.stop for t in times)
    for output in study.outputs:
        if output.start is not None and output.start > end:
            raise Problem(f"outputs.{output.name}: start: expected at most {end:g} s, got {output.start:g} s")
        if output.stop is not None and output.stop < begin:
            raise Problem(
                f"outputs.{output.name}: stop: expected at least {begin:g} s, got {output.stop:g} s"
            )
