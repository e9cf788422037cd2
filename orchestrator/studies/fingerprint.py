"""What determines the results of a study, so that runs of two studies are never mixed.

What differs between two fingerprints of studies, as the file of a study names it.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from typing import Any

import numpy as np
import pandas as pd

from orchestrator.base.toml import quoted
from orchestrator.studies.study import Choice, Factor, Output, Study
from orchestrator.studies.worker import Packet, digest


def fingerprint(packet: Packet, table: pd.DataFrame) -> dict[str, Any]:
    """The study, and digests of the files that it names and of its samples; for JSON."""
    files = {}
    for options, case in packet.cases.items():
        for name, component in case.system.components.items():
            if component.source is not None:
                label = f"the FMU of {name}{_chosen(packet.study, options, name)}"
                files[label] = packet.sources[component.source]
            starts = repr(sorted(component.start.items())).encode()
            files[f"the start values of {name}{_among(packet.study, options)}"] = digest(starts)
        if case.scenario is not None:
            signals = (np.ascontiguousarray(v).tobytes() for v in case.scenario.signals.values())
            data = (
                "\n".join(case.scenario.signals).encode() + case.scenario.time.tobytes() + b"".join(signals)
            )
            files[f"the scenario{_chosen(packet.study, options, 'scenario')}"] = digest(data)
        wires = repr((case.system.connections, case.system.coupling, case.system.step)).encode()
        files[f"the connections{_among(packet.study, options)}"] = digest(wires)
    samples = digest(table.to_csv(float_format="%.17g").encode())
    return {"study": told(packet.study), "files": {**files, "the samples": samples}}


def told(study: Study) -> dict[str, Any]:
    """A study for JSON, without what does not change its results."""
    found = asdict(study)
    del found["folder"], found["title"]
    plain: dict[str, Any] = json.loads(json.dumps(found))
    return plain


def study(found: Mapping[str, Any], title: str) -> Study:
    """The study that `told` has told."""
    known = dict(found)
    known["factors"] = tuple(
        Factor(
            **{**f, "numbers": {k: tuple(v) if isinstance(v, list) else v for k, v in f["numbers"].items()}}
        )
        for f in known["factors"]
    )
    known["choices"] = tuple(Choice(**{**c, "options": tuple(c["options"])}) for c in known["choices"])
    known["outputs"] = tuple(Output(**o) for o in known["outputs"])
    return Study(title=title, **known)


def _chosen(study: Study, options: tuple[str, ...], what: str) -> str:
    """Which option of one choice, if there is such a choice."""
    found = [o for c, o in zip(study.choices, options, strict=True) if c.what == what]
    return f" {found[0]}" if found else ""


def _among(study: Study, options: tuple[str, ...]) -> str:
    """Which options of all choices."""
    each = (f"{c.what}={o}" for c, o in zip(study.choices, options, strict=True))
    return f" with {', '.join(each)}" if study.choices else ""


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
