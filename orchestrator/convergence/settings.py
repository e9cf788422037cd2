"""The ways of coupling that are studied, as a table."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase

from orchestrator.errors import Problem, suggest
from orchestrator.settings import MASTERS, Coupling
from orchestrator.system.swap.uses import uses
from orchestrator.system.system import System


@dataclass(frozen=True)
class Setting:
    """One way of coupling.

    bare   without the wires of rate ports: what a master from a textbook would get
    own    for masters that choose their steps: what varies in place of the step, by name, such as a tolerance
    """

    label: str
    coupling: Coupling
    bare: bool = False
    own: Mapping[str, Coupling] = field(default_factory=dict)

    @property
    def family(self) -> str:
        """What is drawn in one colour."""
        return "plain" if self.bare else "own steps" if self.own else self.coupling.master


TOLERANCES = (1e-2, 1e-3, 1e-4, 1e-5)
SETTINGS = (
    Setting("jacobi plain", Coupling("jacobi", 0), bare=True),
    Setting("gauss-seidel plain", Coupling("gauss-seidel", 0), bare=True),
    Setting("jacobi order 0", Coupling("jacobi", 0)),
    Setting("jacobi order 1", Coupling("jacobi", 1)),
    Setting("jacobi order 2", Coupling("jacobi", 2)),
    Setting("gauss-seidel order 0", Coupling("gauss-seidel", 0)),
    Setting("gauss-seidel order 1", Coupling("gauss-seidel", 1)),
    Setting("gauss-seidel order 2", Coupling("gauss-seidel", 2)),
    Setting("hermite 1 pass", Coupling("hermite", passes=1, guard=0)),  # the same as gauss-seidel of order 3
    Setting("hermite 2 passes", Coupling("hermite", passes=2, guard=0)),
    Setting("hermite to tolerance", Coupling("hermite", guard=0)),
    Setting("hermite", Coupling("hermite")),
    Setting("interface-jacobian unguarded", Coupling("interface-jacobian", guard=0)),
    Setting("interface-jacobian", Coupling("interface-jacobian")),
    Setting(
        "hermite adaptive",
        Coupling("hermite"),
        own={f"{tolerance:.0e}": Coupling("hermite", adaptive=tolerance) for tolerance in TOLERANCES},
    ),
)
FINEST = Coupling("hermite", passes=20, tolerance=1e-9)  # where there is no reference


def choose(names: Iterable[str]) -> tuple[Setting, ...]:
    """The settings that are named: by master, by label, or by a pattern of labels; all when none is."""
    wanted = tuple(names)
    for name in wanted:
        if not any(_fits(setting, name) for setting in SETTINGS):
            known = [*MASTERS, *(setting.label for setting in SETTINGS)]
            near = suggest(name, known) or f"; there are {', '.join(known)}"
            raise Problem(f"masters {name}: no setting of that name{near}")
    return tuple(s for s in SETTINGS if not wanted or any(_fits(s, name) for name in wanted))


def _fits(setting: Setting, name: str) -> bool:
    return name == setting.coupling.master or fnmatchcase(setting.label, name)


def rates(system: System) -> tuple[str, ...]:
    """The connected inputs that only tell how another input moves: no power, and the system works without."""
    return tuple(
        f"{component.name}.{name}"
        for component in system.components.values()
        for name, use in uses(system, component).items()
        if use.optional and use.wires and use.declared.causality == "input"
    )


def possible(settings: Sequence[Setting], held: Sequence[str]) -> list[Setting]:
    """Without connections to leave out, a bare setting is that of order 0 and says nothing new."""
    return [setting for setting in settings if held or not setting.bare]
