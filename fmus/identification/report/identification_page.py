"""The report of an identification: one self-contained HTML file, and the same numbers as JSON.

`refinement` and `quality` give what the page and the JSON hold of a joint refinement and of a recording.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from fmus.identification.estimate import Estimate
from fmus.identification.procedure_result import ProcedureResult
from fmus.identification.recordings.clock import FASTEST, evenly
from fmus.identification.recordings.quality import examine
from fmus.identification.refinement.multistart import MultistartResult
from fmus.identification.refinement.refine import RefinementResult, advice
from fmus.identification.report import report_texts
from fmus.identification.report.attribution import Explanation
from fmus.identification.report.finding_figures import draw_finding, draw_matrix
from fmus.identification.report.recording_comparison import Picture
from orchestrator.base import html_page
from orchestrator.base.plotting import embed
from orchestrator.data.recording import Recording

TEMPLATE = Path(__file__).parent / "templates" / "identification.html.j2"
NAME = "identification"


@dataclass(frozen=True)
class IdentifiedParameter:
    """One identified parameter: the estimate, the value before, and which procedure found it.

    prior, prior_source   value and source of the machine's own files, None if there is none
    """

    estimate: Estimate
    procedure: str
    prior: float | None = None
    prior_source: str = ""
    text: str = ""


@dataclass(frozen=True)
class IdentificationPage:
    """Everything that the page shows.

    kinds        of the recordings: "simulation", "measurement", "published"
    qualities    what `quality` gives
    refinement   what `refinement` gives
    pictures     measured and predicted traces
    commands     how to go on: command -> what it does
    remarks      what the reader must know first, whole sentences
    warnings     what makes the numbers doubtful and what to check, whole sentences
    """

    title: str
    source: str
    kinds: tuple[str, ...]
    findings: tuple[ProcedureResult, ...]
    parameters: tuple[IdentifiedParameter, ...]
    qualities: tuple[Mapping[str, Any], ...] = ()
    refinement: Mapping[str, Any] | None = None
    explanation: Explanation | None = None
    pictures: tuple[Picture, ...] = ()
    commands: Mapping[str, str] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()


def write_page(folder: Path, page: IdentificationPage) -> tuple[Path, Path]:
    """Write identification.html and identification.json to a folder; returns both paths.

    The JSON has all numbers of the page in SI units, without the curves of the figures.
    """
    numbers = {name: value for name, value in vars(page).items() if name != "pictures"}
    numbers["findings"] = [
        {name: value for name, value in vars(finding).items() if name != "panels"}
        for finding in page.findings
    ]
    html = html_page.write_text(folder / f"{NAME}.html", render(page))
    return html, html_page.write_json(folder / f"{NAME}.json", numbers)


def render(page: IdentificationPage) -> str:
    """The HTML text."""
    joint = page.refinement
    findings = [
        (
            finding,
            finding.panels
            and embed(draw_finding(finding, page.kinds, titled=False), f"f{k}-", finding.title),
            report_texts.caption(finding, page.kinds),
        )
        for k, finding in enumerate(page.findings)
    ]
    several = joint is not None and len(joint["names"]) > 1
    return html_page.render(
        TEMPLATE,
        title=page.title,
        page=page,
        words=report_texts,
        origin=report_texts.origin(page.kinds),
        findings=findings,
        heat=joint
        and several
        and embed(draw_matrix(joint["names"], joint["correlation"]), "c-", "Correlation"),
        pictures=[(p, embed(p.figure, f"t{k}-", p.title)) for k, p in enumerate(page.pictures)],
    )


def refinement(
    refined: RefinementResult,
    names: Mapping[str, str] | None = None,
    signals: Mapping[str, str] | None = None,
    facts: Mapping[str, str] | None = None,
    starts: MultistartResult | None = None,
) -> dict[str, Any]:
    """What page and JSON hold of a refinement.

    names, signals   parameter and output of the problem -> what the page calls them
    facts            what else is to be shown, such as the time it took
    starts           the same search from random starts, on fewer samples

    names, correlation   of the parameters, (n, n)
    fits                 how well each signal is predicted, see `_fit`
    unidentified         what the data cannot show, whole sentences
    starts               where each random search began and ended, see `_starts`
    facts                method, seconds, samples ...: name -> text, in the order to show
    """
    names, signals = names or {}, signals or {}
    problem, found = refined.problem, refined.statistics
    seconds = sum(float(run.time[-1] - run.time[0]) for run in problem.training)
    recordings = f"{len(problem.training)} for training, {seconds:.0f} s; {len(problem.held_out)} held out"
    scatter = "the scatter between segments: residuals depend on their past, which noise of sensors does not"
    noise = "from the noise of the sensors: residuals are independent of each other"
    return {
        "names": [names.get(n, n) for n in problem.names],
        "correlation": found.correlation,
        "condition": found.condition,
        "fits": [_fit(refined, k, signals.get(n, n)) for k, n in enumerate(problem.outputs)],
        "unidentified": [_renamed(sentence, names) for sentence in refined.unidentified],
        "starts": _starts(refined, starts) if starts else [],
        "facts": {
            "recordings": recordings,
            "iterations": str(len(refined.history)),
            "ended": refined.reason,
            "95 % intervals": f"from {scatter} explain" if refined.robust else noise,
            **(facts or {}),
        },
        "remarks": [*advice(refined), *(f"{names.get(n, n)} ended at its bound." for n in refined.at_bound)],
    }


def _fit(refined: RefinementResult, place: int, name: str) -> dict[str, Any]:
    """How well one signal is predicted; None where there is no such recording.

    train, test   NRMSE over the range
    noise     root mean square of the training residual in standard deviations of the sensor
    memory    share of the lags at which the residual depends on its past beyond chance, 0.01 if white
    white     probability of such a memory if the residual were white [Ljung and Box]
    inputs    the largest such share for its correlation with an earlier input
    """
    tests = refined.whiteness[refined.problem.outputs[place]]

    def mean(traces: Sequence[Any]) -> float | None:
        values = np.array([float(t.nrmse()[place]) for t in traces])
        known = values[np.isfinite(values)]
        return float(np.sqrt(np.mean(known**2))) if known.size else None

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
    """
    found, problem = [], refined.problem
    for place, start in enumerate(starts.starts, 1):
        begun = np.array([f.z_of(start.initial[f.name]) for f in problem.free])
        away = float(np.sqrt(np.mean((begun - problem.initial()) ** 2)))
        end = {"apart": start.distance, "residual": start.residual, "iterations": start.iterations}
        found.append({"name": f"random {place}", "away": away, **end, "same": start.distance < 1})
    return found


