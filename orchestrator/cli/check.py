"""`harvester check`: find what is wrong with an FMU."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from orchestrator.base.errors import Problem
from orchestrator.base.files import write_whole
from orchestrator.base.options import Kind
from orchestrator.cli.options import command


@command
def check(
    fmu: Annotated[Path | None, Kind("FILE", positional=True)] = None,
    for_: Annotated[str, Kind("TOOL")] = "any",
    json: Annotated[Path | None, Kind("OUT")] = None,
    static: bool = False,
    timeout: Annotated[float, Kind("T", "s")] = 10.0,
    rules: bool = False,
) -> bool:
    """Find what is wrong with an FMU, and which tools that affects.

    The exit status is 1 if there are errors.

    fmu       Any .fmu file; not needed with `rules`.
    for       Judge the findings for this tool: simulink, dymola, openmodelica, amesim, fmpy, fmusim, pyfmi,
              omsimulator, ecos or libcosim; any: by the standard.
    json      Also write the findings to this file (.json); default: none.
    static    Only inspect the file; run no code of the FMU.
    timeout   Time [s], above 0; a call to the FMU that takes longer counts as a hang.
    rules     Print the table of rules and check nothing.
    """
    from orchestrator.check.checking import RULES
    from orchestrator.check.checking import check as run_check
    from orchestrator.check.probe_process import ProbeLimits, use_probe_limits
    from orchestrator.check.report import table

    if rules:
        print(table(RULES))
        return True
    if fmu is None:
        raise Problem("check: expected an FMU or --rules")
    if not timeout > 0:
        raise Problem(f"check: --timeout {timeout:g}: expected a number of seconds above 0")
    with use_probe_limits(ProbeLimits(call_time=timeout, total_time=max(timeout, ProbeLimits.total_time))):
        report = run_check(fmu, for_, run=not static)
    print(report.text())
    if json:
        write_whole(json, report.report().json())
    return not report.failed
