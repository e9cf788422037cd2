"""What was identified, as the page shows it: parameters, a prediction beside its recording, its residual."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fmus.contract import quantities
from fmus.identification.known import Estimate, Known, lookup, nominal
from fmus.identification.pipeline import MACHINE, Identified
from fmus.identification.refinement.problem import parameters, signals
from fmus.identification.report.attribution import Explanation
from fmus.identification.report.comparison import Compared, Picture, attribute, picture, predicted
from fmus.identification.report.identification_page import (
    IdentificationPage,
    IdentifiedParameter,
    refinement,
)
from fmus.identification.report.wording import warnings
from fmus.machine.parts import SUBSYSTEMS
from orchestrator.data.recording import Recording

PICTURED = ("swing", "stick", "boom")  # joints: Figs. 10 and 11 of the paper, and the third
KINDS = ("angle", "speed", "pressure", "flow")


def beside(found: Identified) -> Compared | None:
    """A recording of the machine beside its prediction with the numbers found: a held-out one if there is."""
    own = [r for r in found.recordings if r.procedure == MACHINE]
    chosen = next((r for r in own if r.use == "test"), own[0] if own else None)
    return predicted(chosen, _numbers(found.known)) if chosen else None


def worst(seen: Compared) -> dict[str, tuple[str, float]]:
    """The signal of each kind that is predicted worst, and its NRMSE."""
    errors = seen.nrmse()
    own = {kind: {n: e for n, e in errors.items() if kind in n.split("_")} for kind in KINDS}
    return {kind: max(one.items(), key=lambda item: item[1]) for kind, one in own.items() if one}


def content(
    folder: Path,
    out: Path,
    found: Identified,
    shown: Compared | None,
    qualities: Sequence[Mapping[str, Any]] = (),
) -> IdentificationPage:
    """Everything that the page shows.

    folder, out   where the recordings are, where the parameters are written
    shown         what `beside` gives
    """
    return IdentificationPage(
        title=f"Identification from {folder.name}",
        source=str(folder),
        kinds=tuple(dict.fromkeys(r.kind for r in found.recordings)),
        findings=found.findings,
        parameters=tuple(_parameter(e, procedure) for e, procedure in found.estimates.values()),
        qualities=tuple(qualities),
        refinement=_refinement(found),
        explanation=explanation(shown, found) if shown else None,
        pictures=tuple(_pictures(shown)) if shown else (),
        commands=_commands(folder, out, found.recordings),
        remarks=tuple(f"{name}: {why}." for name, why in found.skipped.items()),
        warnings=tuple(warnings(found.refined, parameters(), signals())) if found.refined else (),
    )


def _numbers(known: Known) -> dict[str, float]:
    """Of the usual parts only: a variant keeps its own."""
    own = {f"{part}.{name}" for part, sub in SUBSYSTEMS.items() for name in quantities(sub.parameters)}
    return {name: number.value for name, number in known.items() if name in own}


def _parameter(estimate: Estimate, procedure: str) -> IdentifiedParameter:
    before = lookup(estimate.name, nominal())
    name = estimate.name.rpartition(".")[2]
    text = next(q[name].text for s in SUBSYSTEMS.values() if name in (q := quantities(s.parameters)))
    return IdentifiedParameter(estimate, procedure, before.value, before.source, text)


def _refinement(found: Identified) -> dict[str, Any] | None:
    if found.refined is None:
        return None
    return refinement(found.refined, parameters(), signals(), starts=found.starts)


def explanation(seen: Compared, found: Identified) -> Explanation | None:
    """Which effect the residual shows; the fitted parameters may take what they can."""
    if found.refined is None:
        return None
    fitted = [name for name, (_, procedure) in found.estimates.items() if procedure == MACHINE]
    return attribute(seen, _numbers(found.known), fitted)


def _pictures(seen: Compared) -> list[Picture]:
    moved = [j for j in PICTURED if np.ptp(seen.predicted[f"manipulator.{j}_angle"]) > 0.01]
    return [picture(seen, joint) for joint in moved]


def _commands(folder: Path, out: Path, recordings: Sequence[Recording]) -> dict[str, str]:
    """How to go on."""
    told = {f"harvester build --parameters {out}": "FMUs with these numbers"}
    held_out = [r for r in recordings if r.procedure == MACHINE and r.use == "test"]
    for recording in held_out[:1]:
        supply = ' --play "*.supply_pressure"' if "swing.supply_pressure" in recording.signals else ""
        command = f"harvester validate --reference {folder / recording.source.name}{supply}"
        told[command] = "their run against the recording that was held out"
    return told
