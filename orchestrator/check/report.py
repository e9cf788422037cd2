"""Report of a check as text and as JSON, with the verdicts of each tool on the rules (tools.toml)."""

import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

from orchestrator.check.finding import SEVERITIES, Finding, Severity
from orchestrator.check.rule import CheckRule
from orchestrator.results.report import Report, Text


@dataclass(frozen=True)
class Verdict:
    """Consequence of a finding in one tool: at least `severity`, with a reason and issue threads."""

    severity: Severity
    reason: str
    thread: str


@dataclass(frozen=True)
class JudgedTool:
    """One tool and its verdicts by rule; `basis` is the evidence for them."""

    name: str
    basis: str
    verdicts: Mapping[str, Verdict]


ANY = "any"


TOOLS = {
    id_: JudgedTool(e["name"], e["basis"], {rule: Verdict(*v) for rule, v in e["verdicts"].items()})
    for id_, e in tomllib.loads(Path(__file__).with_name("tools.toml").read_text("utf-8")).items()
}


def affected_tools(rule: str) -> tuple[JudgedTool, ...]:
    """The tools that have a verdict on a rule."""
    return tuple(t for t in TOOLS.values() if rule in t.verdicts)


MAX_PRINTED = 5  # findings of one rule in the text report


@dataclass(frozen=True)
class CheckReport:
    """All findings on one FMU, and the tool that is to import the FMU, or any."""

    path: Path
    title: str
    all_findings: tuple[Finding, ...]
    tool: str = ANY

    @cached_property
    def findings(self) -> tuple[Finding, ...]:
        """The findings, worst first, with the severity that they have for the tool."""
        if self.tool == ANY:
            return tuple(sorted(self.all_findings, key=_rank))
        return tuple(sorted((_for_tool(f, self.tool) for f in self.all_findings), key=_rank))

    def count(self, severity: str) -> int:
        """Number of rules with findings of this severity."""
        return len({f.rule for f in self.findings if f.severity == severity})

    @property
    def failed(self) -> bool:
        return self.count("error") > 0

    def report(self) -> Report:
        """One line for each finding, grouped by severity; the counts are those of rules."""
        lines = [f"{self.path}: {self.title}"]
        lines += [f"for {TOOLS[self.tool].name}, judged {TOOLS[self.tool].basis}"] if self.tool != ANY else []
        groups = {s: [f for f in self.findings if f.severity == s] for s in SEVERITIES}
        parts = [Text([f"{s}s", *self._lines(found)]) for s, found in groups.items() if found]
        data = {
            "file": self.path,
            "tool": self.tool,
            "counts": {s: self.count(s) for s in SEVERITIES},
            "findings": self.findings,
        }
        return Report(self.title, self.summary(), [Text(lines), *parts], data, not self.failed)

    def text(self) -> str:
        """For a terminal."""
        return self.report().text()

    def summary(self) -> str:
        """The counts in one line."""
        counts = [(self.count(s), s) for s in SEVERITIES]
        text = ", ".join(f"{n} {s}{'' if n == 1 else 's'}" for n, s in counts)
        return text if self.findings else "nothing found"

    def _lines(self, findings: list[Finding]) -> Iterator[str]:
        width = max(len(f.rule) for f in findings)
        for rule in dict.fromkeys(f.rule for f in findings):
            same_rule = [f for f in findings if f.rule == rule]
            for f in same_rule[:MAX_PRINTED]:
                yield f"  {f.rule:{width}}  {f.text}{self._evidence(f)}"
            if len(same_rule) > MAX_PRINTED:
                yield f"  {rule:{width}}  ... and {len(same_rule) - MAX_PRINTED} more of this rule"

    def _evidence(self, f: Finding) -> str:
        """The consequence in the tool, or the affected tools; and issue threads."""
        if self.tool != ANY and f.rule in TOOLS[self.tool].verdicts:
            verdict = TOOLS[self.tool].verdicts[f.rule]
            threads = f"; {verdict.thread}" if verdict.thread else ""
            return f" [{TOOLS[self.tool].name}: {verdict.reason}{threads}]"
        tools = [t.name for t in affected_tools(f.rule)] if self.tool == ANY else []
        label = f"{', '.join(tools)}:" if tools else "see"
        return f" [{label} {f.thread}]" if f.thread else ""


def _rank(f: Finding) -> int:
    return SEVERITIES.index(f.severity)


def _for_tool(f: Finding, tool: str) -> Finding:
    """The finding with at least the severity that it has for the tool."""
    verdict = TOOLS[tool].verdicts.get(f.rule)
    if verdict is None or SEVERITIES.index(verdict.severity) >= _rank(f):
        return f
    return replace(f, severity=verdict.severity)


def table(rules: tuple[CheckRule, ...]) -> str:
    """All rules as a Markdown table."""
    lines = [
        "| rule | requirement | clause if it gives errors | tools | issue threads |",
        "|---|---|---|---|---|",
    ]
    for rule in rules:
        tools = ", ".join(t.name for t in affected_tools(rule.id)) or "any"
        lines.append(f"| `{rule.id}` | {rule.text} | {rule.clause} | {tools} | {rule.threads} |")
    return "\n".join(lines)
