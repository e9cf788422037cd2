"""What a run was and what it cost, in a file beside its trace: trace.csv has trace.run.json.

A CSV has no room for it, nor for units; `harvester compare` reads both from there.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from orchestrator.errors import Problem
from orchestrator.runs.simulation import Result

SUFFIX = ".run.json"


@dataclass(frozen=True)
class Facts:
    """One run. Times in [s].

    step      communication step, of adaptive runs the mean
    coupling  all choices about it that have an effect, by name
    steps     that were taken and stand; `passes`: over all components, in all of them; `repeated`: steps that
              did not stand; `lengths`: the shortest and the longest step
    fmus      component -> model name of its FMU
    swapped   component -> file of the FMU in its place
    given     what the user asked for beyond the defaults
    wall      of the whole run; `inside`: of the steps of each component
    units     of the signals; `inputs`: which of them are inputs of components
    """

    system: str
    master: str
    step: float
    simulated: float
    wall: float
    complete: bool = True
    fmus: Mapping[str, str] = field(default_factory=dict)
    swapped: Mapping[str, str] = field(default_factory=dict)
    given: Mapping[str, Any] = field(default_factory=dict)
    inside: Mapping[str, float] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    inputs: tuple[str, ...] = ()
    coupling: Mapping[str, Any] = field(default_factory=dict)
    steps: int = 0
    passes: int = 0
    repeated: int = 0
    lengths: tuple[float, float] = (0.0, 0.0)

    @property
    def adaptive(self) -> bool:
        """Did the run choose its steps?"""
        return "adaptive" in self.coupling


def facts(result: Result, given: Mapping[str, Any] | None = None) -> Facts:
    """What there is to tell about a run."""
    system, card = result.system, result.card
    return Facts(
        system=str(system.source.path if system.source else system.name),
        master=card.master,
        step=card.step,
        simulated=card.simulated,
        wall=card.wall,
        complete=result.complete,
        fmus={c.name: c.interface.identifier for c in system.components.values()},
        swapped={c.name: str(c.source) for c in system.components.values() if c.replaced},
        given={name: value for name, value in (given or {}).items() if value},
        inside=card.inside,
        units=result.trace.units,
        inputs=tuple(str(p) for p in system.ports("input") if str(p) in result.trace.signals),
        coupling=result.coupling.settings,
        steps=card.steps,
        passes=card.passes,
        repeated=card.repeated,
        lengths=card.lengths,
    )


def beside(trace: Path) -> Path:
    """The file that belongs to a trace."""
    return trace.with_suffix(SUFFIX)


def write_facts(result: Result, trace: Path, given: Mapping[str, Any] | None = None) -> Path:
    """Write the facts of a run beside its trace, which is there already."""
    text = json.dumps(
        {"sha256": _digest(trace)} | asdict(facts(result, given)), indent=1, ensure_ascii=False, default=str
    )
    beside(trace).write_text(text + "\n", encoding="utf-8", newline="\n")
    return beside(trace)


def _digest(trace: Path) -> str:
    """By this the facts belong to their trace, also when both have got another name."""
    return hashlib.sha256(trace.read_bytes()).hexdigest()


def read_facts(path: Path) -> Facts | None:
    """The facts of the run that made a trace; None where there are none or they are of another trace."""
    file = beside(path)
    if not file.is_file():
        return None
    try:
        data = json.loads(file.read_text(encoding="utf-8"))
        digest = data.pop("sha256")
        found = Facts(**{**data, "inputs": tuple(data["inputs"])})
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise Problem(f"{file}: expected what harvester run writes beside a trace, got {error!r}") from None
    return found if digest == _digest(path) else None
