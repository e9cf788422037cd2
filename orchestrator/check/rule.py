"""Rules of a check: functions with the names of the rules in rules.toml and probes.toml."""

import re
import tomllib
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from inspect import getdoc
from itertools import islice
from pathlib import Path
from types import ModuleType
from typing import Any

from orchestrator.base.errors import one_line
from orchestrator.check.finding import Finding, Severity, join_names
from orchestrator.check.subject import Subject

MAX_FINDINGS = 10_000  # of one rule; a report shows five
VERSIONS = ("2.0.5", "3.0.2")  # of the standard, whose clauses rules name
Check = Callable[[Subject], Iterable[Finding | str]]


@dataclass(frozen=True)
class CheckRule:
    """A requirement on an FMU, and the function that checks it.

    id        topic and name: "unit.undefined"
    text      the requirement in one line
    check     yields a finding for each violation, or the text of one
    severity  of findings that are texts
    clause    of the standard on which errors are based; empty: the rule gives warnings at most
    threads   issue threads that report violations
    fmi       versions of FMUs to which the rule applies; empty: to any file
    """

    id: str
    text: str
    check: Check
    clause: str = ""
    threads: str = ""
    severity: Severity = "warning"
    fmi: Sequence[int] = ()

    def __call__(self, subject: Subject) -> Iterator[Finding]:
        """All findings, with the id and the threads of this rule."""
        applies = not self.fmi or subject.major in self.fmi
        findings = iter(self.check(subject) if applies else ())
        kinds: dict[object, list[Finding]] = {}
        for number, found in enumerate(islice(findings, MAX_FINDINGS)):
            finding = Finding("", self.severity, found) if isinstance(found, str) else found
            text = one_line(finding.text)
            severity = finding.severity if self.clause or finding.severity != "error" else "warning"
            complete = replace(finding, rule=self.id, severity=severity, text=text, thread=self.threads)
            kind = _kind(text) if PLACE.match(text) else number
            kinds.setdefault((severity, kind), []).append(complete)
        yield from map(_joined, kinds.values())
        if next(findings, None) is not None:
            text = f"more than {MAX_FINDINGS} findings of this rule; the others are left out"
            yield Finding(self.id, "note", text)


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


def rules_in(file: Path, *modules: ModuleType) -> tuple[CheckRule, ...]:
    """The rules of a TOML file, whose functions are in these modules; rules.toml explains the entries."""
    entries = tomllib.loads(file.read_text("utf-8"))
    return tuple(_rule(id_, modules, entry) for id_, entry in entries.items())


def _rule(id_: str, modules: Sequence[ModuleType], entry: dict[str, Any]) -> CheckRule:
    name = entry.pop("check", id_.replace(".", "_"))
    function: Callable[..., Any] = next(getattr(m, name) for m in modules if hasattr(m, name))
    text = entry.pop("text", "") or (getdoc(function) or "").partition("\n")[0].removesuffix(".")
    clauses = zip(VERSIONS, entry.pop("clause", ()), strict=False)
    clause = ", ".join(f"FMI {version}: {c}" for version, c in clauses if c)
    columns = {f.name: entry.pop(f.name) for f in fields(CheckRule) if f.name in entry}
    return CheckRule(id_, text, partial(function, **entry), clause, **columns)
