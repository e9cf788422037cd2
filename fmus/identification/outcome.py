"""Content of the report on an identification: parameters, a predicted recording, causes of its residual."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from fmus.contract import quantities
from fmus.identification.estimate import Estimate
from fmus.identification.finding import named
from fmus.identification.machine import (
    COMMANDS,
    Parameters,
    lookup,
    nominal,
    parameter_names,
    signal_names,
    zero_sentences,
    zeros,
)
from fmus.identification.pipeline import NO_RECORDING, Identified
from fmus.identification.recording_names import MACHINE
from fmus.identification.recordings.reading import Extrapolation, extrapolations
from fmus.identification.report.attribution import Explanation
from fmus.identification.report.identification_page import refinement
from fmus.identification.report.prediction import excitation, predict
from fmus.identification.report.recording_comparison import (
    CaptionedFigure,
    RecordingComparison,
    attribute,
    captioned_figure,
    compare,
)
from fmus.identification.report.report_texts import warnings
from fmus.machine.parts import INPUTS, SUBSYSTEMS

FIGURES = ("swing", "stick", "boom")  # joints: Figs. 10 and 11 of the paper, and the third joint
QUANTITIES = ("angle", "speed", "pressure", "flow")
MOVES = 0.01  # rad, angular range above which a joint is shown


def prediction(identified: Identified) -> RecordingComparison | None:
    """A recording of the machine and its prediction with the estimates; a held-out one if possible."""
    recordings = [r for r in identified.recordings if r.procedure == MACHINE]
    selected = next((r for r in recordings if r.use == "test"), recordings[0] if recordings else None)
    if selected is None:
        return None
    predicted = predict(excitation(selected), _of_default_parts(identified.parameters))
    if (refined := identified.refined) is None:
        return compare(selected, predicted)
    simulated = (refined.held_out if selected.use == "test" else refined.training)[0]
    names, found = [signal_names()[output] for output in refined.problem.outputs], zeros(refined)
    by_z, sd = refined.uncertainty(simulated.run)
    if np.isfinite(simulated.y).all():  # with all corners of the inputs; its readings contain the zeros
        predicted = {**predicted, **dict(zip(names, simulated.y.T, strict=True))}
        predicted |= {name: predicted[name] - zero.value for name, zero in found.items()}
    return replace(
        compare(selected, predicted),
        sd=dict(zip(names, sd.T, strict=True)),
        sensitivities={
            parameter: dict(zip(names, by_z[:, :, j].T, strict=True))
            for j, parameter in enumerate(refined.problem.names)
        },
    )


def extrapolated(identified: Identified) -> list[tuple[str, Extrapolation]]:
    """Inputs of the held-out recordings of the machine that leave their ranges in training, with the file."""
    training = [r for r in identified.recordings if r.use == "train"]
    inputs = [targets[0] for targets in INPUTS.values()]
    ranges = {n: [r[n] for r in training if n in r.signals] for n in inputs}
    valves = [r["command"] for r in training if r.procedure == "valve" and "command" in r.signals]
    for name in COMMANDS.values():  # a bench shows an edge, and the machine has the same for the other sign
        ranges[name] += [sign * volts for volts in valves for sign in (1, -1)]
    known = {n: np.concatenate(values) for n, values in ranges.items() if values}
    return [
        (recording.source.name, found)
        for recording in identified.recordings
        if recording.procedure == MACHINE and recording.use == "test"
        for found in extrapolations(recording, known, known)
    ]


def worst_signals(comparison: RecordingComparison) -> dict[str, tuple[str, float]]:
    """The signal with the largest NRMSE of each quantity, and its NRMSE."""
    errors = comparison.nrmse()
    by_quantity = {q: {n: e for n, e in errors.items() if q in n.split("_")} for q in QUANTITIES}
    return {q: max(e.items(), key=lambda item: item[1]) for q, e in by_quantity.items() if e}


def explanation(
    comparison: RecordingComparison, identified: Identified, processes: int = 1
) -> Explanation | None:
    """Which effect the residual shows, apart from errors of the identified parameters.

    processes   number of processes that simulate the machine, which take most of the time
    """
    if identified.refined is None:
        return None
    return attribute(comparison, _of_default_parts(identified.parameters), processes)


def page_content(
    folder: Path,
    out: Path,
    identified: Identified,
    comparison: RecordingComparison | None,
    qualities: Sequence[Mapping[str, Any]] = (),
    processes: int = 1,
) -> dict[str, Any]:
    """The content of the report: the values of the JSON file, and `figures` of the predicted signals.

    folder       folder of the recordings
    out          file of the estimated parameters
    comparison   result of `prediction`
    processes    see `explanation`
    """
    names, signals, refined = parameter_names(), signal_names(), identified.refined
    figures, outside = list[CaptionedFigure](), extrapolated(identified)
    if comparison:
        predicted = comparison.predicted
        moving = [j for j in FIGURES if np.ptp(predicted[f"manipulator.{j}_angle"]) > MOVES]
        figures = [captioned_figure(comparison, joint) for joint in moving]
    return {
        "title": f"Identification from {folder.name}",
        "source": str(folder),
        "kinds": list(dict.fromkeys(r.kind for r in identified.recordings)),
        "results": identified.results,
        "parameters": [_parameter(e, procedure) for e, procedure in identified.estimates.values()],
        "qualities": qualities,
        "refinement": refinement(refined, names, signals, starts=identified.starts) if refined else None,
        "explanation": explanation(comparison, identified, processes) if comparison else None,
        "figures": figures,
        "commands": _next_commands(folder, out, identified),
        "remarks": [
            *(f"{name}: {reason}." for name, reason in identified.skipped.items() if reason == NO_RECORDING),
            *(f"{sentence}." for sentence in (zero_sentences(refined) if refined else ())),
            *map(extrapolation_text, outside),
        ],
        "findings": tests(identified),
        "prediction": _prediction(comparison, outside) if comparison else None,
        "warnings": [
            *(f"{name}: {why}." for name, why in identified.skipped.items() if why != NO_RECORDING),
            *(warning for result in identified.results for warning in result.warnings),
            *(warnings(refined, names, signals) if refined else ()),
        ],
    }


def extrapolation_text(outside: tuple[str, Extrapolation]) -> str:
    """A sentence on an input outside its range in training: the prediction is doubtful, not the estimates."""
    file, found = outside
    return f"{file}: {found}: its prediction is an extrapolation, which the bands do not cover."


def _prediction(
    comparison: RecordingComparison, outside: Sequence[tuple[str, Extrapolation]]
) -> dict[str, Any]:
    """The predicted recording for the JSON file: NRMSE, share in the 95 % bands, inputs outside training."""
    recording = comparison.recording
    return {
        "recording": recording.source.name,
        "use": recording.use,
        "nrmse": comparison.nrmse(),
        "held": comparison.held(),
        "extrapolated": [{"recording": file, **vars(found)} for file, found in outside],
    }


def tests(identified: Identified) -> list[dict[str, Any]]:
    """The tests of all assumptions: procedure, fault, p, sentence, and whether the data show the fault."""
    found = named(finding for _, finding in identified.findings)
    return [{"procedure": name, **vars(f), "named": f in found} for name, f in identified.findings]


def _of_default_parts(parameters: Parameters) -> dict[str, float]:
    """Values of the parameters of the default parts; those of variants are left out."""
    names = {f"{part}.{name}" for part, sub in SUBSYSTEMS.items() for name in quantities(sub.parameters)}
    return {name: parameter.value for name, parameter in parameters.items() if name in names}


def _parameter(estimate: Estimate, procedure: str) -> dict[str, Any]:
    """An estimate with its procedure, and the value that the parameter files have."""
    known = lookup(estimate.name, nominal())
    name = estimate.name.rpartition(".")[2]
    text = next(q[name].text for s in SUBSYSTEMS.values() if name in (q := quantities(s.parameters)))
    before = {"prior": known.value, "prior_source": known.source}
    return {"estimate": estimate, "procedure": procedure, **before, "text": text}


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
