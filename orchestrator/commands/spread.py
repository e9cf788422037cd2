"""Commands that take options in groups, so that several can share a group."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, is_dataclass
from functools import wraps
from inspect import Parameter, Signature, signature
from typing import Any, get_type_hints


def spread(command: Callable[..., None]) -> Callable[..., None]:
    """The command with the fields of its groups, which are dataclasses, as parameters of their own."""
    hints = get_type_hints(command, include_extras=True)
    groups: dict[str, Any] = {name: kind for name, kind in hints.items() if is_dataclass(kind)}
    parameters: dict[str, Parameter] = {}
    for name, parameter in signature(command).parameters.items():
        if name in groups:
            types = get_type_hints(groups[name], include_extras=True)
            for f in fields(groups[name]):
                parameters[f.name] = _parameter(f.name, f.default, types[f.name])
        else:
            parameters[name] = _parameter(name, parameter.default, hints[name])

    @wraps(command)
    def told(**values: Any) -> None:
        for name, kind in groups.items():
            values[name] = kind(**{f.name: values.pop(f.name) for f in fields(kind)})
        command(**values)

    told.__signature__ = Signature(list(parameters.values()))  # type: ignore[attr-defined]
    told.__annotations__ = {name: p.annotation for name, p in parameters.items()}
    return told


def _parameter(name: str, default: Any, kind: Any) -> Parameter:
    return Parameter(name, Parameter.KEYWORD_ONLY, default=default, annotation=kind)
