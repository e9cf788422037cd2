"""Checks of a user's model when its FMU is built: a few steps, saved states, declared dependencies."""

from collections.abc import Callable, Iterator
from itertools import product
from pathlib import Path

import numpy as np

from fmus.export.interface import Interface
from fmus.export.python.instance import Instance
from fmus.export.python.user_model import Array, UserModel, in_file, load, structure
from orchestrator.base.errors import Problem

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
