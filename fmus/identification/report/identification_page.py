"""Report of an identification: one self-contained HTML file, and a JSON file with the same values."""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from fmus.identification.recordings.clock import MAX_RATE, resample_uniformly
from fmus.identification.recordings.quality import examine
from fmus.identification.refinement.multistart import MultistartResult
from fmus.identification.refinement.refine import RefinementResult, advice
from fmus.identification.report import report_texts
from fmus.identification.report.attribution import rms
from fmus.identification.report.procedure_figures import draw_correlation, draw_procedure, opening_panel
from orchestrator.base import html_page
from orchestrator.base.figures import plot
from orchestrator.base.plotting import embed
from orchestrator.data.recording import Recording

TEMPLATE = Path(__file__).parent / "templates" / "identification.html.j2"
NAME = "identification"


def write_page(folder: Path, page: Mapping[str, Any]) -> tuple[Path, Path]:
    """Write identification.html and identification.json to a folder; returns both paths.

    page   result of `outcome.page_content`

    The JSON file has all values of the page in SI units, without the curves of the figures.
    """
    results = [{n: value for n, value in vars(r).items() if n != "panels"} for r in page["results"]]
    values = {name: value for name, value in page.items() if name != "figures"} | {"results": results}
    html = html_page.write_text(folder / f"{NAME}.html", render(page))
    return html, html_page.write_json(folder / f"{NAME}.json", values)


def render(page: Mapping[str, Any]) -> str:
    """The HTML file as text."""
    joint, kinds, heatmap = page["refinement"], page["kinds"], None
    if joint and len(joint["names"]) > 1:
        heatmap = embed(draw_correlation(joint["names"], joint["correlation"]), "c-", "Correlation")
    results = []
    for k, result in enumerate(page["results"]):
        if (tables := opening_panel(result.listed)) is not None:
            result = replace(result, panels=(*result.panels, tables))
        figure = draw_procedure(result, kinds, titled=False) if result.panels else None
        drawing = figure and embed(figure, f"f{k}-", result.title)
        results.append((result, drawing, report_texts.caption(result, kinds)))
    return html_page.render(
        TEMPLATE,
        title=page["title"],
        page=page,
        texts=report_texts,
        origin=report_texts.origin(kinds),
        results=results,
        heatmap=heatmap,
        figures=[(f, plot(replace(f.figure, title=""), f.title)) for f in page["figures"]],
        plots=bool(page["figures"]),
    )


def refinement(
    refined: RefinementResult,
    names: Mapping[str, str] | None = None,
    signals: Mapping[str, str] | None = None,
    starts: MultistartResult | None = None,
) -> dict[str, Any]:
    """Content of the page and the JSON file for a refinement.

    names, signals   parameter and output of the problem -> its name in the report
    starts           the refinement from random start points, on fewer samples

    Of the result, `fits` has for each signal, None if there is no such recording:

    train, test   NRMSE
    noise         root mean square of the training residual in standard deviations of the sensor
    memory        fraction of the lags with a significant autocorrelation, 0.01 if the residual is white
    white         probability of this autocorrelation if the residual is white [Ljung and Box]
    inputs        largest such fraction for the cross-correlation with an earlier input

    and `starts` for each search from a random start:

    away       root mean square distance of the start from the values before, relative changes of parameters
    apart      largest distance of the end from the result, in standard deviations; infinite if there is none
    residual   root mean square residual at the end, in standard deviations of the sensors
    same       whether the search led to the result, within a standard deviation
    joined     whether the search was ended on the path that leads to the result
    """
    names, signals, problem = names or {}, signals or {}, refined.problem
    seconds = sum(float(run.time[-1] - run.time[0]) for run in problem.training)
    scatter = "from the scatter between segments: residuals are correlated, which noise of sensors is not"
    noise = "from the noise of the sensors: residuals are uncorrelated"
    fits, rows = [], []
    for k, output in enumerate(problem.outputs):
        tests, errors = refined.whiteness[output], {}
        for use, traces in (("train", refined.training), ("test", refined.held_out)):
            relative = np.array([float(trace.nrmse()[k]) for trace in traces])
            errors[use] = rms(relative) if np.isfinite(relative).any() else None
        fit = errors | {"noise": tests.rms, "memory": tests.outside, "white": tests.ljung_box}
        fits.append(
            {"signal": signals.get(output, output), **{n: html_page.json_values(v) for n, v in fit.items()}}
        )
        fits[-1]["inputs"] = max(tests.inputs.values(), default=None)
    for number, start in enumerate(starts.starts if starts else (), 1):
        z = np.array([f.z_of(start.initial[f.name]) for f in problem.free])
        row = {"name": f"random {number}", "away": rms(z - problem.initial()), "apart": start.distance}
        row |= {"residual": start.residual, "iterations": start.iterations}
        rows.append(row | {"same": start.distance < 1, "joined": start.joined})
    return {
        "names": [names.get(n, n) for n in problem.names],
        "correlation": refined.statistics.correlation,
        "condition": refined.statistics.condition,
        "fits": fits,
        "unidentified": [_renamed(sentence, names) for sentence in refined.unidentified],
        "starts": rows,
        "facts": {
            "recordings": f"{len(problem.training)} for training, {seconds:.0f} s; "
            f"{len(problem.held_out)} held out",
            "iterations": str(len(refined.history)),
            "ended": refined.reason,
            "95 % intervals": scatter if refined.robust else noise,
        },
        "remarks": [*advice(refined), *(f"{names.get(n, n)} ended at its bound." for n in refined.at_bound)],
    }


