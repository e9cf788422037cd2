"""The file of a user: read, and refused if it would not work elsewhere."""

from __future__ import annotations

import ast
import hashlib
import importlib.util
import sys
from collections.abc import Sequence
from pathlib import Path

from fmus.contract import ModelError
from fmus.export.interface import Interface, Variable
from fmus.export.model_description import Unknowns
from fmus.export.python.messages import told
from fmus.export.python.model import Model, sealed

PACKAGE = __name__.partition(".")[0]


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


def _read(path: Path) -> ast.Module:
    if not path.is_file():
        raise ModelError(f"{path}: there is no such file")
    try:
        return ast.parse(path.read_text(encoding="utf-8"), path.name)
    except (OSError, ValueError, SyntaxError) as problem:
        raise ModelError(told(problem, path.parent)) from None


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
            beside = [path.parent / f"{top}.py", path.parent / top / "__init__.py"]
            if name.startswith(".") or any(p.is_file() for p in beside):
                raise ModelError(
                    f"{path.name}:{getattr(node, 'lineno', 0)}: imports {name}, a module beside the file, "
                    "which would collide with that of another FMU: put it into the file or into a package"
                )


def declared_files(path: Path) -> list[str]:
    """What `files` of the class says, before the file can be run: it may read them when it is imported."""
    classes = (node for node in ast.walk(_read(path)) if isinstance(node, ast.ClassDef))
    for node in (statement for found in classes for statement in found.body):
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

    def listed(names: Sequence[str], *more: Variable) -> list[tuple[Variable, str]]:
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
