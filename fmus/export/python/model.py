"""The class that a user writes to make an FMU by hand: what goes in and out, and one step.

    class Lag(Model):
        "First-order lag"
        Inputs, State, Outputs = LagInputs, LagState, LagOutputs

        def step(self, x, u, p, t, h):
            return LagState(y=x.y + (u.u - x.y) * h / 0.1)

        def observe(self, x, u, p, t):
            return LagOutputs(y=x.y)

The groups are frozen dataclasses of `Annotated[float, Quantity(unit, text)]`, as of any subsystem; a default
of a field is its start value. `some` takes them from another group. `examples/my_subsystem` is one to start
from.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, make_dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Annotated, Any, ClassVar

import numpy as np

from fmus.contract import ModelError, quantities


@dataclass(frozen=True)
class Nothing:
    """A group without variables."""


def some(name: str, group: type[Any], *variables: str) -> type[Any]:
    """A group made of some variables of another, such as the outputs of the part that a model stands for."""
    known = quantities(group)
    for variable in variables:
        if variable not in known:
            there = ", ".join(get_close_matches(variable, known)) or ", ".join(known)
            raise ModelError(f"{name}: {group.__name__} has no {variable}, expected one such as {there}")
    return make_dataclass(name, [(v, Annotated[float, known[v]]) for v in variables], frozen=True)


class Model:
    """Base class of models by hand. What changes while they run is in `State`, and nowhere else.

    name         identifier: name of the FMU; by default that of the file
    Parameters, State, Inputs, Outputs   the variables; an output named like a state is that state
    start        start values of inputs (else the defaults of the fields, else 0)
    depends      output -> inputs that change it at the same instant, and of a state those that `initial`
                 makes it from; what is not named depends on all inputs
    files        files beside the user's that it reads: they go into the FMU
    inner_step   longest step [s] that `step` is called with
    """

    name: ClassVar[str] = ""
    Parameters: ClassVar[type[Any]] = Nothing
    State: ClassVar[type[Any]] = Nothing
    Inputs: ClassVar[type[Any]] = Nothing
    Outputs: ClassVar[type[Any]] = Nothing
    start: ClassVar[Mapping[str, float]] = {}
    depends: ClassVar[Mapping[str, Sequence[str]]] = {}
    files: ClassVar[Sequence[str]] = ()
    inner_step: ClassVar[float] = math.inf

    def initial(self, x: Any, u: Any, p: Any) -> Mapping[str, float]:
        """States that are computed at the start, from their start values x, inputs and parameters."""
        return {}

    def step(self, x: Any, u: Any, p: Any, t: float, h: float) -> Any:
        """The state at t + h from that at t; u are the inputs in the middle of the step."""
        return x

    def observe(self, x: Any, u: Any, p: Any, t: float) -> Any:
        """The outputs at t."""
        raise NotImplementedError("observe(x, u, p, t) is missing, expected a method that gives Outputs")

    def require(self, x: Any, u: Any, p: Any) -> Mapping[str, float]:
        """What must hold at the start and after every step: statement -> a number > 0."""
        return {}

    def __setattr__(self, name: str, value: object) -> None:
        if "_sealed" in self.__dict__:
            raise ModelError(
                f"{_caller()}self.{name} = ... keeps a value beside State, where a saved state misses it: "
                "declare it in State and give it back from step()"
            )
        object.__setattr__(self, name, value)

    def __delattr__(self, name: str) -> None:
        raise ModelError(f"{_caller()}del self.{name}: a model does not change while it runs")


def _caller() -> str:
    """File and line of the user's code that called a method of `Model`."""
    frame = sys._getframe(2)
    return f"{Path(frame.f_code.co_filename).name}:{frame.f_lineno}: "


def sealed(model: Model) -> Model:
    """From now on nothing of the model can be assigned, and its arrays cannot be written to."""
    for value in vars(model).values():
        if isinstance(value, np.ndarray):
            value.flags.writeable = False
    object.__setattr__(model, "_sealed", True)
    return model
