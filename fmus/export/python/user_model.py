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

A user's `Model` as the rest of the back end sees it: its variables, and its behaviour.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, dataclass, fields, is_dataclass, make_dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Annotated, Any, ClassVar

import casadi as ca
import numpy as np

from fmus.contract import Quantity, Symbolic, quantities
from fmus.export.interface import Interface, Variable, assembled
from fmus.export.python.behaviour import sizes
from fmus.solver import Array, Motion
from orchestrator.base.errors import Problem


@dataclass(frozen=True)
class Nothing:
    """A group without variables."""


def some(name: str, group: type[Any], *variables: str) -> type[Any]:
    """A group made of some variables of another, such as the outputs of the part that a model stands for."""
    known = quantities(group)
    for variable in variables:
        if variable not in known:
            there = ", ".join(get_close_matches(variable, known)) or ", ".join(known)
            raise Problem(f"{name}: {group.__name__} has no {variable}, expected one such as {there}")
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
            raise Problem(
                f"{_caller()}self.{name} = ... keeps a value beside State, where a saved state misses it: "
                "declare it in State and give it back from step()"
            )
        object.__setattr__(self, name, value)

    def __delattr__(self, name: str) -> None:
        raise Problem(f"{_caller()}del self.{name}: a model does not change while it runs")


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


GROUPS = ("Parameters", "Inputs", "State", "Outputs")


def face(model: Model) -> Interface:
    """The variables with their start values; refuses what cannot be in an FMU."""
    p, u, x, y = (_declared(model, name) for name in GROUPS)
    unknown = set(model.start) - set(u)
    if unknown:
        raise Problem(f"{model.name}: start names {min(unknown)}, expected inputs")
    start = {name: _defaults(getattr(model, name)) for name in GROUPS}
    first = _group(model.State, [start["State"].get(n, 0.0) for n in x])
    computed = model.initial(
        first,
        _group(model.Inputs, [model.start.get(n, start["Inputs"].get(n, 0.0)) for n in u]),
        _group(model.Parameters, [start["Parameters"].get(n, 0.0) for n in p]),
    )
    calculated = _names(model, "initial", computed, x)
    return assembled(
        model.name,
        (type(model).__doc__ or model.name).strip().partition("\n")[0].rstrip("."),
        [
            [
                Variable(n, "TUNABLE" if q.tunable else "FIXED", q, start["Parameters"].get(n, 0.0))
                for n, q in p.items()
            ],
            [
                Variable(n, "INPUT", q, float(model.start.get(n, start["Inputs"].get(n, 0.0))))
                for n, q in u.items()
            ],
            [
                Variable(n, "CALCULATED_STATE", q, None, output=n in y)
                if n in calculated
                else Variable(n, "STATE", q, start["State"].get(n, 0.0), output=n in y)
                for n, q in x.items()
            ],
            [],
            [Variable(n, "OUTPUT", q, None, output=True) for n, q in y.items() if n not in x],
        ],
        _NO_EQUATIONS,
        ca.SX(0, 1),
    )


_NONE = ca.SX(0, 1)
_NO_EQUATIONS = Symbolic(_NONE, _NONE, _NONE, _NONE, _NONE, _NONE, (), _NONE, (), ca.SX(math.inf))


def _declared(model: Model, name: str) -> Mapping[str, Quantity]:
    group = getattr(model, name)
    if not (isinstance(group, type) and is_dataclass(group)):
        raise Problem(f"{model.name}: {name} is {group!r}, expected a dataclass")
    try:
        return quantities(group)
    except (AttributeError, NameError) as problem:
        raise Problem(
            f'{model.name}: a field of {name} is not declared as Annotated[float, Quantity("unit", "text")] '
            f"({problem})"
        ) from None


def _defaults(group: type[Any]) -> dict[str, float]:
    return {f.name: float(f.default) for f in fields(group) if f.default is not MISSING}


def _group(group: type[Any], values: Sequence[float]) -> Any:
    return group(**{f.name: value for f, value in zip(fields(group), values, strict=True)})


def _names(model: Model, method: str, found: object, allowed: Mapping[str, Quantity]) -> set[str]:
    if not isinstance(found, Mapping):
        raise Problem(f"{model.name}: {method}() gave {type(found).__name__}, expected a dictionary")
    unknown = set(found) - set(allowed)
    if unknown:
        raise Problem(f"{model.name}: {method}() gave {min(unknown)}, expected names of states")
    return set(found)


