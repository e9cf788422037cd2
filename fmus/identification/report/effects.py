"""What each effect that a variant of a part has would change in the signals of the identified machine.

    d_k(t) = y(t; variant k, identified numbers) - y(t; the usual machine, identified numbers)

`attribution` compares these changes with a residual.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from fmus.contract import ModelError
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


def shown(given: Drive) -> dict[str, Mapping[str, str]]:
    """The effects that a prediction can miss: where the supply pressure was measured, its cause is in it."""
    measured = given.supply_pressure is not None
    return {name: swap for name, swap in EFFECTS.items() if not (measured and "supply" in swap)}


def changes(given: Drive, numbers: Mapping[str, float]) -> dict[str, dict[str, Array]]:
    """What each effect would change in every signal of the machine."""
    usual = predict(given, numbers)
    return {name: _difference(predict(given, numbers, swap), usual) for name, swap in shown(given).items()}


def slopes(given: Drive, numbers: Mapping[str, float], names: Iterable[str]) -> dict[str, dict[str, Array]]:
    """What each parameter would change, by finite differences: one `STEP` of its value.

    A name without its part means the numbers of all parts that have it.
    """
    usual = predict(given, numbers)
    return {name: _difference(predict(given, _moved(numbers, name)), usual) for name in names}


def _moved(numbers: Mapping[str, float], name: str) -> dict[str, float]:
    own = [key for key in numbers if name in (key, key.partition(".")[2])]
    if not own:
        raise ModelError(f"{name}: expected its number among those of the machine")
    return {key: value * (1 + STEP) if key in own else value for key, value in numbers.items()}


def _difference(one: Signals, other: Signals) -> dict[str, Array]:
    return {name: one[name] - other[name] for name in other if name in one}
