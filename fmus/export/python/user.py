"""The file of a user: read, refused if it would not work elsewhere, and tried before an FMU is made of it."""

from __future__ import annotations

import ast
import hashlib
import importlib.util
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from fmus.contract import ModelError
from fmus.export.interface import Interface, Variable
from fmus.export.model_description import Unknowns
from fmus.export.python.instance import Instance
from fmus.export.python.messages import told
from fmus.export.python.model import Model, sealed
from fmus.export.python.stepwise import Stepwise
from fmus.export.python.stepwise import face as face_of
from fmus.solver import Array

SHARE = 0.01  # of the nominal value, by which inputs are moved
POINTS, STEPS = 8, 3


def load(path: Path) -> Model:
    """The model in a file, as a module under a name of its own: another file may have the same name."""
    place = str(path.resolve())
    name = f"{path.stem}_{hashlib.sha256(place.encode() + path.read_bytes()).hexdigest()[:16]}"
    if name not in sys.modules:
        spec = importlib.util.spec_from_file_location(name, place)
        if spec is None or spec.loader is None:
            raise ModelError(f"{path.name} is no Python file")
        module = importlib.util.module_from_spec(spec)
        sys.modules[name] = module
        try:
            spec.loader.exec_module(module)
        except BaseException:
            del sys.modules[name]
            raise
    found = [
        value
        for value in vars(sys.modules[name]).values()
        if isinstance(value, type) and issubclass(value, Model) and value.__module__ == name
    ]
    if len(found) != 1:
        names = ", ".join(c.__name__ for c in found) or "none"
        raise ModelError(f"{path.name} defines {names}, expected one class of Model")
    if not found[0].name:
        found[0].name = path.stem
    return sealed(found[0]())


def refuse_neighbours(path: Path) -> None:
    """Refuse imports of files beside the user's: they would be missing, or those of another FMU."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"), path.name)):
        names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
        if isinstance(node, ast.ImportFrom):
            names = ["." * node.level + (node.module or "")]
        for name in names:
            top = name.partition(".")[0]
            beside = [path.parent / f"{top}.py", path.parent / top / "__init__.py"]
            if name.startswith(".") or any(p.is_file() for p in beside):
                raise ModelError(
                    f"{path.name}:{getattr(node, 'lineno', 0)}: imports {name}, a module beside the file, which "
                    "would collide with another FMU's: put it into the file or into an installed package"
                )


def declared_files(path: Path) -> list[str]:
    """What `files` of the class says, before the file can be run: it may read them when it is imported."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"), path.name)):
        target = node.targets[0] if isinstance(node, ast.Assign) else getattr(node, "target", None)
        value = getattr(node, "value", None)
        if isinstance(target, ast.Name) and target.id == "files" and isinstance(value, ast.Tuple | ast.List):
            try:
                return [str(name) for name in ast.literal_eval(value)]
            except ValueError:
                break
    return []


# ---- dependencies ----------------------------------------------------------------------------------


def structure(model: Model, face: Interface) -> Unknowns:
    """Outputs and what is calculated at the start, each with what it depends on, as declared."""
    inputs = {v.name: v for v in face.inputs}
    known = {v.name for v in (*face.states, *face.outputs) if v.output or v.kind == "CALCULATED_STATE"}
    for name, on in model.depends.items():
        if name not in known:
            raise ModelError(f"{model.name}: depends names {name}, expected an output or a computed state")
        if isinstance(on, str) or not set(on) <= set(inputs):
            wrong = on if isinstance(on, str) else min(set(on) - set(inputs))
            raise ModelError(f"{model.name}: depends[{name!r}] names {wrong!r}, expected a list of inputs")

    def declared(name: str) -> list[str]:
        return list(model.depends.get(name, inputs))

    def listed(names: Iterator[str] | list[str], *more: Variable) -> list[tuple[Variable, str]]:
        return [(v, "dependent") for v in (*(inputs[n] for n in sorted(set(names))), *more)]

    calculated = [v for v in face.states if v.kind == "CALCULATED_STATE"]
    through = [n for v in calculated for n in declared(v.name)]
    start = [*face.parameters, *(v for v in face.states if v.kind == "STATE")]
    shown = [v for v in face.variables if v.output]
    return {
        "Outputs": [(v, [] if v.kind != "OUTPUT" else listed(declared(v.name))) for v in shown],
        "InitialUnknowns": [
            (v, listed(declared(v.name) + (through if v.kind == "OUTPUT" else []), *start))
            for v in sorted(shown, key=lambda v: v.reference)
            if v.kind != "STATE"
        ],
    }


# ---- trials ----------------------------------------------------------------------------------------


def tried(path: Path, step: float) -> tuple[Model, Interface]:
    """The model and its variables, after a few steps and all checks."""
    try:
        model = load(path)
        face = face_of(model)
        structure(model, face)
        behaviour = Stepwise(model, face)
        run = Instance(behaviour).initialise()
        _check_dependencies(behaviour, run)
        for _ in range(STEPS):
            run.advance(step)
        _check_replay(behaviour.model.name, run, step)
        _check_dependencies(behaviour, run)
    except Exception as problem:
        raise ModelError(told(problem, path.parent)) from None
    return model, face


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
        raise ModelError(
            f"{name}: steps repeated from a saved state give other values: something is kept "
            "beside State (in a list, a global, a random number)"
        )


def _check_dependencies(behaviour: Stepwise, run: Instance) -> None:
    """No output moves with an input that it is declared not to depend on."""
    model, face = behaviour.model, behaviour.face
    index = {v.name: i for i, v in enumerate(face.inputs)}
    scale = np.array([SHARE * v.quantity.nominal for v in face.inputs])
    for x, u in _points(run, face):
        for what, row in _rows(behaviour):
            try:
                base = row(x, u)
            except Exception:  # a point where the model does not work tells nothing
                continue
            for name, i in index.items():
                moved = u.copy()
                moved[i] += scale[i]
                wrong = [n for n, a, b in zip(what, base, row(x, moved), strict=True) if a != b]
                wrong = [n for n in wrong if name not in model.depends.get(n, index)]
                if wrong:
                    raise ModelError(
                        f"{model.name}: {wrong[0]} changes with {name}, which depends[{wrong[0]!r}] does not name"
                    )


def _points(run: Instance, face: Interface) -> Iterator[tuple[Array, Array]]:
    """States and inputs around where the model starts."""
    rng, s = np.random.default_rng(0), run.state
    nominal = [np.array([v.quantity.nominal for v in g]) for g in (face.states, face.inputs)]
    yield s.x, s.u
    for _ in range(POINTS):
        x, u = (v + 0.1 * n * rng.uniform(-1, 1, v.size) for v, n in zip((s.x, s.u), nominal, strict=True))
        yield x, u


def _rows(behaviour: Stepwise) -> list[tuple[list[str], Callable[[Array, Array], list[float]]]]:
    """What is computed from inputs: names and values, of outputs and of states at the start."""
    face, p = behaviour.face, np.array([v.start or 0.0 for v in behaviour.face.parameters])
    states = [i for i, v in enumerate(face.states) if v.kind == "CALCULATED_STATE"]

    def outputs(x: Array, u: Array) -> list[float]:
        return behaviour.observe(x, u, p, 0.0)[0].tolist()  # type: ignore[no-any-return]

    def start(x: Array, u: Array) -> list[float]:
        return behaviour.start(x, u, p)[states].tolist()  # type: ignore[no-any-return]

    return [
        ([v.name for v in face.outputs], outputs),
        ([face.states[i].name for i in states], start),
    ]
