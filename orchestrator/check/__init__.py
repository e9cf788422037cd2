"""harvester check: what is wrong with an FMU, and which tool will refuse it.

Functions import what they need when they are called: the child processes of a check import this package, too.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from orchestrator.check.finding import CheckRule, Finding
    from orchestrator.check.report import CheckReport
    from orchestrator.check.subject import Subject

DEFECT = "check.defect"


def all_rules() -> tuple[CheckRule, ...]:
    """All rules, in the order in which they are applied."""
    from orchestrator.check.ls_ref_comparison import EXPERIMENT
    from orchestrator.check.probes import PROBES
    from orchestrator.check.rules import STATIC

    return (*STATIC, *PROBES, EXPERIMENT)


def check(path: Path, tool: str = "any", run: bool = True) -> CheckReport:
    """Check one FMU.

    tool   id of the tool that shall take it; any: all findings
    run    also load and run it, in child processes
    """
    from orchestrator.base.errors import Problem
    from orchestrator.check.report import ANY, TOOLS, CheckReport
    from orchestrator.check.rules import STATIC
    from orchestrator.check.rules.identity import without_repeats
    from orchestrator.check.subject import opened

    if tool != ANY and tool not in TOOLS:
        raise Problem(f"--for {tool}: expected {', '.join(TOOLS)} or any")
    if not path.is_file():
        what = "expected an .fmu file, got a folder" if path.is_dir() else "no such file"
        raise Problem(f"{path}: {what}")
    with opened(path) as subject:
        rules = all_rules() if run else STATIC
        findings = [finding for rule in rules for finding in _applied(rule, subject)]
        return CheckReport(path, _title(subject), without_repeats(findings), tool)


def _applied(rule: CheckRule, subject: Subject) -> Iterator[Finding]:
    """The findings of a rule; one that fails on a strange FMU must not hide those of the others."""
    from orchestrator.check.finding import Finding

    try:
        yield from rule(subject)
    except Exception as problem:
        text = f"rule {rule.id} could not be applied: {type(problem).__name__}: {problem}"
        yield Finding(DEFECT, "warning", text)


def _title(subject: Subject) -> str:
    """What the file is, in a few words."""
    from orchestrator.fmi.raw_description import INTERFACES

    model = subject.model
    if not model.interfaces:
        return "not an FMU that can be read"
    offered = " and ".join(INTERFACES[k].title() for k in model.interfaces)
    maker = model.attributes.get("generationTool") or "unknown tool"
    platforms = ", ".join(dict.fromkeys(b.platform for b in subject.binaries)) or "no binaries"
    return f"FMI {subject.version}, {offered}, {len(model.variables)} variables, by {maker}; {platforms}"
