"""The file of a user with a `Model`: loaded, refused if it cannot work elsewhere, checked by a few steps."""

from __future__ import annotations

import ast
import hashlib
import importlib.util
import sys
import traceback
from collections.abc import Callable, Iterator, Sequence
from itertools import product
from pathlib import Path

import numpy as np

from fmus.export.interface import Interface, Variable
from fmus.export.model_description import Unknowns
from fmus.export.python.instance import Instance
from fmus.export.python.user_model import Model, UserModel, sealed
from fmus.solver import Array
from orchestrator.base.errors import Problem


def message(problem: BaseException, folder: Path) -> str:
    """The text of a Problem; of another exception also its kind, file and line.

    The place is the last one in `folder`, where the FMU's own scripts are, else the last one of all.
    """
    text = " ".join(str(problem.msg if isinstance(problem, SyntaxError) else problem).split())
    if isinstance(problem, Problem):
        return text
    kind, place = type(problem).__name__, _place(problem, folder)
    return f"{place}{kind}: {text}" if text else f"{place}{kind}"


def _place(problem: BaseException, folder: Path) -> str:
    """File and line of an exception, as "file.py:12: "; empty when it has none."""
    if isinstance(problem, SyntaxError) and problem.filename:
        return f"{Path(problem.filename).name}:{problem.lineno}: "
    frames = traceback.extract_tb(problem.__traceback__)
    own = [f for f in frames if Path(f.filename).parent == folder]
    return "".join(f"{Path(f.filename).name}:{f.lineno}: " for f in (own or frames)[-1:])


PACKAGE = __name__.partition(".")[0]


def load(path: Path) -> Model:
    """The model in a file, as a module under a name of its own: another file may have the same name."""
    place = str(path.resolve())
    name = f"{path.stem}_{hashlib.sha256(place.encode() + path.read_bytes()).hexdigest()[:16]}"
    if name not in sys.modules:
        spec = importlib.util.spec_from_file_location(name, place)
        if spec is None or spec.loader is None:
            raise Problem(f"{path.name} is no Python file")
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
        raise Problem(f"{path.name} defines {names}, expected one class of Model")
    if not models[0].name:
        models[0].name = path.stem
    return sealed(models[0]())


def _read(path: Path) -> ast.Module:
    if not path.is_file():
        raise Problem(f"{path}: there is no such file")
    try:
        return ast.parse(path.read_text(encoding="utf-8"), path.name)
    except (OSError, ValueError, SyntaxError) as problem:
        raise Problem(message(problem, path.parent)) from None


def refuse_neighbours(path: Path) -> None:
    """Refuse imports of files beside the user's: they would be missing, or those of another FMU."""
    for node in ast.walk(_read(path)):
        names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
        if isinstance(node, ast.ImportFrom):
            names = ["." * node.level + (node.module or "")]
        for name in names:
            top = name.partition(".")[0]
            if top == PACKAGE:
                continue  # a file in the root of a checkout has the package itself beside it
            neighbours = [path.parent / f"{top}.py", path.parent / top / "__init__.py"]
            if name.startswith(".") or any(p.is_file() for p in neighbours):
                raise Problem(
                    f"{path.name}:{getattr(node, 'lineno', 0)}: imports {name}, a module beside the file, "
                    "which would collide with that of another FMU: put it into the file or into a package"
                )


