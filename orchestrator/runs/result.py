"""What a run leaves behind, also when it ends early."""

from __future__ import annotations

from dataclasses import dataclass, field

from orchestrator.errors import Problem
from orchestrator.files.trace import Trace
from orchestrator.runs.card import Card
from orchestrator.settings import Coupling
from orchestrator.slaves.log import Message
from orchestrator.system.system import System


@dataclass(frozen=True)
class Result:
    """What a run leaves behind.

    trace      all outputs, fed inputs and inputs of the system (or the chosen signals) at each recorded point
    card       the accuracy card
    messages   what the FMUs logged
    coupling   all choices about it
    complete   False when the run ended early; the trace then holds what was recorded until there. A run that
               an FMU asked to end is complete, and has a note that says so
    """

    system: System
    trace: Trace
    card: Card
    messages: tuple[Message, ...] = ()
    complete: bool = True
    coupling: Coupling = field(default_factory=Coupling)


class RunFailed(Problem):
    """A run that ended early because of a problem; `result` holds what was recorded."""

    def __init__(self, problem: Problem, result: Result) -> None:
        super().__init__(str(problem))
        self.result = result


class Interrupted(KeyboardInterrupt):
    """A run that the user stopped; `result` holds what was recorded."""

    def __init__(self, result: Result) -> None:
        super().__init__()
        self.result = result
