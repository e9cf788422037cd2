"""Report of an identification: one self-contained HTML file, and a JSON file with the same values."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from fmus.contract import quantities
from fmus.identification.machine import lookup, nominal, sensor_sentences
from fmus.identification.pipeline import NO_RECORDING, Identified
from fmus.identification.recordings.quality import Quality
from fmus.identification.refinement.refine import RefinementResult, advice
from fmus.identification.report import figures, prediction, report_texts
from fmus.identification.report.attribution import attribute
from fmus.identification.results import Estimate, named
from fmus.machine.parts import FERIC
from orchestrator.base.signals import rms
from orchestrator.pages import html_page
from orchestrator.pages.figures import plot
from orchestrator.pages.plotting import embed

TEMPLATE = Path(__file__).parent / "templates" / "identification.html.j2"
NAME = "identification"
MOVES = 0.01  # rad, angular range above which a joint is shown


def write_page(folder: Path, page: Mapping[str, Any]) -> tuple[Path, Path]:
    """Write identification.html and identification.json to a folder; returns both paths.

    page   result of `page_content`

    The JSON file has all values of the page in SI units, without the curves of the figures.
    """
    results = [{n: value for n, value in vars(r).items() if n != "panels"} for r in page["results"]]
    qualities = [
        {n: value for n, value in vars(q).items() if n not in ("clock", "notes")}
        | {"remarks": q.clock, "faults": len(q.faults())}
        for q in page["qualities"]
    ]
    values = {**page, "results": results, "qualities": qualities}
    del values["figures"]
    html = html_page.write_text(folder / f"{NAME}.html", render(page))
    return html, html_page.write_json(folder / f"{NAME}.json", values)


def render(page: Mapping[str, Any]) -> str:
    """The HTML file as text."""
    joint, kinds, heatmap = page["refinement"], page["kinds"], None
    if joint and len(joint["names"]) > 1:
        heatmap = embed(figures.draw_correlation(joint["names"], joint["correlation"]), "c-", "Correlation")
    results = []
    for k, result in enumerate(page["results"]):
        if (tables := figures.opening_panel(result.listed)) is not None:
            result = replace(result, panels=(*result.panels, tables))
        figure = figures.draw_procedure(result, kinds, titled=False) if result.panels else None
        drawing = figure and embed(figure, f"f{k}-", result.title)
        results.append((result, drawing, report_texts.caption(result, kinds)))
    return html_page.render(
        TEMPLATE,
        title=page["title"],
        page=page,
        texts=report_texts,
        origin=report_texts.origin(kinds),
        results=results,
        faults=sum(len(q.faults()) for q in page["qualities"]),
        heatmap=heatmap,
        picture=figures.estimates_picture(page["parameters"]),
        figures=[(name, plot(replace(f, title=""), name), caption) for name, f, caption in page["figures"]],
        plots=bool(page["figures"]),
    )


def page_content(
    folder: Path,
    out: Path,
    identified: Identified,
    comparison: prediction.RecordingComparison | None,
    qualities: Sequence[Quality] = (),
    processes: int = 1,
) -> dict[str, Any]:
    """The content of the report: the values of the JSON file, and `figures` of the predicted signals.

    folder       folder of the recordings
    out          file of the estimated parameters
    comparison   result of `prediction`
    processes    number of processes that simulate the effects
    """
    refined, outside, tests = identified.refined, prediction.extrapolated(identified), identified.findings
    shown = named(finding for _, finding in tests)
    missing = [name for name, reason in identified.skipped.items() if reason == NO_RECORDING]
    explanation = None
    if comparison and refined:
        explanation = attribute(comparison, prediction.default_values(identified), processes)
    return {
        "title": f"Identification from {folder.name}",
        "source": str(folder),
        "kinds": list(dict.fromkeys(r.kind for r in identified.recordings)),
        "results": identified.results,
        "parameters": [_parameter(e, procedure) for e, procedure in identified.estimates.values()],
        "qualities": qualities,
        "refinement": refinement(refined) if refined else None,
        "explanation": explanation,
        "figures": list(_joints(comparison)) if comparison else [],
        "commands": _next_commands(folder, out, identified),
        "remarks": [
            *([f"No recording of {', '.join(missing)}."] if missing else ()),
            *(f"{sentence}." for sentence in (sensor_sentences(refined) if refined else ())),
            *(found.doubt() for found in outside),
        ],
        "findings": [{"procedure": name, **vars(f), "named": f in shown} for name, f in tests],
        "prediction": comparison
        and {
            "recording": comparison.recording.source.name,
            "use": comparison.recording.use,
            "nrmse": comparison.nrmse(),
            "held": comparison.held(),
            "extrapolated": outside,
        },
        "warnings": [
            *(f"{name}: {why}." for name, why in identified.skipped.items() if why != NO_RECORDING),
            *(report_texts.warnings(refined) if refined else ()),
        ],
    }


def _joints(comparison: prediction.RecordingComparison) -> Iterator[tuple[str, Any, str]]:
    """Title, figure and caption of each joint that moves."""
    for joint, number in figures.JOINT_FIGURES.items():
        if np.ptp(comparison.predicted[f"manipulator.{joint}_angle"]) > MOVES:
            caption = report_texts.joint_caption(comparison.recording, joint, number)
            yield joint.capitalize(), figures.joint_figure(comparison, joint), caption


def _parameter(estimate: Estimate, procedure: str) -> dict[str, Any]:
    """An estimate with its procedure, and the value that the parameter files have."""
    known = lookup(estimate.name, nominal())
    name = estimate.name.rpartition(".")[2]
    text = next(q[name].text for s in FERIC.subsystems.values() if name in (q := quantities(s.parameters)))
    before = {"prior": known.value, "prior_source": known.source}
    return {"estimate": estimate, "procedure": procedure, **before, "text": text}


def _next_commands(folder: Path, out: Path, identified: Identified) -> dict[str, str]:
    """Commands that use the estimates -> their purpose."""
    commands = {f"harvester build --parameters {out}": "FMUs with these parameters"}
    for recording in identified.of_machine("test")[:1]:
        played = [f' --play "*.{n}"' for n in prediction.LINES if f"swing.{n}" in recording.signals]
        command = f"harvester validate --reference {folder / recording.source.name}{''.join(played)}"
        commands[command] = "Validation of these FMUs against the held-out recording"
    return commands


def refinement(refined: RefinementResult) -> dict[str, Any]:
    """Content of the page and the JSON file for a refinement.

    `fits` has for each signal, None if there is no such recording:

    train, test   NRMSE
    noise         root mean square of the training residual in standard deviations of the sensor
    memory        fraction of the lags with a significant autocorrelation, 0.01 if the residual is white
    white         probability of this autocorrelation if the residual is white [Ljung and Box]
    inputs        largest such fraction for the cross-correlation with an earlier input
    """
    problem, fits = refined.problem, []
    for k, signal in enumerate(problem.signals):
        tests, fit = refined.whiteness[signal], dict[str, Any]()
        for use, traces in (("train", refined.training), ("test", refined.held_out)):
            relative = np.array([trace.nrmse()[k] for trace in traces])
            fit[use] = rms(relative[told]) if (told := np.isfinite(relative)).any() else None
        fit |= {"noise": tests.rms, "memory": tests.outside, "white": tests.ljung_box}
        fit["inputs"] = max(tests.inputs.values(), default=None)
        fits.append({"signal": signal, **html_page.json_values(fit)})
    scatter = "from the scatter between segments: residuals are correlated, which noise of sensors is not"
    noise = "from the noise of the sensors: residuals are uncorrelated"
    return {
        "names": [problem.label(name) for name in problem.names],
        "correlation": refined.statistics.correlation,
        "condition": refined.statistics.condition,
        "fits": fits,
        "unidentified": [f"{sentence}." for sentence in refined.unidentified],
        "facts": {
            "recordings": f"{len(problem.training)} for training, {problem.seconds:.0f} s; "
            f"{len(problem.held_out)} held out",
            "iterations": str(len(refined.history)),
            "ended": refined.reason,
            "95 % intervals": scatter if refined.robust else noise,
        },
        "remarks": [*advice(refined), *(f"{name} ended at its bound." for name in refined.at_bound)],
    }


def faults(qualities: Sequence[Quality]) -> Iterator[str]:
    """Lines on the faults of all recordings for a terminal; dead zones are summarised in one line."""
    for q in qualities:
        yield from (f"{q.name}: {fault}" for fault in q.faults())
    if dead := [(c.dead, q.name, c.signal) for q in qualities for c in q.channels if 0 < c.dead < 1]:
        fraction, name, signal = max(dead)
        files = len({file for _, file, _ in dead})
        yield (
            f"meters in their dead zones, where nothing is used: {files} recording{'s' * (files > 1)},"
            f" at most {100 * fraction:.2g} % of the samples ({name}: {signal})"
        )
