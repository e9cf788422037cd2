"""Cranes of the examples, each made once in a process, and the file of the loader with other texts."""

from functools import cache
from pathlib import Path

import numpy as np

from fmus.crane.axes import AxisCheck, Capacity
from fmus.crane.check import check
from fmus.crane.check import table as text_of
from fmus.crane.description import CraneDescription, read
from fmus.crane.machine import crane_machine
from fmus.machine.machine import Machine, wiring
from fmus.monolith import join
from kit.equations import played
from orchestrator import run

CRANES = Path(__file__).parents[2] / "examples" / "cranes"
EXAMPLES = sorted(path.stem for path in CRANES.glob("*.toml"))


@cache
def crane(name: str = "loader") -> CraneDescription:
    """An example."""
    return read(CRANES / f"{name}.toml")


@cache
def checked(name: str = "loader") -> list[AxisCheck]:
    """Its axes."""
    return check(crane(name))


@cache
def machine(name: str = "loader", faults: bool = False) -> Machine:
    """Its machine."""
    return crane_machine(crane(name), faults)


def changed(folder: Path, *changes: tuple[str, str]) -> Path:
    """The file of the loader with other texts."""
    text = (CRANES / "loader.toml").read_text(encoding="utf-8")
    for old, by in changes:
        assert old in text
        text = text.replace(old, by)
    path = folder / "crane.toml"
    path.write_text(text, encoding="utf-8")
    return path


def solved(folder: Path, name: str, stop: float, **swap: str) -> dict[str, np.ndarray]:
    """Time and outputs of the monolith, with the commands of the operator that was built in a folder."""
    own = machine(name)
    chosen = own.subsystems | own.feeding | own.chosen(**swap)
    model = join(chosen, *wiring(chosen))
    commands = run(folder / f"{name}.ssp", stop=stop, record="operator_input.*")
    given = {n: commands[f"operator_input.{n}"] for n in model.inputs if f"operator_input.{n}" in commands}
    return played(model, np.asarray(commands.time), given)


def told_of(crane: CraneDescription) -> str:
    """The text of the check, with loads of a single pose: warnings and assumptions do not depend on them."""
    nothing = Capacity(np.zeros((1, 2)), lambda poses: np.zeros((3, *poses.shape[1:])))
    return text_of(crane, check(crane), nothing, {})
