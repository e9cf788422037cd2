"""Rules of a check, and tables in which a decorator registers them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import islice
from typing import TYPE_CHECKING

from orchestrator.base.errors import one_line
from orchestrator.check.finding import Finding

if TYPE_CHECKING:
    from orchestrator.check.subject import Subject

MAX_FINDINGS = 10_000  # of one rule; a report shows five
Check = Callable[["Subject"], Iterable["Finding"]]


@dataclass(frozen=True)
class CheckRule:
    """A requirement on an FMU, and the function that checks it.

    id        topic and name: "unit.undefined"
    text      the requirement in one line
    check     yields a finding for each violation
    threads   issue threads that report violations
    """

    id: str
    text: str
    check: Check
    threads: tuple[str, ...] = ()

    def __call__(self, subject: Subject) -> Iterator[Finding]:
        """All findings, with the id of this rule and, if they have none, its threads."""
        findings = iter(self.check(subject))
        for finding in islice(findings, MAX_FINDINGS):
            text = one_line(finding.text)
            yield replace(finding, rule=self.id, text=text, thread=finding.thread or " ".join(self.threads))
        if next(findings, None) is not None:
            yield Finding(
                self.id, "note", f"more than {MAX_FINDINGS} findings of this rule; the others are left out"
            )


class RuleTable(list[CheckRule]):
    """Rules in the order in which they are applied."""

    def rule(self, name: str, text: str, *threads: str) -> Callable[[Check], Check]:
        """Decorator that registers a function as the rule `name`."""

        def register(check: Check) -> Check:
            self.append(CheckRule(name, text, check, threads))
            return check

        return register
