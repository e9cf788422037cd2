"""Rules of a check, and tables in which a decorator registers them."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

from orchestrator.base.errors import one_line
from orchestrator.check.finding import Finding, join_names

if TYPE_CHECKING:
    from orchestrator.check.subject import Subject

MAX_FINDINGS = 10_000  # of one rule; a report shows five
CLAUSES: dict[str, str] = {"reference.result": "draft of FMI-LS-REF"} | {
    rule: ", ".join(f"FMI {v}: {c}" for v, c in (("2.0.5", old), ("3.0.2", new)) if c)
    for old, new, rules in tomllib.loads(Path(__file__).with_name("clauses.toml").read_text("utf-8"))[
        "clauses"
    ]
    for rule in rules.split()
}
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

    @property
    def clause(self) -> str:
        """The clause of the standard on which errors are based; empty: the rule gives warnings at most."""
        return CLAUSES.get(self.id, "")

    def __call__(self, subject: Subject) -> Iterator[Finding]:
        """All findings, with the id of this rule and, if they have none, its threads."""
        findings = iter(self.check(subject))
        kinds: dict[object, list[Finding]] = {}
        for number, finding in enumerate(islice(findings, MAX_FINDINGS)):
            text, threads = one_line(finding.text), finding.thread or " ".join(self.threads)
            severity = finding.severity if self.clause or finding.severity != "error" else "warning"
            complete = replace(finding, rule=self.id, severity=severity, text=text, thread=threads)
            kind = _kind(text) if PLACE.match(text) else number
            kinds.setdefault((severity, finding.tools, threads, kind), []).append(complete)
        yield from map(_joined, kinds.values())
        if next(findings, None) is not None:
            yield Finding(
                self.id, "note", f"more than {MAX_FINDINGS} findings of this rule; the others are left out"
            )


PLACE = re.compile(r"\S+ line \d+: (?:(?P<name>[^:]+): )?|member (?P<member>'[^']*') ")


def _kind(text: str) -> str:
    """The text without its place, quoted words and numbers."""
    return re.sub(r"""'[^']*'|"[^"]*"|[-+.\w]*\d[-+.\w]*""", "_", PLACE.sub("", text, count=1))


def _joined(findings: Sequence[Finding]) -> Finding:
    """One finding for several that differ in their places only."""
    first, *others = findings
    if not others:
        return first
    names = [m["name"] or m["member"] or m[0].rstrip(" :") for f in others if (m := PLACE.match(f.text))]
    text = f"{first.text} (and {len(others)} more: {join_names(names)})"
    return replace(first, text=text, places=tuple(f.text for f in findings))


class RuleTable(list[CheckRule]):
    """Rules in the order in which they are applied."""

    def rule(self, name: str, text: str, *threads: str) -> Callable[[Check], Check]:
        """Decorator that registers a function as the rule `name`."""

        def register(check: Check) -> Check:
            self.append(CheckRule(name, text, check, threads))
            return check

        return register
