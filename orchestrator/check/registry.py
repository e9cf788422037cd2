"""The table of rules: each rule enters itself with the decorator `rule`."""

from __future__ import annotations

from collections.abc import Callable

from orchestrator.check.finding import Check, Rule


def rule(table: list[Rule], name: str, text: str, *threads: str) -> Callable[[Check], Check]:
    """Enter a function into `table` as the rule `name`."""

    def enter(check: Check) -> Check:
        table.append(Rule(name, text, check, threads))
        return check

    return enter
