"""What a check finds in an FMU, what a rule is, and tables that rules enter by a decorator."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal, get_args

if TYPE_CHECKING:
    from orchestrator.check.subject import Subject
    from orchestrator.fmi.raw_description import DeclaredVariable

Severity = Literal["error", "warning", "note"]
LONGEST = 60  # characters of a name that are shown
SEVERITIES: tuple[Severity, ...] = get_args(Severity)  # worst first


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong, or worth knowing.

    rule      id of the rule, such as "unit.undefined"; left empty, the rule fills it in
    text      file or variable, line, what was expected and what was found
    tools     ids of the tools that refuse or warn; empty: any tool
    thread    where this was seen, such as "FMPy#511"; left empty, the rule fills it in
    """

    rule: str
    severity: Severity
    text: str
    tools: tuple[str, ...] = ()
    thread: str = ""


def error(text: str, *tools: str, thread: str = "") -> Finding:
    """A finding that breaks the standard or stops a tool."""
    return Finding("", "error", text, tools, thread)


def warning(text: str, *tools: str, thread: str = "") -> Finding:
    """A finding that gives wrong or poor results, or stops some tools on some machines."""
    return Finding("", "warning", text, tools, thread)


def note(text: str, *tools: str, thread: str = "") -> Finding:
    """A finding worth knowing; nothing fails."""
    return Finding("", "note", text, tools, thread)


MAKE = {"error": error, "warning": warning, "note": note}


def some(names: Sequence[str], shown: int = 5) -> str:
    """The first names, cut where they are endless, and how many more there are."""
    cut = [n if len(n) <= LONGEST else n[: LONGEST - 3] + "..." for n in names[:shown]]
    return ", ".join(cut) + (f" and {len(names) - shown} more" if len(names) > shown else "")


def listed(variables: Sequence[DeclaredVariable]) -> str:
    """Line of the first variable, and the names of all."""
    return f"modelDescription.xml line {variables[0].line}: {some([v.name for v in variables])}"


Check = Callable[["Subject"], Iterable[Finding]]


@dataclass(frozen=True)
class CheckRule:
    """One thing to check.

    id        topic and word: "unit.undefined"
    text      one line: what must hold
    check     yields what does not hold
    threads   where it was seen
    """

    id: str
    text: str
    check: Check
    threads: tuple[str, ...] = ()

    def __call__(self, subject: Subject) -> Iterator[Finding]:
        """All findings, with the id of this rule and, where they name none, its threads."""
        for found in self.check(subject):
            yield replace(found, rule=self.id, thread=found.thread or " ".join(self.threads))


class RuleTable(list[CheckRule]):
    """Rules in the order in which they are applied."""

    def rule(self, name: str, text: str, *threads: str) -> Callable[[Check], Check]:
        """Enter the function below as the rule `name`."""

        def enter(check: Check) -> Check:
            self.append(CheckRule(name, text, check, threads))
            return check

        return enter
