"""What an FMU declares about itself: variables, dependencies, abilities."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from orchestrator.errors import Unsupported
from orchestrator.units import Unit

Value = float | int | bool | str

FLOATS = ("Real", "Float64", "Float32")
INTEGERS = ("Integer", "Int8", "UInt8", "Int16", "UInt16", "Int32", "UInt32", "Int64", "UInt64")
KINDS = {
    **dict.fromkeys(FLOATS, "Real"),
    **dict.fromkeys(INTEGERS, "Integer"),
    **{kind: kind for kind in ("Boolean", "String", "Enumeration")},
}
SHOWN = 5  # names in a list


@dataclass(frozen=True)
class Variable:
    """One scalar variable.

    kind      Real, Integer, Boolean, String or Enumeration
    word      what FMI 3.0 calls its type in functions: Float64, Int32, ...; empty in FMI 2.0
    nominal   its usual magnitude, where the FMU tells one
    text      its description
    minimum, maximum   of its values, in its unit, as the FMU declares them
    """

    name: str
    kind: str = "Real"
    causality: str = "local"
    variability: str = "continuous"
    initial: str | None = None
    reference: int = 0
    unit: Unit | None = None
    start: str | None = None
    items: Mapping[str, int] = field(default_factory=dict)
    nominal: float | None = None
    text: str = ""
    word: str = ""
    minimum: float | None = None
    maximum: float | None = None

    @property
    def is_real(self) -> bool:
        return self.kind == "Real"

    @property
    def is_continuous(self) -> bool:
        """May it change inside a step? Real variables that are discrete or tunable do not."""
        return self.is_real and self.variability == "continuous"

    @property
    def settable(self) -> bool:
        """True when a start value may be given before initialisation."""
        return self.variability != "constant" and (
            self.causality in ("input", "parameter") or self.initial in ("exact", "approx")
        )


@dataclass(frozen=True)
class Interface:
    """The declared outside of one FMU.

    feedthrough   output -> inputs it depends on directly; None when the FMU does not say
    initially     output -> variables it depends on in initialisation mode; None when the FMU does not say
    fmi           2 or 3
    refused       variables that cannot be used here -> what they are
    interpolates  the FMU accepts derivatives of its inputs by a function, which FMI 3.0 lacks
    rates         input -> the input that the FMU declares as its time derivative
    slopes        highest order of output derivatives it offers
    rollback      the FMU can save and restore its state
    serializes    it can turn a saved state into bytes
    only_one      only one instance of it may exist in a process
    needs_tool    it runs only where the tool that made it is installed
    indicators    number of its event indicators, in model exchange
    varies        it takes steps of any length; else all have to be of the same
    stateless     it declares, for model exchange, that it has no continuous states
    inert         inputs that, as it declares, neither a state nor an output depends on after the start
    directional   it offers directional derivatives
    states        continuous state -> its time derivative; empty where the FMU does not list all of them
    knowns        output or time derivative of a state -> inputs and states it depends on; None: not declared
    start, step, stop, tolerance   of the experiment that the FMU suggests
    version, tool, text   of the FMU: its version, what made it, its description
    """

    variables: Mapping[str, Variable]
    feedthrough: Mapping[str, frozenset[str] | None] = field(default_factory=dict)
    initially: Mapping[str, frozenset[str] | None] = field(default_factory=dict)
    identifier: str = ""
    guid: str = ""
    fmi: int = 2
    refused: Mapping[str, str] = field(default_factory=dict)
    interpolates: bool = False
    rates: Mapping[str, str] = field(default_factory=dict)
    slopes: int = 0
    rollback: bool = False
    serializes: bool = False
    only_one: bool = False
    needs_tool: bool = False
    indicators: int = 0
    varies: bool = True
    stateless: bool = False
    inert: frozenset[str] = frozenset()
    directional: bool = False
    states: Mapping[str, str] = field(default_factory=dict)
    knowns: Mapping[str, frozenset[str] | None] = field(default_factory=dict)
    categories: tuple[str, ...] = ()
    start: float | None = None
    step: float | None = None
    stop: float | None = None
    tolerance: float | None = None
    version: str = ""
    tool: str = ""
    text: str = ""

    def of(self, causality: str) -> list[Variable]:
        """All variables of one causality, in declaration order."""
        return [v for v in self.variables.values() if v.causality == causality]

    def depends(self, output: str) -> frozenset[str]:
        """Inputs that feed directly through to `output`; all of them when the FMU does not say."""
        known = self.feedthrough.get(output)
        return frozenset(v.name for v in self.of("input")) if known is None else known

    def depends_initially(self, output: str) -> frozenset[str]:
        """Variables that decide `output` in initialisation mode."""
        known = self.initially.get(output)
        if known is None:
            return frozenset(v.name for v in self.variables.values() if v.settable)
        return known

    def matters(self, variable: str, outputs: Iterable[str]) -> bool:
        """False for an input that none of these outputs depends on: not directly, and there is no state."""
        return not self.stateless or any(variable in self.depends(y) for y in outputs)

    @property
    def sloped(self) -> frozenset[str]:
        """Inputs that a master may move inside a step at a constant slope."""
        if self.interpolates:
            return frozenset(v.name for v in self.of("input") if v.is_real)
        return frozenset(u for u, rate in self.rates.items() if rate not in self.rates)

    def allow(self, variable: str, where: str) -> None:
        """Refuse, beginning with `where`, a variable of a kind that is not supported."""
        if variable in self.refused:
            kind = self.refused[variable]
            raise Unsupported(f"{where}: expected a scalar number or text, got {kind}, not supported")

    @property
    def left_out(self) -> str:
        """The refused variables as text; empty when there are none."""
        told = [f"{name}, {what}" for name, what in self.refused.items()]
        more = f"; and {len(told) - SHOWN} more" if len(told) > SHOWN else ""
        return f"left out: {'; '.join(told[:SHOWN])}{more}" if told else ""
