"""`Model`, the base class of an FMU written by hand in Python: its variables, one step, its outputs.

    class Lag(Model):
        "First-order lag"
        Inputs, State, Outputs = LagInputs, LagState, LagOutputs

        def step(self, x, u, p, t, h):
            return LagState(y=x.y + (u.u - x.y) * h / 0.1)

        def observe(self, x, u, p, t):
            return LagOutputs(y=x.y)

The groups are frozen dataclasses with fields `Annotated[float, Quantity(unit, text)]`; the default of a field
is the start value. `subgroup` selects fields of another group. `examples/my_subsystem` is an example. The
FMU calls a `UserModel`: the model with its FMI interface, and with checks of all that its methods return.
"""

from __future__ import annotations

import ast
import hashlib
import importlib.util
import inspect
import math
import sys
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import MISSING, dataclass, fields, is_dataclass, make_dataclass, replace
from difflib import get_close_matches
from itertools import product
from numbers import Real
from pathlib import Path
from types import FunctionType
from typing import Annotated, Any, ClassVar, TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from fmus.contract import Quantity, Subsystem, Symbolic, flat, nested, place, quantities, unstack
from fmus.export.interface import Interface, Variable, make_interface, variable_groups
from fmus.export.model_description import Unknowns
from fmus.parameters import Values
from orchestrator.base.errors import Problem, suggest
from orchestrator.base.files import MAX_TEXT, Location

# what the page of the reference shows
__all__ = ["Model", "UserModel", "check_model", "read_only", "subgroup"]

Array: TypeAlias = NDArray[np.float64]


@dataclass(frozen=True)
class Nothing:
    """The group without variables."""


def subgroup(name: str, group: type[Any], *variables: str) -> type[Any]:
    """A group of some variables of another one, such as outputs of the component that the model replaces."""
    declared = quantities(group)
    for variable in variables:
        if variable not in declared:
            names = ", ".join(get_close_matches(variable, declared)) or ", ".join(declared)
            raise Problem(f"{name}: {group.__name__} has no {variable}, expected a name such as {names}")
    return make_dataclass(name, [(v, Annotated[float, declared[v]]) for v in variables], frozen=True)


