"""Content of the report on an identification: parameters, a predicted recording, causes of its residual."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fmus.contract import quantities
from fmus.identification.estimate import Estimate
from fmus.identification.finding import named
from fmus.identification.machine import (
    Parameters,
    lookup,
    nominal,
    parameter_names,
    signal_names,
    zero_sentences,
)
from fmus.identification.pipeline import NO_RECORDING, Identified
from fmus.identification.recording_names import MACHINE
from fmus.identification.report.attribution import Explanation
from fmus.identification.report.identification_page import IdentificationPage, IdentifiedParameter, refinement
from fmus.identification.report.recording_comparison import (
    CaptionedFigure,
    RecordingComparison,
    attribute,
    captioned_figure,
    compare_prediction,
)
from fmus.identification.report.report_texts import warnings
from fmus.machine.parts import SUBSYSTEMS

FIGURES = ("swing", "stick", "boom")  # joints: Figs. 10 and 11 of the paper, and the third joint
QUANTITIES = ("angle", "speed", "pressure", "flow")
MOVES = 0.01  # rad, angular range above which a joint is shown


def prediction(identified: Identified) -> RecordingComparison | None:
    """A recording of the machine and its prediction with the estimates; a held-out one if possible."""
    recordings = [r for r in identified.recordings if r.procedure == MACHINE]
    selected = next((r for r in recordings if r.use == "test"), recordings[0] if recordings else None)
    return compare_prediction(selected, _of_default_parts(identified.parameters)) if selected else None


def worst_signals(comparison: RecordingComparison) -> dict[str, tuple[str, float]]:
    """The signal with the largest NRMSE of each quantity, and its NRMSE."""
    errors = comparison.nrmse()
    by_quantity = {q: {n: e for n, e in errors.items() if q in n.split("_")} for q in QUANTITIES}
    return {q: max(e.items(), key=lambda item: item[1]) for q, e in by_quantity.items() if e}


def explanation(
    comparison: RecordingComparison, identified: Identified, processes: int = 1
) -> Explanation | None:
    """Which effect the residual shows, apart from errors of the refined parameters.

    processes   number of processes that simulate the machine, which take most of the time
    """
    if identified.refined is None:
        return None
    refined = [name for name, (_, procedure) in identified.estimates.items() if procedure == MACHINE]
    return attribute(comparison, _of_default_parts(identified.parameters), refined, processes)


def page_content(
    folder: Path,
    out: Path,
    identified: Identified,
    comparison: RecordingComparison | None,
    qualities: Sequence[Mapping[str, Any]] = (),
    processes: int = 1,
) -> IdentificationPage:
    """The content of the report.

    folder       folder of the recordings
    out          file of the estimated parameters
    comparison   result of `prediction`
    processes    see `explanation`
    """
    names, signals, refined = parameter_names(), signal_names(), identified.refined
    figures: list[CaptionedFigure] = []
    if comparison:
        predicted = comparison.predicted
        moving = [j for j in FIGURES if np.ptp(predicted[f"manipulator.{j}_angle"]) > MOVES]
        figures = [captioned_figure(comparison, joint) for joint in moving]
    return IdentificationPage(
        title=f"Identification from {folder.name}",
        source=str(folder),
        kinds=tuple(dict.fromkeys(r.kind for r in identified.recordings)),
        results=tuple(identified.results),
        parameters=tuple(_parameter(e, procedure) for e, procedure in identified.estimates.values()),
        qualities=tuple(qualities),
        refinement=refinement(refined, names, signals, starts=identified.starts) if refined else None,
        explanation=explanation(comparison, identified, processes) if comparison else None,
        figures=tuple(figures),
        commands=_next_commands(folder, out, identified),
        remarks=(
            *(f"{name}: {reason}." for name, reason in identified.skipped.items() if reason == NO_RECORDING),
            *(f"{sentence}." for sentence in (zero_sentences(refined) if refined else ())),
        ),
        findings=tuple(tests(identified)),
        warnings=(
            *(f"{name}: {why}." for name, why in identified.skipped.items() if why != NO_RECORDING),
            *(warning for result in identified.results for warning in result.warnings),
            *(warnings(refined, names, signals) if refined else ()),
        ),
    )


def tests(identified: Identified) -> list[dict[str, Any]]:
    """The tests of all assumptions: procedure, fault, p, sentence, and whether the data show the fault."""
    found = named(finding for _, finding in identified.findings)
    return [{"procedure": name, **vars(f), "named": f in found} for name, f in identified.findings]


def _of_default_parts(parameters: Parameters) -> dict[str, float]:
    """Values of the parameters of the default parts; those of variants are left out."""
    names = {f"{part}.{name}" for part, sub in SUBSYSTEMS.items() for name in quantities(sub.parameters)}
    return {name: parameter.value for name, parameter in parameters.items() if name in names}


def _parameter(estimate: Estimate, procedure: str) -> IdentifiedParameter:
    known = lookup(estimate.name, nominal())
    name = estimate.name.rpartition(".")[2]
    text = next(q[name].text for s in SUBSYSTEMS.values() if name in (q := quantities(s.parameters)))
    return IdentifiedParameter(estimate, procedure, known.value, known.source, text)


def _next_commands(folder: Path, out: Path, identified: Identified) -> dict[str, str]:
    """Commands that use the estimates -> their purpose."""
    commands = {f"harvester build --parameters {out}": "FMUs with these parameters"}
    held_out = [r for r in identified.recordings if r.procedure == MACHINE and r.use == "test"]
    for recording in held_out[:1]:
        lines = [n for n in ("supply", "tank") if f"swing.{n}_pressure" in recording.signals]
        play = "".join(f' --play "*.{line}_pressure"' for line in lines)
        command = f"harvester validate --reference {folder / recording.source.name}{play}"
        commands[command] = "Validation of these FMUs against the held-out recording"
    return commands
