"""Loads and checks the file of a user with a `Model`: its imports, its dependencies, a few steps."""

import ast
import hashlib
import importlib.util
import sys
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import product
from pathlib import Path

import numpy as np

from fmus.contract import Subsystem
from fmus.export.interface import Interface, Variable
from fmus.export.model_description import Unknowns
from fmus.export.python.instance import Instance
from fmus.export.python.user_model import Model, UserModel, check_model, read_only
from fmus.solver import Array
from orchestrator.base.errors import Problem


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
    lines = [
        f.lineno for f in traceback.extract_tb(problem.__traceback__) if Path(f.filename).name == path.name
    ]
    where = f"{path.name}:{lines[-1]}" if lines else path.name
    return Problem(f"{where}: {text.removeprefix(f'{path.stem}: ')}")


def _location(problem: BaseException, folder: Path) -> str:
    """File and line of an exception, as "file.py:12: "; empty if they are unknown."""
    if isinstance(problem, SyntaxError) and problem.filename:
        return f"{Path(problem.filename).name}:{problem.lineno}: "
    frames = traceback.extract_tb(problem.__traceback__)
    in_folder = [f for f in frames if Path(f.filename).parent == folder]
    return "".join(f"{Path(f.filename).name}:{f.lineno}: " for f in (in_folder or frames)[-1:])


PACKAGE = __name__.partition(".")[0]


def load(path: Path) -> Model:
    """The model in a file; the module gets a unique name, because another file may have the same name."""
    location = str(path.resolve())
    name = f"{path.stem}_{hashlib.sha256(location.encode() + path.read_bytes()).hexdigest()[:16]}"
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
    if path.is_dir():
        raise Problem(f"{path}: expected a file, found a folder")
    if not path.is_file():
        raise Problem(f"{path}: the file does not exist")
    try:
        return ast.parse(path.read_text(encoding="utf-8"), path.name)
    except (OSError, ValueError, SyntaxError) as problem:
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


# ---- checks ----------------------------------------------------------------------------------------

CHANGE = 0.01  # change of an input that tests a dependency, relative to the nominal value of the input
POINTS, STEPS = 8, 3  # number of random points and of steps


def checked(path: Path, step: float) -> UserModel:
    """The model in a file. A few steps show that it runs, hides no state and declares its dependencies."""
    try:
        model = UserModel(load(path))
        structure(model)
        instance = Instance(model).initialise()
        _check_dependencies(model, instance)
        for _ in range(STEPS):
            instance.advance(step)
        _check_replay(model.model.name, instance, step)
        _check_dependencies(model, instance)
    except (Exception, SystemExit) as problem:
        raise in_file(problem, path) from None
    return model


def _check_replay(name: str, instance: Instance, step: float) -> None:
    """Steps from a saved state must give the same bits when they are repeated."""
    saved = instance.save()
    ends = []
    for _ in range(2):
        instance.restore(saved)
        for _ in range(STEPS):
            instance.advance(step)
        ends.append((instance.save(), instance.get([v.reference for v in instance.variables])))
    if ends[0] != ends[1]:
        raise Problem(
            f"{name}: steps repeated from a saved state give different values: the model stores something "
            "outside State (in a list, a global variable, a random number generator)"
        )


def _check_dependencies(user: UserModel, instance: Instance) -> None:
    """Outputs and computed states must not change with inputs that `depends` does not list for them."""
    model, interface = user.model, user.interface
    p = np.array([v.start or 0.0 for v in interface.parameters])
    states = [i for i, v in enumerate(interface.states) if v.kind == "CALCULATED_STATE"]
    functions: list[tuple[list[str], Callable[[Array, Array], Array]]] = [
        ([v.name for v in interface.outputs], lambda x, u: user.observe(x, u, p, 0.0)[0]),
        ([interface.states[i].name for i in states], lambda x, u: user.start(x, u, p)[states]),
    ]
    inputs = [v.name for v in interface.inputs]
    for (x, u), (names, function), (i, v) in product(
        list(_points(instance, interface)), functions, list(enumerate(interface.inputs))
    ):
        changed_u = u.copy()
        changed_u[i] += CHANGE * v.quantity.nominal
        try:
            before, after = function(x, u), function(x, changed_u)
        except Exception:  # the model may be undefined at a random point
            continue
        changed = (before != after) & np.isfinite(before) & np.isfinite(after)
        for name in (n for n, c in zip(names, changed, strict=True) if c):
            if v.name not in model.depends.get(name, inputs):
                raise Problem(
                    f"{model.name}: {name} changes with {v.name}, which is missing in depends[{name!r}]"
                )


def _points(instance: Instance, interface: Interface) -> Iterator[tuple[Array, Array]]:
    """States and inputs: the initial ones, and random ones close to these."""
    rng, s = np.random.default_rng(0), instance.state
    nominal = [np.array([v.quantity.nominal for v in g]) for g in (interface.states, interface.inputs)]
    yield s.x, s.u
    for _ in range(POINTS):
        x, u = (v + 0.1 * n * rng.uniform(-1, 1, v.size) for v, n in zip((s.x, s.u), nominal, strict=True))
        yield x, u