class Model:
    """Base class of models by hand. All values that change during a simulation must be in `State`.

    name         identifier: name of the FMU; default: name of the file
    Parameters, State, Inputs, Outputs   the variables; an output with the name of a state is that state
    start        start values of inputs; default: the defaults of the fields, else 0
    depends      output -> inputs that it depends on directly; state that `initial` computes -> inputs that it
                 is computed from; outputs and states that are missing here depend on all inputs
    files        names of files in the same folder that the model reads; the FMU contains them
    inner_step   longest step [s] with which `step` is called
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
        """Initial values of states that are computed from start values x, inputs and parameters."""
        return {}

    def step(self, x: Any, u: Any, p: Any, t: float, h: float) -> Any:
        """The state at t + h from the state x at t; u: the inputs in the middle of the step."""
        return x

    def observe(self, x: Any, u: Any, p: Any, t: float) -> Any:
        """The outputs at t."""
        raise NotImplementedError("observe(x, u, p, t) is missing, expected a method that returns Outputs")

    def require(self, x: Any, u: Any, p: Any) -> Mapping[str, float]:
        """Requirements at the start and after every step: description -> value, which must be > 0."""
        return {}

    def __setattr__(self, name: str, value: object) -> None:
        if "_read_only" in self.__dict__:
            raise Problem(
                f"{_caller()}self.{name} = ... stores a value outside State, so saved states do not "
                "contain it: declare it in State and return it from step()"
            )
        object.__setattr__(self, name, value)

    def __delattr__(self, name: str) -> None:
        raise Problem(f"{_caller()}del self.{name}: a model must not change during a simulation")


LEAST_INNER_STEP = 1e-9  # s; a step of 1 ms then takes a million calls, some seconds
ATTRIBUTES = tuple(name for name in vars(Model) if not name.startswith("_"))
MIN_LETTERS = 4  # shorter names resemble each other by chance
METHODS = ("initial", "step", "observe", "require")


def check_model(model: Model) -> None:
    """Refuse a model whose attributes are misspelled, missing or of a wrong type.

    A public attribute of another name is the user's own. It is refused if the class lacks an attribute of
    `Model` of the same kind whose name differs in one letter or in case.
    """
    classes = [c for c in type(model).__mro__ if c not in (Model, object)]
    own = {n for names in (vars(model), *map(vars, classes)) for n in names if not n.startswith("_")}
    theirs = sorted(own - set(ATTRIBUTES))
    for name, absent in product(theirs, [n for n in ATTRIBUTES if n not in own]):
        kind = _kind(inspect.getattr_static(Model, absent))
        if kind and kind == _kind(inspect.getattr_static(model, name)) and _is_misspelt(name, absent):
            raise Problem(f"{type(model).__name__}.{name} is unknown; did you mean {absent}?")
    needed = ("step", "observe") if model.State is not Nothing else ("observe",)
    for name in METHODS:
        declared = list(inspect.signature(getattr(Model, name)).parameters)[1:]
        wanted = f"{type(model).__name__}: expected a method {name}({', '.join(declared)})"
        if name not in own and name in needed:
            raise Problem(f"{wanted}, found none{suggest(name, theirs)}")
        method = getattr(model, name)
        try:
            inspect.signature(method).bind(*declared)
        except TypeError as error:  # not a function, or of other arguments
            raise Problem(f"{wanted}, found {_shown(name, method)} ({error})") from None
        except ValueError:  # a function of a compiled library, whose arguments are unknown
            continue
    _check_settings(type(model))


def _kind(value: object) -> type | None:
    """The kinds of attributes that are compared; None for other values."""
    if isinstance(value, staticmethod | classmethod):
        return FunctionType
    return next((kind for kind in (FunctionType, type, Mapping, Real) if isinstance(value, kind)), None)


def _is_misspelt(name: str, meant: str) -> bool:
    """Do two names of 4 or more letters differ in case, or in one letter that is missing or other?"""
    a, b = sorted((name.lower(), meant.lower()), key=len)
    same = next((i for i, pair in enumerate(zip(a, b, strict=False)) if pair[0] != pair[1]), len(a))
    return len(a) >= MIN_LETTERS and a[same + (len(a) == len(b)) :] == b[same + 1 :]


def _shown(name: str, method: object) -> str:
    return f"{name}{inspect.signature(method)}" if callable(method) else repr(method)


def _is_number(value: object) -> bool:
    """Is this a number of Python or NumPy, also as an array without dimensions?"""
    if isinstance(value, np.ndarray) and value.ndim == 0:
        value = value.item()
    return isinstance(value, Real) and not isinstance(value, bool)


def _check_settings(model: type[Model]) -> None:
    for name in ("start", "depends"):
        if not isinstance(value := getattr(model, name), Mapping):
            raise Problem(f"{model.__name__}.{name}: expected a dictionary, found {value!r}")
    for output, inputs in model.depends.items():
        if isinstance(inputs, str) or not isinstance(inputs, Iterable):
            raise Problem(f"depends[{output!r}]: expected a list of inputs, got {inputs!r}")
    if not isinstance(model.name, str):
        raise Problem(f"{model.__name__}.name: expected text, found {model.name!r}")
    longest = model.inner_step
    if not _is_number(longest) or not longest >= LEAST_INNER_STEP:
        raise Problem(
            f"{model.__name__}.inner_step: expected at least {LEAST_INNER_STEP:g} s, found {longest!r}"
        )


def _caller() -> str:
    """File and line of the user's code that changes an attribute of a `Model`."""
    frame = sys._getframe(2)
    return f"{Path(frame.f_code.co_filename).name}:{frame.f_lineno}: "


def read_only(model: Model) -> Model:
    """The model with read-only attributes and arrays."""
    for value in vars(model).values():
        if isinstance(value, np.ndarray):
            value.flags.writeable = False
    object.__setattr__(model, "_read_only", True)
    return model


_NONE = ca.SX(0, 1)
_NO_EQUATIONS = Symbolic(_NONE, _NONE, _NONE, _NONE, _NONE, _NONE, (), _NONE, (), ca.SX(math.inf))


