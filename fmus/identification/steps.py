"""The steps of the pipeline: the paper's procedures, then all parameters together."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from types import ModuleType

from fmus.contract import ModelError
from fmus.identification.finding import Finding
from fmus.identification.joint import again, together
from fmus.identification.known import updated
from fmus.identification.procedures import (
    damping,
    hose_dynamics,
    hose_resistance,
    inertia,
    motor_leakage,
    valve,
)
from fmus.identification.recordings.recording import Recording
from fmus.identification.refinement.names import parameters
from fmus.identification.refinement.result import Refined
from fmus.identification.refinement.solver import INTERRUPTED
from fmus.identification.refinement.starts import Starts
from fmus.parameters import Number

# in the paper's order: section 4 (a) to (e)
PROCEDURES: Mapping[str, ModuleType] = {
    "valve": valve,
    "hose_resistance": hose_resistance,
    "hose_dynamics": hose_dynamics,
    "motor_leakage": motor_leakage,
    "damping": damping,
}
MACHINE, INERTIA = "machine", "inertia"
Tell = Callable[[str], None]


@dataclass
class Steps:
    """What was found so far; each step takes what those before it found."""

    recordings: Sequence[Recording]
    numbers: dict[str, Number]
    tell: Tell
    show: Callable[[Finding], None]
    findings: list[Finding] = field(default_factory=list)
    skipped: dict[str, str] = field(default_factory=dict)
    refined: Refined | None = None
    starts: Starts | None = None

    def procedures(self, given: Collection[str], inertial: bool) -> None:
        """The paper's procedures in its order."""
        for name, procedure in {**PROCEDURES, **({INERTIA: inertia} if inertial else {})}.items():
            if name not in given and not (name == INERTIA and {"damping", MACHINE} & set(given)):
                self.skipped[name] = "no recording"
                continue
            try:
                finding = procedure.identify(self.recordings, self.numbers)
            except ModelError as error:
                self._skip(name, error)
                continue
            self.findings.append(finding)
            self.numbers = updated(self.numbers, finding.estimates)
            self.show(finding)

    def together(self, names: Sequence[str], starts: int) -> bool:
        """The joint refinement, and from other starts; was it done to the end?"""
        own = [r for r in self.recordings if r.procedure == MACHINE]
        try:
            self.refined = together(own, self.numbers, names, self.tell)
        except ModelError as error:
            if not self.findings:
                raise
            self._skip(MACHINE, error)
            return True
        self.numbers = updated(self.numbers, self.refined.estimates(names=parameters()))
        if self.refined.reason == INTERRUPTED:
            return False
        if starts:
            self.starts = again(self.refined, starts, self.tell)
        return self.starts is None or not self.starts.interrupted

    def _skip(self, name: str, error: ModelError) -> None:
        """The others can still be found."""
        self.skipped[name] = str(error)
        self.tell(f"{name}: {error}")
