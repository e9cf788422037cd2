"""Models as equations, and how they become FMUs.

    import fmus

    class Parameters(fmus.Group):
        lag: fmus.Scalar = fmus.Quantity("s", "Time constant", value=0.5)

    class Inputs(fmus.Group):
        wanted: fmus.Scalar = fmus.Quantity("1", "What is asked for")

    class State(fmus.Group):
        level: fmus.Scalar = fmus.Quantity("1", "What there is")

    lag = fmus.Subsystem(
        name="lag",
        text="First order lag",
        parameters=Parameters,
        states=State,
        inputs=Inputs,
        outputs=State,
        dynamics=lambda x, u, p: State(level=(u.wanted - x.level) / p.lag),
        observe=lambda x, u, p: x,
    )
    fmus.build(lag, "build")                                  # build/lag.fmu

    fmus.build(fmus.PARTS["swing"]["detailed"], "build")      # build/swing_detailed.fmu

A subsystem is declared by `Subsystem`, `Group` and `Quantity`; `compose` makes one of several; `values` are
the numbers of one, `build` writes its FMU. `PARTS` are the parts of the harvester, part -> variant ->
subsystem, the usual variant first; `HARVESTER` is the whole machine as one.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fmus.composition import compose
    from fmus.contract import Group, Member, Quantity, Scalar, Subsystem, Terminal, family, quantities
    from fmus.export.build import build
    from fmus.machine.one_block import HARVESTER
    from fmus.machine.parts import FAMILIES as PARTS
    from fmus.parameters import Number, Values, values

_WHERE = {
    "Group": "contract",
    "HARVESTER": "machine.one_block",
    "Member": "contract",
    "Number": "parameters",
    "PARTS": "machine.parts",
    "Quantity": "contract",
    "Scalar": "contract",
    "Subsystem": "contract",
    "Terminal": "contract",
    "Values": "parameters",
    "build": "export.build",
    "compose": "composition",
    "family": "contract",
    "quantities": "contract",
    "values": "parameters",
}

__all__ = [
    "HARVESTER", "PARTS", "Group", "Member", "Number", "Quantity", "Scalar", "Subsystem", "Terminal",
    "Values", "build", "compose", "family", "quantities", "values",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    """Import on first use: `import fmus` alone loads no equation and no CasADi."""
    if name not in _WHERE:
        raise AttributeError(f"module 'fmus' has no attribute {name!r}")
    return getattr(import_module(f"fmus.{_WHERE[name]}"), "FAMILIES" if name == "PARTS" else name)


def __dir__() -> list[str]:
    return __all__
