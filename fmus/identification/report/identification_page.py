"""Report of an identification: a page, JSON with the same values, and the last lines in a terminal.

The page answers first: which parameters were found with which interval, which of them are doubtful, and the
worst fit as a picture.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from fmus.contract import quantities
from fmus.identification.machine import lookup, nominal, sensor_sentences
from fmus.identification.pipeline import Identified
from fmus.identification.recordings.quality import Quality
from fmus.identification.recordings.reading import MACHINE
from fmus.identification.refinement.refine import RefinementResult, advice
from fmus.identification.refinement.statistics import nrmse
from fmus.identification.report import figures, prediction
from fmus.identification.report.attribution import attribute, percent
from fmus.identification.report.figures import percentage
from fmus.identification.results import NO_RECORDING, Estimate, named
from fmus.machine.parts import FERIC
from orchestrator.base import text
from orchestrator.base.text import DASH, TextTable, display_unit, first_names, typeset
from orchestrator.pages.html_page import breakable, json_values, upper_first
from orchestrator.results.report import (
    PAGE,
    TERMINAL,
    Columns,
    Facts,
    Figure,
    Part,
    Report,
    Section,
    Table,
    Text,
)

NAME = "identification"
MOVES = 0.01  # rad, angular range above which a joint is shown
WIDE = 0.5  # half interval over value above which an estimate is doubtful
LARGE_CORRELATION = 0.3  # magnitude of the correlations that are listed
FAR = 3.0  # residuals over noise from which on eight ninths of chi-square are errors of the model
NAMED = 3  # signals named in a warning
POOR = 0.2  # training NRMSE above which signs, units or the assignment of levers must be wrong
CHECK = (
    "Check before you use the numbers: which command moves which joint, the sign and time of each command, "
    "angle and flow, the unit of each signal, and the pose from which each recording begins."
)
Content = Mapping[str, Any]
Show = Mapping[str, Callable[[Any], str]]  # column -> text of a row in it


def report(page: Content) -> Report:
    """The report of what `page_content` has found; its JSON has all values in SI units, without curves."""
    values = _without(page, "title", "figures", "worst") | {
        "results": [_without(vars(r), "panels") for r in page["results"]],
        "qualities": [
            {**_without(vars(q), "clock", "notes"), "remarks": q.clock, "faults": len(q.faults())}
            for q in page["qualities"]
        ],
    }
    doubts, found = page["warnings"], page["explanation"]
    worst = (
        Figure(figure, title, caption, f"Worst fit: {title}") for title, figure, caption in page["worst"]
    )
    outside = [found.doubt() for found in (page["prediction"] or {}).get("extrapolated", ())]
    parts: list[Part] = [
        Text([*_predicted(page["prediction"])], only=TERMINAL),
        Text([found.verdict] if found else [], only=TERMINAL),
        Text([f"warning: {doubt}" for doubt in (*doubts, *outside)], only=TERMINAL),
        Columns([_table(sorted(page["parameters"], key=lambda p: not p["doubt"]), PARAMETERS), *worst]),
        *_sections(page),
    ]
    origin = f"{upper_first(figures.origin(page['kinds']))}. Read from `{page['source']}`."
    return Report(page["title"], _verdict(page), parts, values, not doubts, [origin, *page["remarks"]])


def _without(values: Content, *names: str) -> dict[str, Any]:
    """All values but those of these names."""
    return {name: value for name, value in values.items() if name not in names}


def _verdict(page: Content) -> str:
    """How many parameters were found, and which of them are doubtful."""
    found = (("parameter", "parameters"), ("recording", "qualities"), ("warning", "warnings"))
    counts = {of: f"{len(page[of])} {one}{'s' * (len(page[of]) != 1)}" for one, of in found}
    doubtful = [p["estimate"].name for p in page["parameters"] if p["doubt"]]
    verdict = f"{counts['parameters']} with 95 % intervals"
    verdict += f" from {counts['qualities']}" if page["qualities"] else ""
    verdict += f"; doubtful: {first_names(doubtful)}" if doubtful else ""
    return verdict + (f"; {counts['warnings']}" if page["warnings"] else "")


def _predicted(found: Content | None) -> Iterator[str]:
    """Errors of the predicted recording, and how many samples its bands hold, for a terminal."""
    if not found:
        return
    use = "held out" if found["use"] == "test" else "used for fitting"
    yield f"predicted: {found['recording']}, {use}; NRMSE of the worst signals"
    for quantity, (name, error) in prediction.worst(found["nrmse"]).items():
        yield f"  {quantity:<10}{100 * error:5.2f} %  {name}"
    if held := found["held"]:
        least = min(held, key=lambda name: held[name])
        mean = sum(held.values()) / len(held)
        yield f"  95 % bands hold {100 * mean:.0f} %, of {least} {100 * held[least]:.0f} %"


# ---- tables of the page


def number(value: float | None, digits: int = 3, unit: str = "1") -> str:
    """A number with significant digits in the display unit of `unit`, typeset; a dash for None."""
    shown = None if value is None else display_unit(unit).factor * value
    return typeset(text.number(shown, digits, zeros=True))


def value(estimate: Estimate) -> str:
    """The value in its display unit."""
    return number(estimate.value, estimate.digits, estimate.unit)


def interval(estimate: Estimate) -> str:
    """The 95 % interval in the display unit; its ends have as many decimals as the value."""
    unit, ends = estimate.unit, list[str]()
    for end in (estimate.low, estimate.high):
        digits = 3
        if math.isfinite(end) and end and estimate.value:
            factor = display_unit(unit).factor
            size, of_end = (math.floor(math.log10(abs(factor * x))) for x in (estimate.value, end))
            digits = max(1, estimate.digits - size + of_end)
        ends.append("open" if math.isinf(end) else number(end, digits, unit))
    return " to ".join(ends)


def value_and_interval(estimate: Estimate) -> str:
    """The value with its unit and, in brackets, the 95 % interval."""
    return f"{value(estimate)} {display_unit(estimate.unit).name} ({interval(estimate)})".replace("  ", " ")


def change(value: float, before: float | None) -> str:
    """Relative change of a value as percentage."""
    if not before:
        return DASH
    percent = 100 * (value / before - 1)
    return f"{'+' * (percent > 0)}{number(percent, 2)} %"


def probability(p: float | None) -> str:
    """A probability, with a lower limit."""
    return "< 0.001" if p is not None and p < 1e-3 else number(p, 2)


def _code(name: str) -> Markup:
    return Markup("<code>{}</code>").format(breakable(name))


def _procedure(name: str) -> str:
    return "joint refinement" if name == MACHINE else name.replace("_", " ")


ESTIMATES: Show = {
    "parameter": lambda e: _code(e.name),
    "value": value,
    "95 % interval": interval,
    "unit": lambda e: display_unit(e.unit).name,
    "how": lambda e: e.note,
}
PARAMETERS: Show = {
    "parameter": lambda p: _code(p["estimate"].name),
    "value (95 % interval)": lambda p: value_and_interval(p["estimate"]),
    "doubt": lambda p: p["doubt"],
}
BEFORE: Show = {
    "parameter": lambda p: _code(p["estimate"].name),
    "from": lambda p: _procedure(p["procedure"]),
    "before": lambda p: number(p["prior"], 4, p["estimate"].unit),
    "unit": lambda p: display_unit(p["estimate"].unit).name,
    "change": lambda p: change(p["estimate"].value, p["prior"]),
    "source before": lambda p: p["prior_source"],
    "meaning": lambda p: p["text"],
}
TESTS: Show = {
    "procedure": lambda f: _procedure(f["procedure"]),
    "what would be wrong": lambda f: f["fault"],
    "p": lambda f: probability(f["p"]),
    "result": lambda f: f["sentence"] if f["named"] else "no fault",
}
FITS: Show = {
    "signal": lambda fit: _code(fit["signal"]),
    "NRMSE, training": lambda fit: percentage(fit["train"]),
    "NRMSE, held out": lambda fit: percentage(fit["test"]),
    "residual over sensor noise": lambda fit: number(fit["noise"], 2),
    "lags with autocorrelation": lambda fit: percentage(fit["memory"]),
}
CORRELATIONS: Show = {
    "parameter": lambda pair: _code(pair[1]),
    "and": lambda pair: _code(pair[2]),
    "correlation": lambda pair: number(pair[0], 2),
}
EFFECTS: Show = {
    "effect": lambda s: s.effect,
    "alone": lambda s: percentage(s.alone),
    "strength": lambda s: number(s.coefficient, 2),
    "95 % interval": lambda s: f"{number(s.low, 2)} to {number(s.high, 2)}",
    "largest in": lambda s: max(s.signals, key=lambda n: s.signals[n], default=""),
}
RECORDINGS: Show = {
    "recording": lambda q: _code(q.name),
    "experiment": lambda q: q.procedure.replace("_", " "),
    "use": lambda q: {"train": "training", "test": "held out"}.get(q.use, q.use),
    "origin": lambda q: q.kind,
    "length": lambda q: f"{number(q.duration, 3)} s",
    "rate": lambda q: f"{number(q.rate, 3)} Hz",
    "faults": lambda q: "; ".join(q.faults()) or "none",
}
NUMBERS = {"value", "before", "change", "p", "correlation", "alone", "strength", "length", "rate"}
NUMBERS |= FITS.keys() - {"signal"}
OF_TESTS = (
    "p: probability of data that contradict the assumption as much, if it holds. A fault is shown if its p "
    "is below 1 % after the correction for the number of tests [Holm 1979]: at most one of a hundred "
    "machines without faults has a false warning",
)
OF_FITS = (
    "NRMSE: root mean square error over the range of the measurement; held out: recordings that were not "
    "fitted, simulated from their first samples",
    "The last two columns are those of the training residuals. If these were only noise of the sensors, the "
    "ratio would be 1, and about 1 % of the lags would be significant by chance",
)
OF_EFFECTS = (
    "The identified machine is simulated again with each effect that a variant of a part has, and with "
    "commands at other times. The change of all signals is compared with the residual of the prediction",
    "Shares are fractions of the residual's sum of squares, with equal weights of the signals. Alone: only "
    "this effect is added. Strength 1: as in the variant; below 0: the data show the opposite",
    "What other values of the identified parameters would explain is not attributed to an effect. If the "
    "supply pressure is measured, it is an input, so pump and engine are not an effect",
)


def _table(rows: Iterable[Any], show: Show, below: Sequence[str] = ()) -> Table:
    cells = [[text(row) for text in show.values()] for row in rows]
    left = [k for k, name in enumerate(show) if name not in NUMBERS]
    return Table(TextTable([*show], cells, left=left), below if cells else (), only=PAGE)


def _folded(title: str, rows: Sequence[Any], show: Show, below: Sequence[str] = ()) -> Section:
    """A table under a heading with the number of its rows."""
    return Section(f"{title} ({len(rows)})", [_table(rows, show, below)], folded=True)


def _sections(page: Content) -> Iterator[Section]:
    """The sections of the page; those without content are left out."""
    yield Section("Warnings", [Text(page["warnings"], "warn")])
    yield Section("Values before", [_table(page["parameters"], BEFORE)], folded=True)
    shown, quiet = ([f for f in page["findings"] if f["named"] is named] for named in (True, False))
    folded = _folded("Tests that found no fault", quiet, TESTS, OF_TESTS)
    yield Section("Tests of the assumptions", [_table(shown, TESTS, OF_TESTS), folded])
    for result in page["results"]:
        drawn = figures.procedure_figures(result, page["kinds"])
        pictures = Columns([Figure(f, f"{result.title}, {k}") for k, f in enumerate(drawn, 1)])
        content: list[Part] = [pictures, Text(result.remarks), _table(result.estimates, ESTIMATES)]
        if result.listed and result.listed[-1].value:
            content.append(_folded("Tables of the openings", result.listed, ESTIMATES))
        content.append(_folded("Other estimates", result.others, ESTIMATES))
        yield Section(result.title, content, folded=True)
    if joint := page["refinement"]:
        undetermined = joint["unidentified"] or ["Every chosen parameter is identified."]
        content = [
            Text(joint["remarks"], "warn"),
            Facts({"condition number": joint["condition"], **joint["facts"]}),
            _table(joint["fits"], FITS, OF_FITS),
            Section("Parameters that the data do not determine", [Text(undetermined)]),
            _folded("Large correlations", _correlations(joint), CORRELATIONS),
        ]
        yield Section("Joint refinement", content, folded=True)
    if found := page["explanation"]:
        small = [f"Signals left out, whose residual is small: {', '.join(found.quiet)}"] * bool(found.quiet)
        shares = _table(found.shares, EFFECTS, [*OF_EFFECTS, *small])
        yield Section("Effects in the residual", [Text([found.verdict]), shares])
    for title, figure, caption in page["figures"]:
        yield Section(f"{title} over time", [Figure(figure, title, caption)], folded=True)
    yield Section("Data quality", [_table(page["qualities"], RECORDINGS)])
    commands = [(text, Markup("<code>{}</code>").format(c)) for c, text in page["commands"].items()]
    yield Section("Next steps", [Text(lines) for lines in commands])


def _correlations(joint: Content) -> list[tuple[float, str, str]]:
    """Pairs of estimates with a large correlation, the largest first."""
    names, r = joint["names"], np.asarray(joint["correlation"])
    pairs = [(float(r[i, j]), names[j], names[i]) for i in range(len(names)) for j in range(i)]
    return sorted((p for p in pairs if abs(p[0]) >= LARGE_CORRELATION), key=lambda p: -abs(p[0]))


# ---- the content


def page_content(
    folder: Path,
    out: Path,
    identified: Identified,
    comparison: prediction.RecordingComparison | None,
    qualities: Sequence[Quality] = (),
    processes: int = 1,
) -> dict[str, Any]:
    """The content of the report: the values of the JSON file, `figures` of predicted signals, the worst fit.

    folder       folder of the recordings
    out          file of the estimated parameters
    comparison   result of `prediction`
    processes    number of processes that simulate the effects
    """
    refined, outside, tests = identified.refined, prediction.extrapolated(identified), identified.findings
    shown = named(finding for _, finding in tests)
    faults = {name: dict.fromkeys(f.fault for n, f in tests if n == name and f in shown) for name, _ in tests}
    missing = [name for name, reason in identified.skipped.items() if reason == NO_RECORDING]
    explanation = None
    if comparison and refined:
        explanation = attribute(comparison, prediction.default_values(identified), processes)
    return {
        "title": f"Identification from {folder.name}",
        "source": str(folder),
        "kinds": list(dict.fromkeys(r.kind for r in identified.recordings)),
        "results": identified.results,
        "parameters": [
            _parameter(e, name, _doubt(e, refined if name == MACHINE else None, faults.get(name, ())))
            for e, name in identified.estimates.values()
        ],
        "qualities": qualities,
        "refinement": refinement(refined) if refined else None,
        "explanation": explanation,
        "figures": list(_joints(comparison)) if comparison else [],
        "worst": [*_worst(identified, comparison)],
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
            *(warnings(refined) if refined else ()),
        ],
    }


def _joints(comparison: prediction.RecordingComparison) -> Iterator[tuple[str, Any, str]]:
    """Title, figure and caption of each joint that moves."""
    for joint in figures.JOINT_FIGURES:
        if np.ptp(comparison.predicted[f"manipulator.{joint}_angle"]) > MOVES:
            caption = figures.joint_caption(comparison.recording, joint)
            yield joint.capitalize(), figures.joint_figure(comparison, joint), caption


def _worst(
    identified: Identified, comparison: prediction.RecordingComparison | None
) -> Iterator[tuple[str, Any, str]]:
    """Title, figure and caption of the predicted signal with the largest NRMSE.

    Without a prediction: of the procedure whose tests agree least with the data.
    """
    if comparison and (errors := comparison.nrmse()):
        name = max(errors, key=lambda n: errors[n])
        seen = f"{comparison.recording.title}: NRMSE {percentage(errors[name])}"
        yield name, figures.signal_figure(comparison, name), seen
    elif drawn := [r for r in identified.results if r.panels]:
        result = min(drawn, key=lambda r: min((f.p for f in r.findings), default=1.0))
        kinds = [r.kind for r in identified.recordings]
        yield result.title, figures.procedure_figures(result, kinds)[0], ""


def _doubt(estimate: Estimate, refined: RefinementResult | None, faults: Iterable[str]) -> str:
    """Why an estimate is doubtful; empty if nothing speaks against it.

    refined   the joint refinement, if it found the estimate
    faults    what tests of its procedure have found
    """
    width = estimate.high - estimate.low
    reasons = {
        "at a bound": refined is not None and estimate.name in refined.at_bound,
        "the search did not converge": refined is not None and not refined.converged,
        "the data leave it open": math.isinf(width),
        "wide interval": math.inf > width > 2 * WIDE * abs(estimate.value),
        **{f"a test contradicts: {fault}": True for fault in faults},
    }
    return "; ".join(reason for reason, holds in reasons.items() if holds)


def _parameter(estimate: Estimate, procedure: str, doubt: str) -> dict[str, Any]:
    """An estimate with its procedure, why it is doubtful, and the value that the parameter files have."""
    known, name = lookup(estimate.name, nominal()), estimate.name.rpartition(".")[2]
    text = next(q[name].text for s in FERIC.subsystems.values() if name in (q := quantities(s.parameters)))
    found = {"estimate": estimate, "procedure": procedure, "doubt": doubt}
    return found | {"prior": known.value, "prior_source": known.source, "text": text}


def _next_commands(folder: Path, out: Path, identified: Identified) -> dict[str, str]:
    """Commands that use the estimates -> their purpose."""
    commands = {f"harvester build --parameters {out}": "FMUs with these parameters"}
    for r in identified.of_machine("test")[:1]:
        played = "".join(f' --play "*.{n}"' for n in prediction.LINES if f"swing.{n}" in r.signals)
        validate = f"harvester validate --reference {folder / r.source.name}{played}"
        commands[validate] = "Validation of these FMUs against the held-out recording"
    return commands


def warnings(refined: RefinementResult) -> list[str]:
    """Sentences on doubtful results, the last one with advice; empty if there is no doubt."""
    sentences = []
    if not refined.converged:
        sentences.append(f"The search did not converge: {refined.reason}.")
    if refined.at_bound:
        sentences.append(f"At a bound, so not identified: {', '.join(refined.at_bound)}.")
    residual = refined.history[-1].residual if refined.history else 0.0
    if residual > FAR:
        ratios = {n: test.rms for n, test in refined.whiteness.items() if test.rms > FAR}
        largest = sorted(ratios, key=lambda name: -ratios[name])[:NAMED]
        far = ", ".join(f"{name} {ratios[name]:.3g} times" for name in largest)
        sentences.append(
            f"The joint refinement leaves residuals {residual:.3g} times as large as the noise of the "
            f"sensors{f' ({far})' if far else ''}: the data contain an effect that the model lacks, "
            "and the estimates compensate for this effect. The report shows which effects are likely."
        )
    errors = dict(zip(refined.problem.signals, nrmse(refined.training), strict=True))
    if poor := sorted((n for n, error in errors.items() if error > POOR), key=lambda n: -errors[n]):
        sentences.append(
            "The model does not even reproduce the recordings that were used for fitting. NRMSE above "
            f"{percent(POOR)} of the range: {', '.join(f'{n} {percent(errors[n])}' for n in poor)}."
        )
    return [*sentences, CHECK] if sentences else []


def refinement(refined: RefinementResult) -> dict[str, Any]:
    """Content of the page and the JSON file for a refinement.

    `fits` has for each signal, None if there is no such recording:

    train, test   NRMSE
    noise         root mean square of the training residual in standard deviations of the sensor
    memory        fraction of the lags with a significant autocorrelation, 0.01 if the residual is white
    """
    problem, fits = refined.problem, []
    errors = {"train": nrmse(refined.training), "test": nrmse(refined.held_out)}
    for k, (signal, test) in enumerate(refined.whiteness.items()):
        fit = {use: error[k] if len(error) else None for use, error in errors.items()}
        fits.append(json_values({"signal": signal, **fit, "noise": test.rms, "memory": test.outside}))
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
