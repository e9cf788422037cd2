"""`harvester check` and `diagnose`: find what is wrong with an FMU, and what is broken in a machine."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from orchestrator.base.errors import Problem
from orchestrator.base.files import FMUS, find, make_folder, require, write_whole
from orchestrator.base.options import Kind
from orchestrator.cli.options import BUILD, File, Folder, command


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


DIAGNOSIS = BUILD / "faults" / "diagnosis.fmu"
NOT_KNOWN = 3  # exit status of `diagnose`


@command
def diagnose(
    recording: Annotated[Path, Kind("FILE", positional=True)],
    fmu: File = DIAGNOSIS,
    parameters: Annotated[list[Path] | None, Kind("FILE")] = None,
    learn: File | None = None,
    out: Folder = BUILD,
) -> int:
    """Tell what is broken in a machine, from a recording of its pressures, joint angles and commands.

    Writes a report. The exit status is 1 if something is broken, and 3 if nothing was found, but there are
    less than three minutes of readings, or less than half of the parts can be judged. With `learn` it is 1 if
    something is broken even by the values that were learned.

    recording    Columns with the names of the inputs of the FMU, also COMPONENT.NAME or NAME_measured, best
                 at 100 Hz or more (.csv, .parquet, .mat, .mf4, .tdms); a .toml of the same name can describe
                 others.
    fmu          FMU that diagnoses; `harvester build --faults` makes it; else the one in the installed
                 package.
    parameters   Parameter sets (.ssv), such as what was learned of the healthy machine.
    learn        The recording is of the healthy machine, without payload: write what was learned to this
                 file (.ssv).
    out          Folder of diagnosis.html and .json.
    """
    from orchestrator.results.diagnosis import diagnose as diagnosed
    from orchestrator.results.diagnosis import learned, learning, picture

    make = f"harvester build --faults --fmi 2 --out {fmu.parent}"
    if fmu == DIAGNOSIS and not find(fmu, FMUS).exists():
        raise Problem(f"{fmu}: no such file; name one with --fmu FILE, or make it with: {make}")
    fmu = require(fmu, FMUS)
    make_folder(out)
    found = diagnosed(fmu, recording, parameters or ())
    if learn is not None:
        write_whole(learn, learned(found))
        again = diagnosed(fmu, recording, [*(parameters or ()), learn])
        lines = [*again.remarks, *([found.shortness] if found.shortness else [])]
        lines += [
            f"warning: not a healthy machine: {f.text}; look at: {f.repair}; found at {f.since:.2f} s"
            for f in again.broken
        ]
        print(*lines, f"{learn}: {learning(found)}", sep="\n")
        return 1 if again.broken else 0
    report = found.report(picture(found, fmu))
    print(report.text(verdict=False))
    page, numbers = report.write(out / "diagnosis.html")
    print(f"Report: {page}, {numbers}")
    return 1 if found.broken else 0 if found.is_known else NOT_KNOWN
