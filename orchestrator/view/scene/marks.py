"""The targets of a task as rings in space: what is next is strong, what is done is gone."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

NEXT, LATER = "#d55e00", "#0072b2"  # Okabe and Ito: told apart with every kind of colour blindness

Point3 = tuple[float, float, float]


def rings(targets: Sequence[Point3], radius: float, done: int) -> list[dict[str, Any]]:
    """For the browser: the targets that are left, in their order; `done` are not shown any more."""
    left = list(targets)[done:]
    return [
        {"at": list(at), "radius": radius, "colour": LATER if k else NEXT, "strong": k == 0}
        for k, at in enumerate(left)
    ]
