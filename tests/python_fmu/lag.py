"""A user's file for the tests: a first-order lag, as text to be changed."""

from __future__ import annotations

from pathlib import Path

from fmus.export.python.build import build_user

LAG = '''"""A lag."""
from dataclasses import dataclass
from typing import Annotated

from fmus.contract import Quantity
from fmus.export.python import Model

GAIN = 1.0


@dataclass(frozen=True)
class Parameters:
    delay: Annotated[float, Quantity("s", "Time constant", minimum=1e-3, tunable=True)] = 0.1


@dataclass(frozen=True)
class Inputs:
    u: Annotated[float, Quantity("N", "Force", rate="u_rate")]
    u_rate: Annotated[float, Quantity("N/s", "Its derivative")]
    w: Annotated[float, Quantity("1", "Share")]


@dataclass(frozen=True)
class State:
    y: Annotated[float, Quantity("N", "Force behind the lag")]


@dataclass(frozen=True)
class Outputs(State):
    z: Annotated[float, Quantity("N", "Force and share", warn_above=100.0)]


class Lag(Model):
    """A first-order lag"""

    Parameters, Inputs, State, Outputs = Parameters, Inputs, State, Outputs
    start = {"u": 1.0}
    depends = {"z": ["w"]}

    def step(self, x, u, p, t, h):
        return State(y=x.y + h * (GAIN * u.u - x.y) / p.delay)

    def observe(self, x, u, p, t):
        return Outputs(y=x.y, z=x.y + u.w)
'''


def written(folder: Path, *changes: tuple[str, str], name: str = "lag.py") -> Path:
    """The file with some of its text replaced."""
    text = LAG
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / name).write_text(text, encoding="utf-8")
    return folder / name


def built(folder: Path, *changes: tuple[str, str], name: str = "lag.py") -> Path:
    """An FMU of such a file."""
    return build_user(written(folder, *changes, name=name), folder / "out")
