"""The command `harvester check`."""

from __future__ import annotations

from pathlib import Path

from orchestrator.base.errors import Problem
from orchestrator.check import all_rules, check
from orchestrator.check.report import table


def run(
    fmu: Path | None, tool: str, json: Path | None, show_rules: bool, static: bool, timeout: float = 10.0
) -> bool:
    """Check and print, or print the rules; True when nothing stands against the FMU.

    timeout   longest call into the FMU [s]
    """
    from orchestrator.check.probes.parent import Limits, limits

    if show_rules:
        print(table(all_rules()))
        return True
    if fmu is None:
        raise Problem("check: expected an FMU or --rules")
    if not timeout > 0:
        raise Problem(f"check: --timeout {timeout:g}: expected a number of seconds above 0")
    with limits(Limits(call=timeout, probe=max(timeout, Limits.probe))):
        report = check(fmu, tool, run=not static)
    print(report.text())
    if json:
        json.write_text(report.json(), "utf-8")
    return not report.failed