def _interface(model: Model) -> Interface:
    """The FMI interface with start values; raises Problem for declarations that are not possible."""
    groups = {name: getattr(model, name) for name in ("Parameters", "Inputs", "State", "Outputs")}
    declared = {name: _declared(model, name, group) for name, group in groups.items()}
    for unknown in set(model.start) - set(declared["Inputs"]):
        raise Problem(
            f"{model.name}: start: {unknown} is not an input{suggest(str(unknown), declared['Inputs'])}"
        )
    start = {
        name: dict.fromkeys(declared[name], 0.0)
        | {
            f.name: _start_value(f"{name}.{f.name}", f.default)
            for f in fields(group)
            if f.default is not MISSING
        }
        for name, group in groups.items()
    }
    start["Inputs"] |= {name: _start_value(f"start of {name}", value) for name, value in model.start.items()}
    values = Values(p=start["Parameters"], u=start["Inputs"], x=start["State"])
    x, u, p = (nested(groups[name], start[name]) for name in ("State", "Inputs", "Parameters"))
    calculated = _initial_states(model, model.initial(x, u, p), declared["State"])
    text = (type(model).__doc__ or model.name).strip().partition("\n")[0].rstrip(".")
    variables = variable_groups([*declared.values()], values, calculated, derivatives=False)
    return make_interface(model.name, text, variables, _NO_EQUATIONS, _NONE)


def _start_value(name: str, value: object) -> float:
    if not _is_number(value):
        raise Problem(f"{name}: expected a number, found {value!r}")
    return float(value)  # type: ignore[arg-type]  # it is a number


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


def _initial_states(model: Model, values: object, states: Collection[str]) -> Mapping[str, float]:
    """The result of `initial`, checked: names of states."""
    if not isinstance(values, Mapping):
        raise Problem(f"{model.name}: initial() returned {type(values).__name__}, expected a dictionary")
    unknown = set(values) - set(states)
    if unknown:
        raise Problem(f"{model.name}: initial() returned {min(unknown)}, expected names of states")
    return values


class UserModel:
    """A model by hand with its interface; x states, u inputs, p parameters, t time [s].

    start_values   of x, u and p
    statements     descriptions of the requirements, whose values must be positive
    """

    def __init__(self, model: Model) -> None:
        self.model, self.interface = model, _interface(model)
        self._outputs = list(quantities(model.Outputs))
        states = [v.name for v in self.interface.states]
        self._calculated = [v.name for v in self.interface.states if v.kind == "CALCULATED_STATE"]
        self._only_outputs = [i for i, n in enumerate(self._outputs) if n not in states]
        self._state_outputs = [(i, states.index(n)) for i, n in enumerate(self._outputs) if n in states]
        groups = (self.interface.states, self.interface.inputs, self.interface.parameters)
        self.start_values = x, u, p = tuple(np.array([v.start or 0.0 for v in g]) for g in groups)
        self.statements = tuple(self._require(self.start(x, u, p), u, p))
        equations = replace(self.interface.equations, statements=self.statements)
        self.interface = replace(self.interface, equations=equations, in_python=True)

    def _groups(self, x: Array, u: Array, p: Array) -> tuple[Any, Any, Any]:
        m = self.model
        return (
            unstack(m.State, x.tolist()),
            unstack(m.Inputs, u.tolist()),
            unstack(m.Parameters, p.tolist()),
        )

    def start(self, x: Array, u: Array, p: Array) -> Array:
        """Initial states, from their start values."""
        result = self.model.initial(*self._groups(x, u, p))
        initial = _initial_states(self.model, result, self._calculated)
        if set(initial) != set(self._calculated):
            raise Problem(f"{self.model.name}: initial() returned other states than at the build")
        pairs = zip(self.interface.states, x, strict=True)
        return np.array([self._number("initial", v.name, initial.get(v.name, start)) for v, start in pairs])

    def observe(self, x: Array, u: Array, p: Array, t: float) -> tuple[Array, Array]:
        """Outputs that are not states, and the values of the requirements."""
        y = self._values("observe", self.model.observe(*self._groups(x, u, p), t), self.model.Outputs)
        for i, state in self._state_outputs:
            if y[i] != x[state] and not (math.isnan(y[i]) and math.isnan(x[state])):
                raise Problem(
                    f"{self.model.name}: observe() returned {self._outputs[i]} = {y[i]:.9g}, expected "
                    f"the value of the state, {x[state]:.9g}"
                )
        require = self._require(x, u, p)
        return y[self._only_outputs], np.array([require[statement] for statement in self.statements])

    def _require(self, x: Array, u: Array, p: Array) -> dict[str, float]:
        values = self.model.require(*self._groups(x, u, p))
        first_call = "statements" not in vars(self)
        if not isinstance(values, Mapping) or not (first_call or set(values) == set(self.statements)):
            raise Problem(
                f"{self.model.name}: require() returned {values!r}, expected the same "
                "requirements in each call"
            )
        return {statement: self._number("require", statement, n) for statement, n in values.items()}

    def advance(self, x: Array, inputs: Array, p: Array, time: float, length: float) -> Array:
        """States after `length` seconds: equal steps, none longer than `inner_step`.

        inputs   coefficients of their polynomials of the time since the start, constant first; shape (n, nu)
        """
        count = max(1, math.ceil(length / self.model.inner_step - 1e-9))
        h = length / count
        for k in range(count):
            u = _polynomial(inputs, (k + 0.5) * h)
            after = self.model.step(*self._groups(x, u, p), time + k * h, h)
            x = self._values("step", after, self.model.State)
        return x

    def _values(self, method: str, result: object, group: type[Any]) -> Array:
        if not isinstance(result, group):
            raise Problem(
                f"{self.model.name}: {method}() returned {type(result).__name__}, expected {group.__name__}"
            )
        return np.array([self._number(method, name, value) for name, value in flat(result).items()])

    def _number(self, method: str, name: str, value: Any) -> float:
        problem = Problem(f"{self.model.name}: {method}() returned {name} = {value!r}, expected a number")
        if isinstance(value, str | bytes | bool | ca.SX | ca.MX) or np.ndim(value) != 0:
            raise problem
        try:
            return float(value)
        except (TypeError, ValueError):
            raise problem from None


