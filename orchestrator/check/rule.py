"""Findings of a check, its rules, and tables in which a decorator registers them."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Literal, get_args

from orchestrator.base.errors import one_line

if TYPE_CHECKING:
    from orchestrator.check.subject import Subject
    from orchestrator.fmi.raw_description import DeclaredVariable

Severity = Literal["error", "warning", "note"]
MAX_NAME = 60  # characters of a name in a message
SEVERITIES: tuple[Severity, ...] = get_args(Severity)  # worst first


@dataclass(frozen=True)
class Finding:
    """A fault of the FMU, or a remark.

    rule      id of the rule, such as "unit.undefined"; if empty, the rule sets it
    text      file or variable, line, expected and actual value
    tools     ids of the tools that are affected; empty: any tool
    thread    issue threads that report the problem, such as "FMPy#511"; the rule sets them
    places    texts of the findings that differ in their places only, if there are several
    """

    rule: str
    severity: Severity
    text: str
    tools: tuple[str, ...] = ()
    thread: str = ""
    places: tuple[str, ...] = ()


def error(text: str, *tools: str) -> Finding:
    """A finding about a violation of the standard, or a fault that stops a tool."""
    return Finding("", "error", text, tools)


def warning(text: str, *tools: str) -> Finding:
    """A finding about wrong or poor results, or a fault that stops some tools on some machines."""
    return Finding("", "warning", text, tools)


def note(text: str, *tools: str) -> Finding:
    """A finding for information; nothing fails."""
    return Finding("", "note", text, tools)


MAKE = {"error": error, "warning": warning, "note": note}


def join_names(names: Sequence[str], limit: int = 5) -> str:
    """The first names, shortened if they are too long, and the number of the others."""
    first = [n if len(n) <= MAX_NAME else n[: MAX_NAME - 3] + "..." for n in names[:limit]]
    return ", ".join(first) + (f" and {len(names) - limit} more" if len(names) > limit else "")


def join_variables(variables: Sequence[DeclaredVariable]) -> str:
    """Line of the first variable, and the names of all."""
    return f"modelDescription.xml line {variables[0].line}: {join_names([v.name for v in variables])}"


MAX_FINDINGS = 10_000  # of one rule; a report shows five
CLAUSES: dict[str, str] = {"reference.result": "draft of FMI-LS-REF"} | {
    rule: ", ".join(f"FMI {v}: {c}" for v, c in (("2.0.5", old), ("3.0.2", new)) if c)
    for old, new, rules in tomllib.loads(Path(__file__).with_name("clauses.toml").read_text("utf-8"))[
        "clauses"
    ]
    for rule in rules.split()
}
Check = Callable[["Subject"], Iterable[Finding]]


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
        """All findings, with the id and the threads of this rule."""
        findings = iter(self.check(subject))
        kinds: dict[object, list[Finding]] = {}
        for number, finding in enumerate(islice(findings, MAX_FINDINGS)):
            text, threads = one_line(finding.text), " ".join(self.threads)
            severity = finding.severity if self.clause or finding.severity != "error" else "warning"
            complete = replace(finding, rule=self.id, severity=severity, text=text, thread=threads)
            kind = _kind(text) if PLACE.match(text) else number
            kinds.setdefault((severity, finding.tools, kind), []).append(complete)
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