class Stepwise:
    """See `behaviour.Behaviour`."""

    def __init__(self, model: Model, face: Interface) -> None:
        self.model, self.face, self.variables, self.sizes = model, face, face.variables, sizes(face)
        self._outputs = [f.name for f in fields(model.Outputs)]
        states = [v.name for v in face.states]
        self._own = [i for i, n in enumerate(self._outputs) if n not in states]
        self._merged = [(i, states.index(n)) for i, n in enumerate(self._outputs) if n in states]
        start = [np.array([v.start or 0.0 for v in g]) for g in (face.states, face.inputs, face.parameters)]
        self.statements = tuple(self._require(self.start(*start), start[1], start[2]))

    def _groups(self, x: Array, u: Array, p: Array) -> tuple[Any, Any, Any]:
        m = self.model
        return (
            _group(m.State, x.tolist()),
            _group(m.Inputs, u.tolist()),
            _group(m.Parameters, p.tolist()),
        )

    def start(self, x: Array, u: Array, p: Array) -> Array:
        """See `Behaviour`."""
        computed = self.model.initial(*self._groups(x, u, p))
        allowed = {v.name: v.quantity for v in self.face.states if v.kind == "CALCULATED_STATE"}
        if _names(self.model, "initial", computed, allowed) != set(allowed):
            raise Problem(f"{self.model.name}: initial() gave other states than at the build")
        found = [computed.get(v.name, x[i]) for i, v in enumerate(self.face.states)]
        return np.array(
            [self._number("initial", v.name, n) for v, n in zip(self.face.states, found, strict=True)]
        )

    def rate(self, x: Array, u: Array, p: Array) -> Array:
        """There are no derivatives."""
        return np.zeros(0)

    def observe(self, x: Array, u: Array, p: Array, t: float) -> tuple[Array, Array]:
        """See `Behaviour`."""
        y = self._values("observe", self.model.observe(*self._groups(x, u, p), t), self.model.Outputs)
        for i, state in self._merged:
            if y[i] != x[state] and not (math.isnan(y[i]) and math.isnan(x[state])):
                raise Problem(
                    f"{self.model.name}: observe() gave {self._outputs[i]} = {y[i]:.9g}, which as a state is "
                    f"{x[state]:.9g}"
                )
        require = self._require(x, u, p)
        return y[self._own], np.array([require[statement] for statement in self.statements])

    def _require(self, x: Array, u: Array, p: Array) -> dict[str, float]:
        found = self.model.require(*self._groups(x, u, p))
        if not isinstance(found, Mapping) or (
            "statements" in vars(self) and set(found) != set(self.statements)
        ):
            raise Problem(f"{self.model.name}: require() gave {found!r}, expected always the same statements")
        return {statement: self._number("require", statement, n) for statement, n in found.items()}

    def advance(
        self, x: Array, p: Array, motion: Motion, t: float, length: float, tolerance: float, memory: Array
    ) -> tuple[Array, Array]:
        """See `Behaviour`: equal steps, none longer than `inner_step`."""
        count = max(1, math.ceil(length / self.model.inner_step - 1e-9))
        h = length / count
        for k in range(count):
            u = motion.value((k + 0.5) * h)
            found = self.model.step(*self._groups(x, u, p), t + k * h, h)
            x = self._values("step", found, self.model.State)
        return x, memory

    def forward(
        self, x: Array, u: Array, p: Array, along: tuple[Array, Array, Array], initial: bool
    ) -> tuple[Array, Array, Array]:
        """A model by hand has no derivatives."""
        raise Problem("a model written by hand offers no derivatives")

    def _values(self, method: str, found: object, group: type[Any]) -> Array:
        if not isinstance(found, group):
            raise Problem(
                f"{self.model.name}: {method}() gave {type(found).__name__}, expected {group.__name__}"
            )
        return np.array([self._number(method, f.name, getattr(found, f.name)) for f in fields(group)])

    def _number(self, method: str, name: str, value: Any) -> float:
        if isinstance(value, str | bytes | bool) or np.ndim(value) != 0:
            raise Problem(f"{self.model.name}: {method}() gave {name} = {value!r}, expected a number")
        try:
            return float(value)
        except (TypeError, ValueError):
            raise Problem(
                f"{self.model.name}: {method}() gave {name} = {value!r}, expected a number"
            ) from None