def _renamed(sentence: str, names: Mapping[str, str]) -> str:
    """A sentence with the names of the report; longest first, because one may be the beginning of another."""
    pattern = "|".join(re.escape(name) for name in sorted(names, key=len, reverse=True))
    text = re.sub(rf"\b({pattern})\b", lambda m: names[m[1]], sentence) if names else sentence
    return text if text.endswith(".") else f"{text}."


def quality(recording: Recording) -> dict[str, Any]:
    """Content of the page and the JSON file for the clock and the signals of a recording.

    faults     number of remarks, including those of the channels
    channels   by signal: lowest and highest value, noise, fraction of samples in the dead zone of the sensor
               (which are not used), and remarks
    """
    report = examine(recording)
    rate, remarks = report.rate, list(report.clock)
    if resample_uniformly(recording) is not recording:
        remarks.append(f"The clock: all signals are interpolated at {rate:.6g} Hz; gaps stay gaps.")
    if rate > 1.01 * MAX_RATE and recording.procedure == "machine":
        remarks.append(f"The clock: {rate:.6g} Hz, filtered to {MAX_RATE:g} Hz to be fitted together.")
    channels: list[dict[str, Any]] = [
        {
            "signal": signal.name,
            "unit": signal.unit,
            "low": signal.low,
            "high": signal.high,
            "noise": signal.noise,
            "sensor": signal.sensor.text,
            "remarks": signal.faults(),
            "dead": signal.unused["dead zone"].fraction,
        }
        for signal in report.signals
    ]
    return {
        "name": recording.source.name,
        "title": recording.title,
        "procedure": recording.procedure,
        "use": recording.use,
        "kind": recording.kind,
        "duration": float(recording.time[-1] - recording.time[0]),
        "rate": rate,
        "channels": channels,
        "remarks": remarks,
        "faults": len(remarks) + sum(len(c["remarks"]) for c in channels),
    }


def faults(qualities: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    """Lines on the faults of all recordings for a terminal; dead zones are summarised in one line."""
    for q in qualities:
        yield from (f"{q['name']}: {remark}" for remark in q["remarks"])
        yield from (f"{q['name']}: {c['signal']}: {text}" for c in q["channels"] for text in c["remarks"])
    dead = [
        (c["dead"], q["name"], c["signal"]) for q in qualities for c in q["channels"] if 0 < c["dead"] < 1
    ]
    if dead:
        fraction, name, signal = max(dead)
        files = len({file for _, file, _ in dead})
        yield (
            f"meters in their dead zones, where nothing is used: {files} recording{'s' * (files > 1)},"
            f" at most {100 * fraction:.2g} % of the samples ({name}: {signal})"
        )