def declared_files(path: Path) -> list[str]:
    """What `files` of the class says, before the file can be run: it may read them when it is imported."""
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
    """Outputs and what is calculated at the start, each with what it depends on, as declared."""
    model, interface = user.model, user.interface
    inputs = {v.name: v for v in interface.inputs}
    known = {
        v.name for v in (*interface.states, *interface.outputs) if v.output or v.kind == "CALCULATED_STATE"
    }
    for name, on in model.depends.items():
        if name not in known:
            raise Problem(f"{model.name}: depends names {name}, expected an output or a computed state")
        if isinstance(on, str) or not set(on) <= set(inputs):
            wrong = on if isinstance(on, str) else min(set(on) - set(inputs))
            raise Problem(f"{model.name}: depends[{name!r}] names {wrong!r}, expected a list of inputs")

    def declared(name: str) -> list[str]:
        return list(model.depends.get(name, inputs))

    def listed(names: Sequence[str], *more: Variable) -> list[tuple[Variable, str]]:
        return [(v, "dependent") for v in (*(inputs[n] for n in sorted(set(names))), *more)]

    calculated = [v for v in interface.states if v.kind == "CALCULATED_STATE"]
    through = [n for v in calculated for n in declared(v.name)]
    start = [*interface.parameters, *(v for v in interface.states if v.kind == "STATE")]
    shown = [v for v in interface.variables if v.output]
    return {
        "Outputs": [(v, [] if v.kind != "OUTPUT" else listed(declared(v.name))) for v in shown],
        "InitialUnknowns": [
            (v, listed(declared(v.name) + (through if v.kind == "OUTPUT" else []), *start))
            for v in sorted(shown, key=lambda v: v.reference)
            if v.kind != "STATE"
        ],
    }


# ---- checks ----------------------------------------------------------------------------------------

SHARE = 0.01  # of the nominal value, by which inputs are moved
POINTS, STEPS = 8, 3


def checked(path: Path, step: float) -> UserModel:
    """The model in a file, after a few steps: it runs, hides no state, depends on what it declares."""
    try:
        model = UserModel(load(path))
        structure(model)
        run = Instance(model).initialise()
        _check_dependencies(model, run)
        for _ in range(STEPS):
            run.advance(step)
        _check_replay(model.model.name, run, step)
        _check_dependencies(model, run)
    except (Exception, SystemExit) as problem:
        raise Problem(message(problem, path.parent)) from None
    return model


def _check_replay(name: str, instance: Instance, step: float) -> None:
    """Steps from a saved state, repeated, give the same bits."""
    saved = instance.save()
    ends = []
    for _ in range(2):
        instance.restore(saved)
        for _ in range(STEPS):
            instance.advance(step)
        ends.append((instance.save(), instance.get([v.reference for v in instance.variables])))
    if ends[0] != ends[1]:
        raise Problem(
            f"{name}: steps repeated from a saved state give other values: something is kept "
            "beside State (in a list, a global, a random number)"
        )


def _check_dependencies(user: UserModel, run: Instance) -> None:
    """No output and no computed state moves with an input that it is declared not to depend on."""
    model, interface = user.model, user.interface
    p = np.array([v.start or 0.0 for v in interface.parameters])
    states = [i for i, v in enumerate(interface.states) if v.kind == "CALCULATED_STATE"]
    functions: list[tuple[list[str], Callable[[Array, Array], Array]]] = [
        ([v.name for v in interface.outputs], lambda x, u: user.observe(x, u, p, 0.0)[0]),
        ([interface.states[i].name for i in states], lambda x, u: user.start(x, u, p)[states]),
    ]
    inputs = [v.name for v in interface.inputs]
    for (x, u), (names, function), (i, v) in product(
        list(_points(run, interface)), functions, list(enumerate(interface.inputs))
    ):
        moved = u.copy()
        moved[i] += SHARE * v.quantity.nominal
        try:
            before, after = function(x, u), function(x, moved)
        except Exception:  # a point where the model does not work says nothing
            continue
        changed = (before != after) & np.isfinite(before) & np.isfinite(after)
        for name in (n for n, c in zip(names, changed, strict=True) if c):
            if v.name not in model.depends.get(name, inputs):
                raise Problem(
                    f"{model.name}: {name} changes with {v.name}, which depends[{name!r}] does not name"
                )


def _points(run: Instance, interface: Interface) -> Iterator[tuple[Array, Array]]:
    """States and inputs around where the model starts."""
    rng, s = np.random.default_rng(0), run.state
    nominal = [np.array([v.quantity.nominal for v in g]) for g in (interface.states, interface.inputs)]
    yield s.x, s.u
    for _ in range(POINTS):
        x, u = (v + 0.1 * n * rng.uniform(-1, 1, v.size) for v, n in zip((s.x, s.u), nominal, strict=True))
        yield x, u
