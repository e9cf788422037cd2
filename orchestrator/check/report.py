"""What a check found, for people and for programs, and what each tool makes of it (tools.toml)."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path

from orchestrator.check.finding import SEVERITIES, CheckRule, Finding, Severity


@dataclass(frozen=True)
class Verdict:
    """What one tool makes of one rule: at least `severity`, and why."""

    severity: Severity
    why: str
    thread: str


@dataclass(frozen=True)
class JudgedTool:
    """One tool; `known_by` tells how its verdicts were found."""

    id: str
    name: str
    known_by: str
    verdicts: Mapping[str, Verdict]


ANY = "any"


def _tools() -> Iterator[JudgedTool]:
    for id_, entry in tomllib.loads(Path(__file__).with_name("tools.toml").read_text("utf-8")).items():
        verdicts = {rule: Verdict(*verdict) for rule, verdict in entry["verdicts"].items()}
        yield JudgedTool(id_, entry["name"], entry["known_by"], verdicts)


TOOLS = {tool.id: tool for tool in _tools()}


def seen_in(rule: str) -> tuple[JudgedTool, ...]:
    """The tools that have a verdict on a rule."""
    return tuple(t for t in TOOLS.values() if rule in t.verdicts)


SHOWN = 5  # findings of one rule that are printed one by one
TITLES = {"error": "errors", "warning": "warnings", "note": "notes"}


@dataclass(frozen=True)
class CheckReport:
    """All findings on one FMU; `tool` is the tool asked for, or any."""

    path: Path
    title: str
    everything: tuple[Finding, ...]
    tool: str = ANY

    @cached_property
    def findings(self) -> tuple[Finding, ...]:
        """Those that concern the tool, worst first; with the tool's own verdict on how bad it is."""
        if self.tool == ANY:
            return tuple(sorted(self.everything, key=_rank))
        verdicts = TOOLS[self.tool].verdicts
        concerned = [f for f in self.everything if not f.tools or self.tool in f.tools or f.rule in verdicts]
        return tuple(sorted((_judged(f, self.tool) for f in concerned), key=_rank))

    def count(self, severity: str) -> int:
        return sum(f.severity == severity for f in self.findings)

    @property
    def failed(self) -> bool:
        return self.count("error") > 0

    def text(self) -> str:
        """One line for each finding, grouped by severity."""
        lines = [f"{self.path}: {self.title}"]
        if self.tool != ANY:
            tool = TOOLS[self.tool]
            lines.append(f"for {tool.name}, judged {tool.known_by}")
        for severity in SEVERITIES:
            found = [f for f in self.findings if f.severity == severity]
            lines += ["", TITLES[severity], *self._lines(found)] if found else []
        return "\n".join([*lines, "", self.summary()])

    def summary(self) -> str:
        """The counts in one line."""
        counts = [(self.count(s), s) for s in SEVERITIES]
        text = ", ".join(f"{n} {s}{'' if n == 1 else 's'}" for n, s in counts)
        hidden = len(self.everything) - len(self.findings)
        rest = f"; {hidden} more for other tools" if hidden else ""
        return (text if self.findings else "nothing found") + rest

    def _lines(self, found: list[Finding]) -> Iterator[str]:
        width = max(len(f.rule) for f in found)
        for rule in dict.fromkeys(f.rule for f in found):
            same = [f for f in found if f.rule == rule]
            for f in same[:SHOWN]:
                yield f"  {f.rule:{width}}  {f.text}{self._why(f)}"
            if len(same) > SHOWN:
                yield f"  {rule:{width}}  ... and {len(same) - SHOWN} more of this kind"

    def _why(self, f: Finding) -> str:
        """Which tool makes what of it, and where that was seen."""
        if self.tool != ANY and f.rule in TOOLS[self.tool].verdicts:
            verdict = TOOLS[self.tool].verdicts[f.rule]
            return f" [{TOOLS[self.tool].name}: {verdict.why}{_seen(verdict.thread)}]"
        named = [t.name for t in seen_in(f.rule)] if self.tool == ANY else []
        return f" [{', '.join(named) or 'see'}{_seen(f.thread, ': ' if named else ' ')}]" if f.thread else ""

    def json(self) -> str:
        """Everything, for programs."""
        data = {
            "file": str(self.path),
            "title": self.title,
            "tool": self.tool,
            "counts": {s: self.count(s) for s in SEVERITIES},
            "findings": [asdict(f) for f in self.findings],
        }
        return json.dumps(data, indent=1)


def _seen(thread: str, joint: str = "; ") -> str:
    return f"{joint}{thread}" if thread else ""


def _rank(f: Finding) -> int:
    return SEVERITIES.index(f.severity)


def _judged(f: Finding, tool: str) -> Finding:
    """The finding, at least as bad as the tool takes it."""
    verdict = TOOLS[tool].verdicts.get(f.rule)
    if verdict is None or SEVERITIES.index(verdict.severity) >= _rank(f):
        return f
    return replace(f, severity=verdict.severity)


def table(rules: tuple[CheckRule, ...]) -> str:
    """All rules as a Markdown table."""
    lines = ["| rule | what must hold | tools | seen in |", "|---|---|---|---|"]
    for rule in rules:
        tools = ", ".join(t.name for t in seen_in(rule.id)) or "any"
        lines.append(f"| `{rule.id}` | {rule.text} | {tools} | {' '.join(rule.threads)} |")
    return "\n".join(lines)
