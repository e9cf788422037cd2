"""The command `harvester check`."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from orchestrator.check import check, rules
from orchestrator.check.report import table
from orchestrator.errors import Problem


def run(
    fmu: Path | None, tool: str, json: Path | None, show_rules: bool, static: bool, timeout: float = 10.0
) -> bool:
    """Check and print, or print the rules; True when nothing stands against the FMU.

    timeout   longest call into the FMU [s]
    """
    from orchestrator.check.probes.parent import Limits, limits

    if show_rules:
        print(table(rules()))
        return True
    if fmu is None:
        raise Problem("check: expected an FMU or --rules")
    if not timeout > 0:
        raise Problem(f"check: --timeout {timeout:g}: expected a number of seconds above 0")
    with _ends_clean(), limits(Limits(call=timeout, probe=max(timeout, Limits.probe))):
        report = check(fmu, tool, run=not static)
    print(report.text())
    if json:
        json.write_text(report.json(), "utf-8")
    return not report.failed


@contextmanager
def _ends_clean() -> Iterator[None]:
    """A request to end, or a closed terminal, is an interrupt: children are stopped, folders removed."""

    def interrupt(*_: Any) -> None:
        raise KeyboardInterrupt

    there = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]
    usual = [number for number in there if signal.getsignal(number) is signal.SIG_DFL]
    for number in usual:
        signal.signal(number, interrupt)
    try:
        yield
    finally:
        for number in usual:
            signal.signal(number, signal.SIG_DFL)