def _polynomial(coefficients: Array, tau: float) -> Array:
    value: Array = coefficients[-1]
    for row in coefficients[-2::-1]:
        value = row + tau * value
    return value


# ---- the file of a model -----------------------------------------------------------------------------


def message(problem: BaseException, folder: Path) -> str:
    """The text of a Problem; for another exception also its class, file and line.

    The line is the innermost one in a file of `folder`, which contains the scripts of the FMU, else in any
    file.
    """
    text = " ".join(str(problem.msg if isinstance(problem, SyntaxError) else problem).split())
    if isinstance(problem, Problem):
        return text
    start = f"{_location(problem, folder)}{type(problem).__name__}"
    return f"{start}: {text}" if text else start


def in_file(problem: BaseException, path: Path) -> Problem:
    """The exception as a Problem that begins with the user's file, and the line in it if it is known."""
    text = message(problem, path.parent)
    if text.startswith((f"{path.name}:", f"{path}:")):
        return Problem(text)
    if not isinstance(problem, Problem):  # the place in the library says nothing to the user
        text = text[len(_location(problem, path.parent)) :]
    where = place(problem, lambda file: Path(file).name == path.name) or f"{path.name}: "
    return Problem(f"{where}{text.removeprefix(f'{path.stem}: ')}")


def _location(problem: BaseException, folder: Path) -> str:
    """File and line of an exception, as "file.py:12: "; empty if they are unknown."""
    if isinstance(problem, SyntaxError) and problem.filename:
        return f"{Path(problem.filename).name}:{problem.lineno}: "
    in_folder = place(problem, lambda file: Path(file).parent == folder)
    return in_folder or place(problem, lambda _: True)


PACKAGE = __name__.partition(".")[0]


