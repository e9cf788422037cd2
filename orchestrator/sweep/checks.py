"""What would spoil every run of a study, found before the first one."""

from __future__ import annotations

from collections.abc import Mapping

from orchestrator.coupling.grid import Grid, free_grid, grid
from orchestrator.errors import Problem
from orchestrator.settings import Coupling
from orchestrator.sweep import design
from orchestrator.sweep.cases import Case, Options, driven, fixed
from orchestrator.sweep.factors import nominals
from orchestrator.sweep.limits import limits
from orchestrator.sweep.study import Study
from orchestrator.system.system import Port

NEAR = 1e-9  # of a time: rounding of the sum of steps
MOST = 1_000_000  # runs: some gigabytes, when their numbers are put into one table


def check(study: Study, cases: Mapping[Options, Case]) -> None:
    """Problem where no run could do what the study asks for."""
    if (count := design.count(study)) > MOST:
        raise Problem(f"expected at most {MOST:,} runs, got {count:,}")
    for options, case in cases.items():
        _free(study, options, case)
        _once(study, case)
        system = fixed(study, case.system)
        nominals(study, system)
        limits(study, system)
    _windows(study, [_times(study, case) for case in cases.values()])


def _free(study: Study, options: Options, case: Case) -> None:
    """Nothing that a scenario drives is set: it would have no effect."""
    if found := driven(case, [*study.fixed, *(f.name for f in study.factors)]):
        told = f"{', '.join(options)}: the scenario drives {found[0]}"
        raise Problem(f"choices: {told}, expected none that is fixed or a factor")


def _once(study: Study, case: Case) -> None:
    """No variable is set twice, as one of the two would have no effect; a share may be of what is fixed."""
    there = [f for f in study.factors if case.system.has(f.name)]
    absolute = {port for f in there if not f.relative for port, _ in case.system.targets(f.name)}
    seen: dict[Port, str] = {}
    for name in (f.name for f in there):
        for port, _ in case.system.targets(name):
            if port in seen:
                raise Problem(f"factors: expected one that sets {port}, got {seen[port]} and {name}")
            seen[port] = name
    for name in study.fixed:
        for port, _ in case.system.targets(name) if case.system.has(name) else ():
            if port in absolute:
                same = "" if seen[port] == name else f", which sets {port} as factors.{seen[port]} does"
                raise Problem(f"fixed: expected no factor, got {name}{same}")


def _times(study: Study, case: Case) -> Grid:
    """The communication points of the runs of a case, as `run` finds them."""
    coupling = case.system.coupling or Coupling()
    coupling.check(case.system.components)
    given = case.system, case.scenario, study.step, None, study.stop, study.record_step
    return grid(*given) if coupling.adaptive is None else free_grid(*given, ())


def _windows(study: Study, times: list[Grid]) -> None:
    """Each output has a window that some run reaches, and that does not go on when all have ended."""
    begin, end = min(t.start for t in times), max(t.stop for t in times)
    last = max(end + NEAR * abs(end), study.stop or end)  # a run ends at the whole step next to its stop
    for output in study.outputs:
        if output.start is not None and output.start > end:
            raise Problem(f"outputs.{output.name}: start: expected at most {end:g} s, got {output.start:g} s")
        if output.stop is None:
            continue
        where = f"outputs.{output.name}: stop"
        if output.stop < begin:
            raise Problem(f"{where}: expected at least {begin:g} s, got {output.stop:g} s")
        if output.stop > last:
            raise Problem(f"{where}: expected at most {last:g} s, where the runs end, got {output.stop:g} s")
