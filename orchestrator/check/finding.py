"""Findings of a check: faults of an FMU, and remarks."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Literal, get_args

from orchestrator.fmi.description import FmuVariable

Severity = Literal["error", "warning", "note"]
MAX_NAME = 60  # characters of a name in a message
SEVERITIES: tuple[Severity, ...] = get_args(Severity)  # worst first


@dataclass(frozen=True)
class Finding:
    """A fault of the FMU, or a remark.

    rule      id of the rule, such as "unit.undefined"; if empty, the rule sets it
    text      file or variable, line, expected and actual value
    thread    issue threads that report the problem, such as "FMPy#511"; the rule sets them
    places    texts of the findings that differ in their places only, if there are several
    """

    rule: str
    severity: Severity
    text: str
    thread: str = ""
    places: tuple[str, ...] = ()


# error: a violation of the standard, or a fault that stops a tool; warning: wrong or poor results, or a fault
# that stops some tools on some machines; note: nothing fails
MAKE: Mapping[str, Callable[[str], Finding]] = {s: partial(Finding, "", s) for s in SEVERITIES}
error, warning, note = MAKE.values()


def join_names(names: Sequence[str], limit: int = 5) -> str:
    """The first names, shortened if they are too long, and the number of the others."""
    first = [n if len(n) <= MAX_NAME else n[: MAX_NAME - 3] + "..." for n in names[:limit]]
    return ", ".join(first) + (f" and {len(names) - limit} more" if len(names) > limit else "")


def join_variables(variables: Sequence[FmuVariable]) -> str:
    """Line of the first variable, and the names of all."""
    return f"modelDescription.xml line {variables[0].line}: {join_names([v.name for v in variables])}"