def load(path: Path) -> Model:
    """The model in a file; the module gets a unique name, because another file may have the same name."""
    location = str(path.resolve())
    name = f"{path.stem}_{hashlib.sha256(location.encode() + Location(path).read(MAX_TEXT)).hexdigest()[:16]}"
    if name not in sys.modules:
        spec = importlib.util.spec_from_file_location(name, location)
        if spec is None or spec.loader is None:
            raise Problem(f"{path.name} is not a Python file")
        module = importlib.util.module_from_spec(spec)
        sys.modules[name] = module
        try:
            spec.loader.exec_module(module)
        except BaseException:
            del sys.modules[name]
            raise
    models = [
        value
        for value in vars(sys.modules[name]).values()
        if isinstance(value, type) and issubclass(value, Model) and value.__module__ == name
    ]
    if len(models) != 1:
        names = ", ".join(c.__name__ for c in models) or "none"
        raise Problem(
            f"{path.name}: expected one subclass of Model, got {names}{_native(vars(sys.modules[name]))}"
        )
    if not models[0].name:
        models[0].name = path.stem
    model = models[0]()
    check_model(model)
    return read_only(model)


def _native(names: Mapping[str, object]) -> str:
    """What to do with a subsystem of equations."""
    found = [name for name, value in names.items() if isinstance(value, Subsystem)]
    return f"; {found[0]} is a Subsystem: build it by fmus.build({found[0]}, folder)" if found else ""


def _read(path: Path) -> ast.Module:
    try:
        return ast.parse(Location(path).text(), path.name)
    except (ValueError, SyntaxError) as problem:
        raise in_file(problem, path) from None


def refuse_neighbours(path: Path) -> None:
    """Refuse imports of modules in the same folder: an FMU would miss them or find those of another FMU."""
    for node in ast.walk(_read(path)):
        names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
        if isinstance(node, ast.ImportFrom):
            names = ["." * node.level + (node.module or "")]
        for name in names:
            top = name.partition(".")[0]
            if top == PACKAGE:
                continue  # the file may be in the root of a checkout, next to the package
            neighbours = [path.parent / f"{top}.py", path.parent / top / "__init__.py"]
            if name.startswith(".") or any(p.is_file() for p in neighbours):
                raise Problem(
                    f"{path.name}:{getattr(node, 'lineno', 0)}: imports {name} from the same folder; "
                    "another FMU may have a module of this name: move the code into this file "
                    "or into a package"
                )


def declared_files(path: Path) -> list[str]:
    """The value of `files` in the class, from the source: importing the module may read these files."""
    classes = (node for node in ast.walk(_read(path)) if isinstance(node, ast.ClassDef))
    for node in (statement for definition in classes for statement in definition.body):
        target = node.targets[0] if isinstance(node, ast.Assign) else getattr(node, "target", None)
        value = getattr(node, "value", None)
        if isinstance(target, ast.Name) and target.id == "files" and isinstance(value, ast.Tuple | ast.List):
            try:
                return [str(name) for name in ast.literal_eval(value)]
            except ValueError:
                break
    return []


# ---- dependencies ----------------------------------------------------------------------------------


def structure(user: UserModel) -> Unknowns:
    """Outputs and InitialUnknowns with the dependencies that the model declares."""
    model, interface = user.model, user.interface
    inputs = {v.name: v for v in interface.inputs}
    unknowns = {
        v.name for v in (*interface.states, *interface.outputs) if v.output or v.kind == "CALCULATED_STATE"
    }
    for name, dependencies in model.depends.items():
        if name not in unknowns:
            raise Problem(
                f"{model.name}: depends: {name} is not an output or a state that initial() computes"
            )
        for wrong in (n for n in dependencies if n not in inputs):
            raise Problem(f"{model.name}: depends[{name!r}]: expected a list of inputs, got {wrong!r}")

    def declared(name: str) -> list[str]:
        return list(model.depends.get(name, inputs))

    def knowns(names: Sequence[str], *others: Variable) -> list[tuple[Variable, str]]:
        return [(v, "dependent") for v in (*(inputs[n] for n in sorted(set(names))), *others)]

    calculated = [v for v in interface.states if v.kind == "CALCULATED_STATE"]
    via_states = [n for v in calculated for n in declared(v.name)]
    start = [*interface.parameters, *(v for v in interface.states if v.kind == "STATE")]
    outputs = [v for v in interface.variables if v.output]
    return {
        "Outputs": [(v, [] if v.kind != "OUTPUT" else knowns(declared(v.name))) for v in outputs],
        "InitialUnknowns": [
            (v, knowns(declared(v.name) + (via_states if v.kind == "OUTPUT" else []), *start))
            for v in sorted(outputs, key=lambda v: v.reference)
            if v.kind != "STATE"
        ],
    }
