"""The check of one FMU: applies all rules."""

from pathlib import Path

from orchestrator.base.errors import Problem
from orchestrator.base.files import FMUS, require
from orchestrator.check.finding import Finding
from orchestrator.check.probe_process import probe_threads
from orchestrator.check.probes import PROBES
from orchestrator.check.report import ANY, TOOLS, CheckReport
from orchestrator.check.rule import CheckRule
from orchestrator.check.rules import STATIC
from orchestrator.check.subject import Subject, open_subject
from orchestrator.fmi.description import INTERFACES

DEFECT = "check.defect"
RULES: tuple[CheckRule, ...] = (*STATIC, *PROBES)  # in the order in which they are applied
RULES_1 = ("archive.", "xml.syntax", "version.known")  # those that apply to FMI 1.0


def check(path: Path, tool: str = "any", run: bool = True) -> CheckReport:
    """Check one FMU.

    tool   id of the tool that is to import the FMU; any: all findings
    run    also load and run the FMU in child processes
    """
    if tool != ANY and tool not in TOOLS:
        raise Problem(f"--for {tool}: expected {', '.join(TOOLS)} or any")
    if (path := require(path, FMUS)).is_dir():
        raise Problem(f"{path}: expected an .fmu file, got a folder")
    with probe_threads(run) as pool, open_subject(path) as subject:
        rules = RULES if run else STATIC
        if subject.version.startswith("1."):
            rules = tuple(r for r in rules if r.id.startswith(RULES_1))
        running = [pool.submit(_findings, rule, subject) for rule in rules if rule not in STATIC]
        findings = [finding for rule in rules if rule in STATIC for finding in _findings(rule, subject)]
        findings += [finding for future in running for finding in future.result()]
        return CheckReport(path, _title(subject), tuple(findings), tool)


def _findings(rule: CheckRule, subject: Subject) -> list[Finding]:
    """The findings of a rule; an exception in a rule becomes a finding, so that the other rules still run."""
    try:
        return list(rule(subject))
    except Exception as problem:
        text = f"rule {rule.id} could not be applied: {type(problem).__name__}: {problem}"
        return [Finding(DEFECT, "warning", text)]


def _title(subject: Subject) -> str:
    """FMI version, interfaces, number of variables, tool and platforms of the FMU."""
    model = subject.model
    if not model.interfaces:
        return f"FMI {subject.version}" if subject.version.startswith("1.") else "not a readable FMU"
    offered = " and ".join(INTERFACES[k].title() for k in model.interfaces)
    tool = model.attributes.get("generationTool") or "unknown tool"
    platforms = ", ".join(dict.fromkeys(b.platform for b in subject.binaries)) or "no binaries"
    return f"FMI {subject.version}, {offered}, {len(model.variables)} variables, by {tool}; {platforms}"
