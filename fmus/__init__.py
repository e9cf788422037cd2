"""Models as equations, and their export as FMUs.

    import fmus

    class Parameters(fmus.Group):
        lag: fmus.Scalar = fmus.Quantity("s", "Time constant", value=0.5)

    class Inputs(fmus.Group):
        commanded: fmus.Scalar = fmus.Quantity("1", "Commanded level")

    class State(fmus.Group):
        level: fmus.Scalar = fmus.Quantity("1", "Level")

    lag = fmus.Subsystem(
        name="lag",
        text="First order lag",
        parameters=Parameters,
        states=State,
        inputs=Inputs,
        outputs=State,
        dynamics=lambda x, u, p: State(level=(u.commanded - x.level) / p.lag),
        observe=lambda x, u, p: x,
    )
    fmus.build(lag, "build")                                  # build/lag.fmu

    fmus.build(fmus.PARTS["swing"]["detailed"], "build")      # build/swing_detailed.fmu

`Subsystem`, `Group` and `Quantity` declare a subsystem. `compose` joins several into one. `values` returns
the parameter and start values of a subsystem, `build` writes its FMU. `PARTS` contains the parts of the
harvester, part -> variant -> subsystem, the default variant first. `HARVESTER` is the whole machine as one
subsystem.
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

    __version__: str

_NAMES = {  # by module
    "composition": ("compose",),
    "contract": ("Group", "Member", "Quantity", "Scalar", "Subsystem", "Terminal", "family", "quantities"),
    "export.build": ("build",),
    "machine.one_block": ("HARVESTER",),
    "machine.parts": ("PARTS",),
    "parameters": ("Number", "Values", "values"),
}
_MODULES = {name: module for module, names in _NAMES.items() for name in names}

__all__ = [
    "HARVESTER", "PARTS", "Group", "Member", "Number", "Quantity", "Scalar", "Subsystem", "Terminal",
    "Values", "build", "compose", "family", "quantities", "values",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    """Import on first use, so that `import fmus` alone loads neither equations nor CasADi."""
    if name == "__version__":
        return str(import_module("importlib.metadata").version("harvester-cosim"))
    if name not in _MODULES:
        raise AttributeError(f"module 'fmus' has no attribute {name!r}")
    return getattr(import_module(f"fmus.{_MODULES[name]}"), "FAMILIES" if name == "PARTS" else name)


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
