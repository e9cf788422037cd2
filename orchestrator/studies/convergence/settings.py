"""Settings of a convergence study: the ways of coupling that are compared."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase

from orchestrator.base.errors import Problem, suggest
from orchestrator.ssp.coupling import MASTERS, Coupling
from orchestrator.ssp.swap import used_ports
from orchestrator.ssp.system import System


@dataclass(frozen=True)
class Setting:
    """One way of coupling.

    without_rates  without the connections of rate ports: what a textbook master would get
    cases          for masters with adaptive step size: couplings by name, such as one per tolerance; they are
                   compared instead of steps
    """

    label: str
    coupling: Coupling
    without_rates: bool = False
    cases: Mapping[str, Coupling] = field(default_factory=dict)

    @property
    def family(self) -> str:
        """The settings that are drawn in one colour."""
        return "plain" if self.without_rates else "adaptive" if self.cases else self.coupling.master

    def matches(self, pattern: str) -> bool:
        """Is the pattern the name of the master, or does the label match it?"""
        return pattern == self.coupling.master or fnmatchcase(self.label, pattern)


TOLERANCES = (1e-2, 1e-3, 1e-4, 1e-5)
SETTINGS = (
    Setting("jacobi plain", Coupling("jacobi", 0), without_rates=True),
    Setting("gauss-seidel plain", Coupling("gauss-seidel", 0), without_rates=True),
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
        cases={f"{tolerance:.0e}": Coupling("hermite", adaptive=tolerance) for tolerance in TOLERANCES},
    ),
)


def choose(patterns: Iterable[str]) -> tuple[Setting, ...]:
    """The settings that match: names of masters, labels or patterns of labels; all without patterns."""
    requested = tuple(patterns)
    for pattern in requested:
        if not any(setting.matches(pattern) for setting in SETTINGS):
            names = [*MASTERS, *(setting.label for setting in SETTINGS)]
            near = suggest(pattern, names) or f"; there are {', '.join(names)}"
            raise Problem(f"masters {pattern}: no setting of that name{near}")
    return tuple(s for s in SETTINGS if not requested or any(s.matches(pattern) for pattern in requested))


def rate_inputs(system: System) -> tuple[str, ...]:
    """The connected inputs that are derivatives of others: they carry no power, and are optional."""
    return tuple(
        f"{component.name}.{name}"
        for component in system.components.values()
        for name, port in used_ports(system, component).items()
        if port.optional and port.connections and port.declared.causality == "input"
    )


def applicable(settings: Sequence[Setting], rates: Sequence[str]) -> list[Setting]:
    """Leave out plain settings if there are no rate inputs: they would equal those of order 0."""
    return [setting for setting in settings if rates or not setting.without_rates]
