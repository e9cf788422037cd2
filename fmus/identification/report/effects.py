"""What each effect that a variant of a part has would change in the signals of the identified machine.

    d_k(t) = y(t; variant k, identified numbers) - y(t; the usual machine, identified numbers)

`attribution` compares these changes with a residual.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from fmus.identification.report.prediction import Array, Drive, Signals, predict

# effect -> the variants that have it
EFFECTS: Mapping[str, Mapping[str, str]] = {
    "swinging head": {"manipulator": "pendulum"},
    "dry friction": {"manipulator": "friction"},
    "hose walls, air and spools of boom and stick": {"boom_stick": "detailed"},
    "hose walls, air and spool of the swing": {"swing": "detailed"},
    "pump and engine": {"supply": "engine_pump"},
}
STEP = 1e-3  # relative, of finite differences: errors of the solver are 1e5 times smaller


def changes(
    given: Drive, numbers: Mapping[str, float], names: Iterable[str] = EFFECTS
) -> dict[str, dict[str, Array]]:
    """What each effect would change in every signal of the machine."""
    usual = predict(given, numbers)
    return {name: _difference(predict(given, numbers, EFFECTS[name]), usual) for name in names}


def slopes(given: Drive, numbers: Mapping[str, float], names: Iterable[str]) -> dict[str, dict[str, Array]]:
    """What each parameter would change, by finite differences: one `STEP` of its value."""
    usual = predict(given, numbers)
    return {
        name: _difference(predict(given, {**numbers, name: numbers[name] * (1 + STEP)}), usual)
        for name in names
        if numbers[name]
    }


def _difference(one: Signals, other: Signals) -> dict[str, Array]:
    return {name: one[name] - other[name] for name in other if name in one}
