"""Checks of a user's model when its FMU is built: a few steps, saved states, declared dependencies."""

from collections.abc import Callable, Iterator
from itertools import product
from pathlib import Path

import numpy as np

from fmus.export.python.user_model import Array, UserModel, in_file, load, structure
from orchestrator.base.errors import Problem

CHANGE = 0.01  # change of an input that tests a dependency, relative to the nominal value of the input
POINTS, STEPS = 8, 3  # number of random points and of steps


def checked(path: Path, step: float) -> UserModel:
    """The model in a file. A few steps show that it runs, hides no state and declares its dependencies."""
    try:
        model = UserModel(load(path))
        structure(model)
        x, u, p = model.start_values
        x = model.start(x, u, p)
        _values(model, x, 0.0)
        _check_dependencies(model, x)
        x, _ = _after_steps(model, x, 0.0, step)
        ends = [_after_steps(model, x, STEPS * step, step) for _ in range(2)]
        if any(a.tobytes() != b.tobytes() for a, b in zip(*ends, strict=True)):
            raise Problem(
                f"{model.model.name}: steps repeated from a saved state give different values: the model "
                "stores something outside State (in a list, a global variable, a random number generator)"
            )
        _check_dependencies(model, x)
    except (Exception, SystemExit) as problem:
        raise in_file(problem, path) from None
    return model


def _values(user: UserModel, x: Array, time: float) -> Array:
    """Outputs and requirements at the start values of the inputs; refused as the FMU would refuse them."""
    _, u, p = user.start_values
    y, require = user.observe(x, u, p, time)
    for statement, value in zip(user.statements, require, strict=True):
        if not value > 0:
            raise Problem(
                f'requirement "{statement}" is violated at t = {time:.9g} s: {value:.6g}, expected > 0'
            )
    for v, value in zip((*user.interface.states, *user.interface.outputs), (*x, *y), strict=True):
        if not np.isfinite(value):
            raise Problem(f"{v.name} is {value:g} at t = {time:.9g} s, expected a finite number")
    return np.concatenate([y, require])


def _after_steps(user: UserModel, x: Array, time: float, step: float) -> tuple[Array, Array]:
    """States after some steps, and all other values."""
    _, u, p = user.start_values
    values = np.empty(0)
    for k in range(STEPS):
        x = user.advance(x, u[None], p, time + k * step, step)
        values = _values(user, x, time + (k + 1) * step)
    return x, values


def _check_dependencies(user: UserModel, start: Array) -> None:
    """Outputs and computed states must not change with inputs that `depends` does not list for them."""
    model, interface = user.model, user.interface
    p = user.start_values[2]
    states = [i for i, v in enumerate(interface.states) if v.kind == "CALCULATED_STATE"]
    functions: list[tuple[list[str], Callable[[Array, Array], Array]]] = [
        ([v.name for v in interface.outputs], lambda x, u: user.observe(x, u, p, 0.0)[0]),
        ([interface.states[i].name for i in states], lambda x, u: user.start(x, u, p)[states]),
    ]
    inputs = [v.name for v in interface.inputs]
    for (x, u), (names, function), (i, v) in product(
        list(_points(user, start)), functions, list(enumerate(interface.inputs))
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


def _points(user: UserModel, x: Array) -> Iterator[tuple[Array, Array]]:
    """States and inputs: the given and the start values, and random ones close to these."""
    rng, at, interface = np.random.default_rng(0), (x, user.start_values[1]), user.interface
    nominal = [np.array([v.quantity.nominal for v in g]) for g in (interface.states, interface.inputs)]
    yield at
    for _ in range(POINTS):
        near = [v + 0.1 * n * rng.uniform(-1, 1, v.size) for v, n in zip(at, nominal, strict=True)]
        yield near[0], near[1]
