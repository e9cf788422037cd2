"""What was identified, as the page shows it: parameters, a predicted recording, causes of its residual."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fmus.contract import quantities
from fmus.identification.estimate import Estimate
from fmus.identification.machine import Numbers, lookup, nominal, parameters, signals
from fmus.identification.pipeline import MACHINE, Identified
from fmus.identification.report.attribution import Explanation
from fmus.identification.report.identification_page import (
    IdentificationPage,
    IdentifiedParameter,
    refinement,
)
from fmus.identification.report.recording_comparison import Compared, attribute, picture, predicted
from fmus.identification.report.report_texts import warnings
from fmus.machine.parts import SUBSYSTEMS

PICTURED = ("swing", "stick", "boom")  # joints: Figs. 10 and 11 of the paper, and the third
KINDS = ("angle", "speed", "pressure", "flow")


def prediction(identified: Identified) -> Compared | None:
    """A recording of the machine and its prediction with the estimates: a held-out one if there is."""
    own = [r for r in identified.recordings if r.procedure == MACHINE]
    chosen = next((r for r in own if r.use == "test"), own[0] if own else None)
    return predicted(chosen, _of_usual_parts(identified.known)) if chosen else None


def worst_signals(compared: Compared) -> dict[str, tuple[str, float]]:
    """The signal of each kind that is predicted worst, and its NRMSE."""
    errors = compared.nrmse()
    own = {kind: {n: e for n, e in errors.items() if kind in n.split("_")} for kind in KINDS}
    return {kind: max(one.items(), key=lambda item: item[1]) for kind, one in own.items() if one}


def explanation(compared: Compared, identified: Identified) -> Explanation | None:
    """Which effect the residual shows; the fitted parameters may take what they can."""
    if identified.refined is None:
        return None
    fitted = [name for name, (_, procedure) in identified.estimates.items() if procedure == MACHINE]
    return attribute(compared, _of_usual_parts(identified.known), fitted)


def content(
    folder: Path,
    out: Path,
    identified: Identified,
    compared: Compared | None,
    qualities: Sequence[Mapping[str, Any]] = (),
) -> IdentificationPage:
    """Everything that the page shows.

    folder, out   where the recordings are, where the parameters are written
    compared      the result of `prediction`
    """
    refined = identified.refined
    joints = PICTURED if compared else ()
    return IdentificationPage(
        title=f"Identification from {folder.name}",
        source=str(folder),
        kinds=tuple(dict.fromkeys(r.kind for r in identified.recordings)),
        findings=tuple(identified.findings),
        parameters=tuple(_parameter(e, procedure) for e, procedure in identified.estimates.values()),
        qualities=tuple(qualities),
        refinement=refinement(refined, parameters(), signals(), starts=identified.starts)
        if refined
        else None,
        explanation=explanation(compared, identified) if compared else None,
        pictures=tuple(
            picture(compared, joint)
            for joint in joints
            if compared and np.ptp(compared.predicted[f"manipulator.{joint}_angle"]) > 0.01
        ),
        commands=_commands(folder, out, identified),
        remarks=tuple(f"{name}: {why}." for name, why in identified.skipped.items()),
        warnings=tuple(warnings(refined, parameters(), signals())) if refined else (),
    )


def _of_usual_parts(known: Numbers) -> dict[str, float]:
    """A variant keeps its own numbers."""
    own = {f"{part}.{name}" for part, sub in SUBSYSTEMS.items() for name in quantities(sub.parameters)}
    return {name: number.value for name, number in known.items() if name in own}


def _parameter(estimate: Estimate, procedure: str) -> IdentifiedParameter:
    before = lookup(estimate.name, nominal())
    name = estimate.name.rpartition(".")[2]
    text = next(q[name].text for s in SUBSYSTEMS.values() if name in (q := quantities(s.parameters)))
    return IdentifiedParameter(estimate, procedure, before.value, before.source, text)


def _commands(folder: Path, out: Path, identified: Identified) -> dict[str, str]:
    """How to go on."""
    commands = {f"harvester build --parameters {out}": "FMUs with these numbers"}
    held_out = [r for r in identified.recordings if r.procedure == MACHINE and r.use == "test"]
    for recording in held_out[:1]:
        supply = ' --play "*.supply_pressure"' if "swing.supply_pressure" in recording.signals else ""
        command = f"harvester validate --reference {folder / recording.source.name}{supply}"
        commands[command] = "their run against the recording that was held out"
    return commands