def _renamed(sentence: str, names: Mapping[str, str]) -> str:
    """A whole sentence with the page's names; longest first, because one may begin like another."""
    known = "|".join(re.escape(name) for name in sorted(names, key=len, reverse=True))
    text = re.sub(rf"\b({known})\b", lambda m: names[m[1]], sentence) if names else sentence
    return text if text.endswith(".") else f"{text}."


def quality(recording: Recording) -> dict[str, Any]:
    """What page and JSON hold of a recording's clock and signals.

    faults     how many remarks there are, those of the channels included
    channels   by signal: lowest and highest value, noise found, share of the samples in the dead zone of the
               sensor, which are not used, and remarks in whole sentences
    """
    found = examine(recording)
    rate, remarks = found.clock.rate, list(found.clock.remarks())
    if evenly(recording) is not recording:
        remarks.append(f"The clock: all signals are interpolated at {rate:.6g} Hz; gaps stay gaps.")
    if rate > 1.01 * FASTEST and recording.procedure == "machine":
        remarks.append(f"The clock: {rate:.6g} Hz, filtered to {FASTEST:g} Hz to be fitted together.")
    channels: list[dict[str, Any]] = [
        {
            "signal": signal.name,
            "unit": signal.unit,
            "low": signal.lowest,
            "high": signal.highest,
            "noise": signal.noise,
            "sensor": signal.sensor.text,
            "remarks": [text.removeprefix(f"{signal.name}: ") for text in signal.faults()],
            "dead": signal.dead.share,
        }
        for signal in found.signals
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
    """What somebody who waits for the results has to read: faults one by one, dead zones in one line."""
    for q in qualities:
        yield from (f"{q['name']}: {remark}" for remark in q["remarks"])
        yield from (f"{q['name']}: {c['signal']}: {text}" for c in q["channels"] for text in c["remarks"])
    dead = [
        (c["dead"], q["name"], c["signal"]) for q in qualities for c in q["channels"] if 0 < c["dead"] < 1
    ]
    if dead:
        share, name, signal = max(dead)
        files = len({file for _, file, _ in dead})
        yield (
            f"meters in their dead zones, where nothing is used: {files} recording{'s' * (files > 1)},"
            f" at most {100 * share:.2g} % of the samples ({name}: {signal})"
        )
