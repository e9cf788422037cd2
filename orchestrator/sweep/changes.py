"""What differs between two fingerprints of studies, as the file of a study names it."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any

from orchestrator.sweep.fields import quoted

LONG = 120  # characters of two lists
NAMES = ("name", "what")  # keys that name an item of a list
INNER = ("numbers", "options")  # keys that the file of a study does not have
DECIDES = ("distribution", "signal", "measure")  # keys that the rest of an item follows from


def changes(old: Mapping[str, Any], new: Mapping[str, Any]) -> str:
    """The first difference of two fingerprints and how many others there are; empty if there is none."""
    found = list(_differences("", old["study"], new["study"]))
    if not found:
        files = dict.fromkeys([*old["files"], *new["files"]])
        found = [f"{f} changed" for f in files if old["files"].get(f) != new["files"].get(f)]
    more = f", and {len(found) - 1} more changed" if len(found) > 1 else ""
    return f"{found[0]}{more}" if found else ""


def _differences(where: str, old: Any, new: Any, unit: str = "") -> Iterator[str]:
    """In the order of the study; where: what is compared, such as `factors."supply.pressure_setting"`."""
    before, after = _items(old), _items(new)
    if before is None or after is None:
        yield _told(where, old, new, unit)
        return
    for key in dict.fromkeys([*before, *after]):
        if before.get(key) == after.get(key):
            continue
        inner = where if key in INNER else f"{where}.{quoted(key)}".lstrip(".")
        if key not in after:
            yield f"{inner} is no longer there"
        elif key not in before:
            yield f"{inner} is new"
        else:
            yield from _differences(inner, before[key], after[key], unit or _unit(key, before, after))
        if key in DECIDES:
            return
    if list(before) != list(after) and set(before) == set(after):
        yield f"the order of {where} was {', '.join(before)}, is {', '.join(after)}"


def _items(value: Any) -> Mapping[str, Any] | None:
    """A table, or a list of named items by their names; none of what has no parts with a name."""
    if isinstance(value, Mapping):
        return value
    for key in NAMES if isinstance(value, list) else ():
        if all(isinstance(item, Mapping) and key in item for item in value):
            return {item[key]: item for item in value}
    return None


def _unit(key: str, old: Mapping[str, Any], new: Mapping[str, Any]) -> str:
    """Of the numbers of a factor; shares have none."""
    plain = key == "numbers" and not new["relative"] and old["unit"] == new["unit"]
    return str(new["unit"]) if plain else ""


def _told(where: str, old: Any, new: Any, unit: str) -> str:
    """Two values; of a long list the first item that differs."""
    if isinstance(old, list) and isinstance(new, list) and len(json.dumps([old, new])) > LONG:
        if len(old) != len(new):
            return f"{where} had {len(old)} items, has {len(new)}"
        place = next(i for i, pair in enumerate(zip(old, new, strict=True)) if pair[0] != pair[1])
        return _told(f"{where}[{place}]", old[place], new[place], unit)
    was, now = (f"{json.dumps(value).removesuffix('.0')} {unit}".rstrip() for value in (old, new))
    return f"{where} was {was}, is {now}"
