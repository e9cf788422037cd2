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
from. `UserModel` is what an instance runs: the model with its variables, and every answer checked.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Collection, Mapping, Sequence
from dataclasses import MISSING, dataclass, fields, is_dataclass, make_dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Annotated, Any, ClassVar

import casadi as ca
import numpy as np

from fmus.contract import Quantity, Symbolic, quantities
from fmus.export.interface import Interface, assembled, variable_groups
from fmus.parameters import Values
from fmus.solver import Array, InputPolynomials
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


_NONE = ca.SX(0, 1)
_NO_EQUATIONS = Symbolic(_NONE, _NONE, _NONE, _NONE, _NONE, _NONE, (), _NONE, (), ca.SX(math.inf))


def _interface(model: Model) -> Interface:
    """The variables with their start values; refuses what cannot be in an FMU."""
    groups = {name: getattr(model, name) for name in ("Parameters", "Inputs", "State", "Outputs")}
    declared = {name: _declared(model, name, group) for name, group in groups.items()}
    unknown = set(model.start) - set(declared["Inputs"])
    if unknown:
        raise Problem(f"{model.name}: start names {min(unknown)}, expected inputs")
    start = {
        name: dict.fromkeys(declared[name], 0.0)
        | {f.name: float(f.default) for f in fields(group) if f.default is not MISSING}
        for name, group in groups.items()
    }
    start["Inputs"] |= {name: float(value) for name, value in model.start.items()}
    values = Values(p=start["Parameters"], u=start["Inputs"], x=start["State"])
    x, u, p = (groups[name](**start[name]) for name in ("State", "Inputs", "Parameters"))
    calculated = _computed(model, model.initial(x, u, p), declared["State"])
    text = (type(model).__doc__ or model.name).strip().partition("\n")[0].rstrip(".")
    variables = variable_groups([*declared.values()], values, calculated, derivatives=False)
    return assembled(model.name, text, variables, _NO_EQUATIONS, _NONE)


def _declared(model: Model, name: str, group: object) -> Mapping[str, Quantity]:
    if not (isinstance(group, type) and is_dataclass(group)):
        raise Problem(f"{model.name}: {name} is {group!r}, expected a dataclass")
    try:
        return quantities(group)
    except (AttributeError, NameError) as problem:
        raise Problem(
            f'{model.name}: a field of {name} is not declared as Annotated[float, Quantity("unit", "text")] '
            f"({problem})"
        ) from None


def _computed(model: Model, values: object, allowed: Collection[str]) -> Mapping[str, float]:
    """What `initial` returned, if that names states."""
    if not isinstance(values, Mapping):
        raise Problem(f"{model.name}: initial() gave {type(values).__name__}, expected a dictionary")
    unknown = set(values) - set(allowed)
    if unknown:
        raise Problem(f"{model.name}: initial() gave {min(unknown)}, expected names of states")
    return values


def _group(group: type[Any], values: Sequence[float]) -> Any:
    return group(**{f.name: value for f, value in zip(fields(group), values, strict=True)})


class UserModel:
    """A model by hand as an instance runs it, see `subsystem_model.RunnableModel`."""

    def __init__(self, model: Model) -> None:
        self.model, self.interface = model, _interface(model)
        self._outputs = [f.name for f in fields(model.Outputs)]
        states = [v.name for v in self.interface.states]
        self._calculated = [v.name for v in self.interface.states if v.kind == "CALCULATED_STATE"]
        self._own = [i for i, n in enumerate(self._outputs) if n not in states]
        self._merged = [(i, states.index(n)) for i, n in enumerate(self._outputs) if n in states]
        groups = (self.interface.states, self.interface.inputs, self.interface.parameters)
        x, u, p = (np.array([v.start or 0.0 for v in group]) for group in groups)
        self.statements = tuple(self._require(self.start(x, u, p), u, p))

    def _groups(self, x: Array, u: Array, p: Array) -> tuple[Any, Any, Any]:
        m = self.model
        return (
            _group(m.State, x.tolist()),
            _group(m.Inputs, u.tolist()),
            _group(m.Parameters, p.tolist()),
        )

    def start(self, x: Array, u: Array, p: Array) -> Array:
        """See `RunnableModel`."""
        computed = _computed(self.model, self.model.initial(*self._groups(x, u, p)), self._calculated)
        if set(computed) != set(self._calculated):
            raise Problem(f"{self.model.name}: initial() gave other states than at the build")
        given = zip(self.interface.states, x, strict=True)
        return np.array([self._number("initial", v.name, computed.get(v.name, old)) for v, old in given])

    def rate(self, x: Array, u: Array, p: Array) -> Array:
        """There are no derivatives."""
        return np.zeros(0)

    def observe(self, x: Array, u: Array, p: Array, t: float) -> tuple[Array, Array]:
        """See `RunnableModel`."""
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
        values = self.model.require(*self._groups(x, u, p))
        first = "statements" not in vars(self)
        if not isinstance(values, Mapping) or not (first or set(values) == set(self.statements)):
            raise Problem(
                f"{self.model.name}: require() gave {values!r}, expected always the same statements"
            )
        return {statement: self._number("require", statement, n) for statement, n in values.items()}

    def advance(
        self,
        x: Array,
        p: Array,
        motion: InputPolynomials,
        t: float,
        length: float,
        tolerance: float,
        memory: Array,
    ) -> tuple[Array, Array]:
        """See `RunnableModel`: equal steps, none longer than `inner_step`."""
        count = max(1, math.ceil(length / self.model.inner_step - 1e-9))
        h = length / count
        for k in range(count):
            u = motion.value((k + 0.5) * h)
            after = self.model.step(*self._groups(x, u, p), t + k * h, h)
            x = self._values("step", after, self.model.State)
        return x, memory

    def forward(
        self, x: Array, u: Array, p: Array, along: tuple[Array, Array, Array], initial: bool
    ) -> tuple[Array, Array, Array]:
        """A model by hand has no derivatives."""
        raise Problem("a model written by hand offers no derivatives")

    def _values(self, method: str, result: object, group: type[Any]) -> Array:
        if not isinstance(result, group):
            raise Problem(
                f"{self.model.name}: {method}() gave {type(result).__name__}, expected {group.__name__}"
            )
        return np.array([self._number(method, f.name, getattr(result, f.name)) for f in fields(group)])

    def _number(self, method: str, name: str, value: Any) -> float:
        problem = Problem(f"{self.model.name}: {method}() gave {name} = {value!r}, expected a number")
        if isinstance(value, str | bytes | bool) or np.ndim(value) != 0:
            raise problem
        try:
            return float(value)
        except (TypeError, ValueError):
            raise problem from None
