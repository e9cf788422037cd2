"""What determines the results of a study, so that runs of two studies are never mixed."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np
import pandas as pd

from orchestrator.sweep.packet import Packet, digest
from orchestrator.sweep.study import Choice, Factor, Output, Study


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
