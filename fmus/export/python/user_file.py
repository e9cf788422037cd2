"""Where a `Subsystem` is found again on another machine, and whether it is still the same.

An origin is "module:name", or "module:name.key" for an entry of a mapping such as VARIANTS.

The file of a user: read, and refused if it would not work elsewhere.

Trials of a user's model before an FMU is made of it: it runs, hides no state, depends on what it says.
"""

from __future__ import annotations

import ast
import hashlib
import importlib
import importlib.util
import math
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from fmus.contract import Subsystem
from fmus.export.interface import Interface, Variable
from fmus.export.model_description import Unknowns
from fmus.export.python.instance import Instance, told
from fmus.export.python.user_model import Model, Stepwise, sealed
from fmus.export.python.user_model import face as face_of
from fmus.solver import Array
from orchestrator.base.errors import Problem


def origin(sub: Subsystem) -> str:
    """Under which name a loaded module has the subsystem: its own package if possible."""
    own = str(getattr(sub.dynamics, "__module__", "")) + "."
    found = [
        (not own.startswith(f"{module}."), module.split(".")[0] != own.split(".")[0], len(place), place)
        for module in list(sys.modules)
        if module != "__main__"
        for place, value in _named(module)
        if value is sub
    ]
    if not found:
        raise Problem(
            f"{sub.name}: no module has this subsystem under a name, expected one such as "
            '"package.module:NAME" to find it again where the FMU runs'
        )
    return min(found)[-1]


def _named(module: str) -> Iterator[tuple[str, Any]]:
    """The subsystems of a module, also those in its mappings, each with its origin."""
    for name, value in list(getattr(sys.modules[module], "__dict__", {}).items()):
        if isinstance(value, Subsystem):
            yield f"{module}:{name}", value
        elif isinstance(value, Mapping) and all(isinstance(v, Subsystem) for v in value.values()):
            yield from ((f"{module}:{name}.{key}", v) for key, v in value.items())


def subsystem(where: str) -> Subsystem:
    """The subsystem with this origin."""
    module, _, path = where.partition(":")
    name, _, key = path.partition(".")
    if not name:
        raise Problem(f'"{where}" is no name of a subsystem, expected one such as "package.module:NAME"')
    try:
        found = getattr(importlib.import_module(module), name)
        found = found[key] if key else found
    except (ImportError, AttributeError, KeyError, TypeError) as problem:
        raise Problem(
            f"{where} is not in the Python of {sys.prefix}: {type(problem).__name__}: {problem}"
        ) from None
    if not isinstance(found, Subsystem):
        raise Problem(f"{where} is {type(found).__name__}, expected a Subsystem")
    return found


def fingerprint(face: Interface) -> str:
    """Another one for other variables or equations, whatever the numbers are.

    Constants count to twelve digits: a mathematical library may differ in the last ones.
    """
    digest = hashlib.sha256()
    for v in face.variables:
        digest.update(repr((v.name, v.kind, v.output, sorted(asdict(v.quantity).items()))).encode())
    sym = face.equations
    f = ca.Function("f", [sym.x, sym.u, sym.p], [sym.dx, face.y, sym.start, sym.require])
    for k in range(f.n_instructions()):
        step: tuple[Any, ...] = f.instruction_id(k), f.instruction_input(k), f.instruction_output(k)
        if step[0] == ca.OP_CONST:
            step = (*step, f"{f.instruction_constant(k):.12g}")
        digest.update(repr(step).encode())
    digest.update(repr((sym.statements, face.stiff)).encode())
    return digest.hexdigest()


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
    found = [
        value
        for value in vars(sys.modules[name]).values()
        if isinstance(value, type) and issubclass(value, Model) and value.__module__ == name
    ]
    if len(found) != 1:
        names = ", ".join(c.__name__ for c in found) or "none"
        raise Problem(f"{path.name} defines {names}, expected one class of Model")
    if not found[0].name:
        found[0].name = path.stem
    return sealed(found[0]())


def _read(path: Path) -> ast.Module:
    if not path.is_file():
        raise Problem(f"{path}: there is no such file")
    try:
        return ast.parse(path.read_text(encoding="utf-8"), path.name)
    except (OSError, ValueError, SyntaxError) as problem:
        raise Problem(told(problem, path.parent)) from None


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
                raise Problem(
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
            raise Problem(f"{model.name}: depends names {name}, expected an output or a computed state")
        if isinstance(on, str) or not set(on) <= set(inputs):
            wrong = on if isinstance(on, str) else min(set(on) - set(inputs))
            raise Problem(f"{model.name}: depends[{name!r}] names {wrong!r}, expected a list of inputs")

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


SHARE = 0.01  # of the nominal value, by which inputs are moved
POINTS, STEPS = 8, 3


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
    except (Exception, SystemExit) as problem:
        raise Problem(told(problem, path.parent)) from None
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
        raise Problem(
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
            for name, i in index.items():
                moved = u.copy()
                moved[i] += scale[i]
                try:
                    pairs = zip(what, row(x, u), row(x, moved), strict=True)
                except Exception:  # a point where the model does not work tells nothing
                    continue
                wrong = [n for n, a, b in pairs if a != b and math.isfinite(a) and math.isfinite(b)]
                wrong = [n for n in wrong if name not in model.depends.get(n, index)]
                if wrong:
                    raise Problem(
                        f"{model.name}: {wrong[0]} changes with {name}, "
                        f"which depends[{wrong[0]!r}] does not name"
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
