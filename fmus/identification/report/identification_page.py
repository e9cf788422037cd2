"""Report of an identification: one self-contained HTML file, and a JSON file with the same values.

`refinement` and `quality` return the content for a joint refinement and for a recording.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from fmus.identification.estimate import Estimate
from fmus.identification.procedure_result import ProcedureResult
from fmus.identification.recordings.clock import MAX_RATE, resample_uniformly
from fmus.identification.recordings.quality import examine
from fmus.identification.refinement.multistart import MultistartResult
from fmus.identification.refinement.refine import RefinementResult, advice
from fmus.identification.report import report_texts
from fmus.identification.report.attribution import Explanation, rms
from fmus.identification.report.procedure_figures import draw_correlation, draw_procedure
from fmus.identification.report.recording_comparison import CaptionedFigure
from orchestrator.data.recording import Recording
from orchestrator.pages import html_page
from orchestrator.pages.figures import plot
from orchestrator.pages.plotting import embed

TEMPLATE = Path(__file__).parent / "templates" / "identification.html.j2"
NAME = "identification"


@dataclass(frozen=True)
class IdentifiedParameter:
    """An identified parameter: its estimate, the procedure, and the value before.

    prior, prior_source   value and source in the machine's parameter files, None if there is none
    text                  description of the parameter
    """

    estimate: Estimate
    procedure: str
    prior: float | None = None
    prior_source: str = ""
    text: str = ""


@dataclass(frozen=True)
class IdentificationPage:
    """Content of the report.

    kinds        kinds of the recordings: "simulation", "measurement", "published"
    results      of the procedures
    qualities    results of `quality`
    refinement   result of `refinement`
    figures      measured and predicted signals
    commands     commands that use the estimates -> their purpose
    remarks      sentences on procedures without a result
    warnings     sentences on doubtful results and what to check
    """

    title: str
    source: str
    kinds: tuple[str, ...]
    results: tuple[ProcedureResult, ...]
    parameters: tuple[IdentifiedParameter, ...]
    qualities: tuple[Mapping[str, Any], ...] = ()
    refinement: Mapping[str, Any] | None = None
    explanation: Explanation | None = None
    figures: tuple[CaptionedFigure, ...] = ()
    commands: Mapping[str, str] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()


def write_page(folder: Path, page: IdentificationPage) -> tuple[Path, Path]:
    """Write identification.html and identification.json to a folder; returns both paths.

    The JSON file has all values of the page in SI units, without the curves of the figures.
    """
    content = {name: value for name, value in vars(page).items() if name not in ("figures", "results")}
    content["findings"] = [
        {name: value for name, value in vars(result).items() if name != "panels"} for result in page.results
    ]
    html = html_page.write_text(folder / f"{NAME}.html", render(page))
    return html, html_page.write_json(folder / f"{NAME}.json", content)


def render(page: IdentificationPage) -> str:
    """The HTML file as text."""
    joint, heatmap = page.refinement, None
    if joint and len(joint["names"]) > 1:
        matrix = draw_correlation(joint["names"], joint["correlation"])
        heatmap = embed(matrix, "c-", "Correlation")
    results = []
    for k, result in enumerate(page.results):
        figure = draw_procedure(result, page.kinds, titled=False) if result.panels else None
        drawing = figure and embed(figure, f"f{k}-", result.title)
        results.append((result, drawing, report_texts.caption(result, page.kinds)))
    return html_page.render(
        TEMPLATE,
        title=page.title,
        page=page,
        texts=report_texts,
        origin=report_texts.origin(page.kinds),
        results=results,
        heatmap=heatmap,
        figures=[(f, plot(replace(f.figure, title=""), f.title)) for f in page.figures],
        plots=bool(page.figures),
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

    Keys of the result:

    names, correlation   of the parameters, (n, n)
    fits                 goodness of fit of each signal, see `_goodness_of_fit`
    unidentified         sentences on parameters that the data do not determine
    starts               start and end of each random search, see `_starts`
    facts                recordings, iterations ...: name -> text, in the order of the page
    """
    names, signals = names or {}, signals or {}
    problem, statistics = refined.problem, refined.statistics
    seconds = sum(float(run.time[-1] - run.time[0]) for run in problem.training)
    recordings = f"{len(problem.training)} for training, {seconds:.0f} s; {len(problem.held_out)} held out"
    scatter = "from the scatter between segments: residuals are correlated, which noise of sensors is not"
    noise = "from the noise of the sensors: residuals are uncorrelated"
    return {
        "names": [names.get(n, n) for n in problem.names],
        "correlation": statistics.correlation,
        "condition": statistics.condition,
        "fits": [_goodness_of_fit(refined, k, signals.get(n, n)) for k, n in enumerate(problem.outputs)],
        "unidentified": [_renamed(sentence, names) for sentence in refined.unidentified],
        "starts": _starts(refined, starts) if starts else [],
        "facts": {
            "recordings": recordings,
            "iterations": str(len(refined.history)),
            "ended": refined.reason,
            "95 % intervals": scatter if refined.robust else noise,
        },
        "remarks": [*advice(refined), *(f"{names.get(n, n)} ended at its bound." for n in refined.at_bound)],
    }


