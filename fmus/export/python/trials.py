"""Trials of a user's model before an FMU is made of it: it runs, hides no state, depends on what it says."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from fmus.contract import ModelError
from fmus.export.interface import Interface
from fmus.export.python.instance import Instance
from fmus.export.python.messages import told
from fmus.export.python.model import Model
from fmus.export.python.stepwise import Stepwise
from fmus.export.python.stepwise import face as face_of
from fmus.export.python.user import load, structure
from fmus.solver import Array

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
                    raise ModelError(
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
