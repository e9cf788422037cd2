"""Where a `Subsystem` is found again on another machine, and whether it is still the same.

An origin is "module:name", or "module:name.key" for an entry of a mapping such as VARIANTS.
"""

from __future__ import annotations

import hashlib
import importlib
import sys
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from typing import Any

import casadi as ca

from fmus.contract import ModelError, Subsystem
from fmus.export.interface import Interface


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
        raise ModelError(
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
        raise ModelError(f'"{where}" is no name of a subsystem, expected one such as "package.module:NAME"')
    try:
        found = getattr(importlib.import_module(module), name)
        found = found[key] if key else found
    except (ImportError, AttributeError, KeyError, TypeError) as problem:
        raise ModelError(
            f"{where} is not in the Python of {sys.prefix}: {type(problem).__name__}: {problem}"
        ) from None
    if not isinstance(found, Subsystem):
        raise ModelError(f"{where} is {type(found).__name__}, expected a Subsystem")
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
