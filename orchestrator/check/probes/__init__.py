"""Rules that load and run the FMU, each in a child process."""

from __future__ import annotations

from orchestrator.check.finding import Rule

PROBES: tuple[Rule, ...] = ()