def _goodness_of_fit(refined: RefinementResult, index: int, name: str) -> dict[str, Any]:
    """Goodness of fit of one signal; None if there is no such recording.

    train, test   NRMSE
    noise         root mean square of the training residual in standard deviations of the sensor
    memory        fraction of the lags with a significant autocorrelation, 0.01 if the residual is white
    white         probability of this autocorrelation if the residual is white [Ljung and Box]
    inputs        largest such fraction for the cross-correlation with an earlier input
    """
    tests = refined.whiteness[refined.problem.outputs[index]]

    def mean(traces: Sequence[Any]) -> float | None:
        values = np.array([float(t.nrmse()[index]) for t in traces])
        return rms(values) if np.isfinite(values).any() else None

    return {
        "signal": name,
        "train": mean(refined.training),
        "test": mean(refined.held_out),
        "noise": html_page.json_values(tests.rms),
        "memory": html_page.json_values(tests.outside),
        "white": html_page.json_values(tests.ljung_box),
        "inputs": max(tests.inputs.values(), default=None),
    }


def _starts(refined: RefinementResult, starts: MultistartResult) -> list[dict[str, Any]]:
    """Searches from other start points.

    away       root mean square distance of the start from the values before, relative changes of parameters
    apart      largest distance of the end from the result, in standard deviations; infinite if there is none
    residual   root mean square residual at the end, in standard deviations of the sensors
    same       whether the search led to the result, within a standard deviation
    joined     whether the search was ended on the path that leads to the result
    """
    rows, problem = [], refined.problem
    for number, start in enumerate(starts.starts, 1):
        z = np.array([f.z_of(start.initial[f.name]) for f in problem.free])
        away = float(np.sqrt(np.mean((z - problem.initial()) ** 2)))
        end = {"apart": start.distance, "residual": start.residual, "iterations": start.iterations}
        end |= {"same": start.distance < 1, "joined": start.joined}
        rows.append({"name": f"random {number}", "away": away, **end})
    return rows


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
    rate, remarks = report.clock.rate, list(report.clock.remarks())
    if resample_uniformly(recording) is not recording:
        remarks.append(f"The clock: all signals are interpolated at {rate:.6g} Hz; gaps stay gaps.")
    if rate > 1.01 * MAX_RATE and recording.procedure == "machine":
        remarks.append(f"The clock: {rate:.6g} Hz, filtered to {MAX_RATE:g} Hz to be fitted together.")
    channels: list[dict[str, Any]] = [
        {
            "signal": signal.name,
            "unit": signal.unit,
            "low": signal.lowest,
            "high": signal.highest,
            "noise": signal.noise,
            "sensor": signal.sensor.text,
            "remarks": [text.removeprefix(f"{signal.name}: ") for text in signal.faults()],
            "dead": signal.dead.fraction,
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
