"""A table of rules: each rule enters itself with a decorator, so that none is forgotten."""

from __future__ import annotations

from collections.abc import Callable

from orchestrator.check.finding import Check, Rule


class Table(list[Rule]):
    """Rules in the order in which they are applied."""

    def rule(self, name: str, text: str, *threads: str) -> Callable[[Check], Check]:
        """Enter the function below as the rule `name`."""

        def enter(check: Check) -> Check:
            self.append(Rule(name, text, check, threads))
            return check

        return enter
