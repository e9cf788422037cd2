"""Small subsystems from units and functions, for tests of what is done with any subsystem."""

from dataclasses import make_dataclass
from pathlib import Path
from typing import Annotated, Any

from fmus.contract import Quantity, Subsystem


def group(name: str, **quantities: Quantity | str) -> type[Any]:
    """A frozen dataclass of scalars with these quantities, or with these units."""
    each = {n: Quantity(q, "of a toy") if isinstance(q, str) else q for n, q in quantities.items()}
    return make_dataclass(name, [(n, Annotated[Any, q]) for n, q in each.items()], frozen=True)


def toy(
    name: str, p: dict[str, Any], x: dict[str, Any], u: dict[str, Any], y: dict[str, Any], f, g, **more: Any
):
    """A subsystem: groups of quantities, dynamics f and observe g that return dictionaries."""
    P, X, U, Y = (group(f"{name}_{k}", **q) for k, q in (("p", p), ("x", x), ("u", u), ("y", y)))
    return Subsystem(
        name=name,
        text=f"Toy {name}",
        parameters=P,
        states=X,
        inputs=U,
        outputs=Y,
        dynamics=lambda x, u, p: X(**f(x, u, p)),
        observe=lambda x, u, p: Y(**g(x, u, p)),
        values=Path(__file__).parent / "none" / "parameters.toml",
        **more,
    )
