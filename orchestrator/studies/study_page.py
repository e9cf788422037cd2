"""Report of a study: report.html and analysis.json in the folder of its results.

The page is one file that needs no network. The JSON file contains the same values in the units of the FMUs.
Figures of an output, each as wide as a column of the page:

scatter     an output over each of the factors with the largest effects: a dot per run, and the median in bins
histogram   distribution of an output over the runs
bands       quantiles of a signal over time
tornado     sensitivities of an output, the largest on top, each bar with its 95 % interval
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from markupsafe import Markup
from numpy.typing import NDArray

from orchestrator.base.text import MINUS, NO_VALUE, DisplayUnit, TextTable, display_unit, name_with_unit
from orchestrator.data.table import Array
from orchestrator.pages.figures import MARKS, PALETTE, TraceArea, TraceFigure, TraceLine, TracePanel, bars
from orchestrator.pages.html_page import json_values
from orchestrator.results.report import TERMINAL, Columns, Facts, Figure, Part, Report, Section, Table, Text
from orchestrator.studies.analysis.analyse import analyse, output_description, sentences, size
from orchestrator.studies.analysis.results import (
    FIRST,
    HEAD,
    MU_STAR,
    TOTAL,
    Analysis,
    Effect,
    Failure,
    OutputAnalysis,
    Sensitivity,
    counts,
    done,
)
from orchestrator.studies.store import Results
from orchestrator.studies.study import START, Choice, Factor, Output, short

LIGHT, DARK = zip(*PALETTE.pairs, strict=True)  # of the options of a choice
HEIGHT = 4.2  # of a panel
DOTS = 100_000  # of a scatter plot, before the page thins them
POINTS = 10_000_000  # of a stored signal from which bands are drawn: 80 MB a column
QUANTILE = {"color": PALETTE.ink, "linewidth": 1.0, "linestyle": (0, (4, 2))}
PANELS = 4  # of the factors with the largest effects
BINS = 12


def scatter(
    results: Results, output: Output, analysed: OutputAnalysis, sensitivity: Sensitivity
) -> dict[str, TraceFigure]:
    """Factor -> all runs over it, in the order of the tornado; empty if no factor was varied."""
    by_name = {f.name: f for f in results.study.factors}
    top = [by_name[e.name] for e in sensitivity.effects if e.name in by_name][:PANELS]
    choice, figures = colouring(results, sensitivity), dict[str, TraceFigure]()
    columns = [output.column, *(f.column for f in top), *([choice.column] if choice else [])]
    runs = done(results, *columns).dropna(subset=[output.column])
    y = analysed.display.factor * runs[output.column].to_numpy(float)
    kept = evenly(len(runs), DOTS)
    for factor in top:
        unit = factor_unit(factor)
        x = unit.factor * runs[factor.column].to_numpy(float)
        dots = [
            TraceLine(x[kept][rows], y[kept][rows], {"color": colour, "marker": "o", "alpha": 0.5}, name)
            for (name, rows), colour in zip(_groups(runs.iloc[kept], choice), DARK, strict=False)
        ]
        if shows_medians(results):
            dots.append(TraceLine(*medians(x, y), {"color": PALETTE.ink, "linewidth": 1.8}, "median"))
        varied = factor.name + (", times its value" if factor.relative else "")
        panel = TracePanel(analysed.display.display, dots, output.name, heights=(HEIGHT, 0.0))
        figures[factor.name] = TraceFigure([panel], axis=name_with_unit(varied, unit.display))
    return figures


def evenly(count: int, most: int) -> NDArray[np.intp]:
    """Indices of at most so many of `count` items, at equal distances."""
    return np.linspace(0, count - 1, min(count, most)).astype(np.intp)


def _groups(runs: pd.DataFrame, choice: Choice | None) -> list[tuple[str, Array]]:
    """Each option with a mask of its rows; all rows if there is no choice."""
    if choice is None:
        return [("", np.ones(len(runs), dtype=bool))]
    column = runs[choice.column].astype(str).to_numpy()
    return [(short(option), column == option) for option in choice.options]


def colouring(results: Results, sensitivity: Sensitivity | None) -> Choice | None:
    """The choice with the largest effect, of those with at most as many options as there are colours."""
    by_name = {c.name: c for c in results.study.compared if len(c.options) <= len(DARK)}
    names = [e.name for e in sensitivity.effects] if sensitivity else list(by_name)
    return next((by_name[name] for name in names if name in by_name), None)


def shows_medians(results: Results) -> bool:
    """Whether medians are drawn: not for Morris, where the other factors differ between the four levels."""
    return results.study.method != "morris"


def factor_unit(factor: Factor) -> DisplayUnit:
    """Display unit of the samples of a factor; none if they are relative."""
    if factor.relative:
        return DisplayUnit("", "")
    return display_unit(factor.unit, float(np.max([np.max(np.abs(n)) for n in factor.numbers.values()])))


def medians(x: Array, y: Array) -> tuple[Array, Array]:
    """Median of y in bins of x with equal counts, or at each value of x if there are few."""
    values = np.unique(x)
    if len(values) <= BINS:
        return values, np.array([np.median(y[x == value]) for value in values])
    parts = np.array_split(np.argsort(x, kind="stable"), BINS)
    return np.array([np.median(x[p]) for p in parts]), np.array([np.median(y[p]) for p in parts])


def histogram(
    results: Results, output: Output, analysed: OutputAnalysis, choice: Choice | None
) -> TraceFigure:
    """Histogram of an output, options stacked, with lines at the 5, 50 and 95 % quantiles."""
    columns = [output.column, *([choice.column] if choice else [])]
    runs = done(results, *columns).dropna(subset=[output.column])
    values = analysed.display.factor * runs[output.column].to_numpy(float)
    edges = np.histogram_bin_edges(values, bins=min(50, max(8, round(len(values) ** 0.5))))
    lines, below = list[TraceLine](), np.zeros(len(edges) - 1)
    for (name, rows), colour in zip(_groups(runs, choice), LIGHT, strict=False):
        below = below + np.histogram(values[rows], edges)[0]
        outline = np.concatenate([[0], np.repeat(below, 2), [0]])
        lines.insert(0, TraceLine(np.repeat(edges, 2), outline, {"color": colour, "fill": True}, name))
    if spread := analysed.spread:
        places = np.repeat(np.multiply((spread.low, spread.median, spread.high), analysed.display.factor), 3)
        lines.append(TraceLine(places, np.tile([0.0, below.max(), np.nan], 3), QUANTILE, "5, 50, 95 %"))
    panel = TracePanel("", lines, "runs", heights=(HEIGHT, 0.0))
    return TraceFigure([panel], axis=name_with_unit(output.name, analysed.display.display))


QUANTILES = (0.0, 0.05, 0.5, 0.95, 1.0)
EXTREMES = "smallest and largest"


def bands(results: Results, signal: str, unit: DisplayUnit, choice: Choice | None) -> TraceFigure:
    """Median, 5 to 95 % and extremes over the runs at each time; a colour per option, of four at most."""
    runs = drawn_runs(results, choice)
    lines, areas = list[TraceLine](), list[TraceArea]()
    key: dict[str, Mapping[str, Any]] = {}
    groups = _groups(runs, choice)
    missing = ", ".join(name for name, _ in groups[len(DARK) :])
    for i, (name, rows) in enumerate(groups[: len(DARK)]):
        samples = results.stored(signal, runs["run"][rows].to_numpy())
        if samples.empty:
            continue
        time, values = quantiles(samples, signal)
        low, five, median, ninety_five, high = unit.factor * values
        solid = {"color": DARK[i], "linewidth": 1.6}
        dashed = {"color": DARK[i], "linewidth": 0.9, "linestyle": (0, (2, 2))}
        label = name or "median, 5 to 95 %"
        areas.append(TraceArea(time, five, ninety_five, LIGHT[i], label))
        lines.append(TraceLine(time, median, solid, key=label))
        key[label] = solid
        if choice is None:
            lines += [TraceLine(time, values, dashed, key=EXTREMES) for values in (low, high)]
            key[EXTREMES] = dashed
    panel = TracePanel(unit.display, lines, signal, areas=areas, heights=(4.2, 0.0))
    below = f"not drawn: {missing}; there are colours for {len(DARK)} options" if missing else ""
    return TraceFigure([panel], key=tuple(key.items()), below=below)


def drawn_runs(results: Results, choice: Choice | None) -> pd.DataFrame:
    """The finished runs; if their signals have more than POINTS, some of the runs."""
    runs = done(results, "run", *([choice.column] if choice else []))
    return runs.iloc[evenly(len(runs), max(1, len(runs) * POINTS // max(results.points, 1)))]


def quantiles(samples: pd.DataFrame, signal: str) -> tuple[Array, Array]:
    """Time (n,) and QUANTILES over runs, shape (5, n), in the unit of the signal."""
    table = samples.pivot(index="time", columns="run", values=signal)
    return table.index.to_numpy(float), np.nanquantile(table.to_numpy(float), QUANTILES, axis=1)


MOST_BARS = 12  # the table contains all effects
LABELS = {
    MU_STAR: "change over the factor's range, μ*",
    TOTAL: "fraction of the variance, total ones overlap",
    FIRST: "fraction of the variance, first order",
}


def tornado(analysed: OutputAnalysis, sensitivity: Sensitivity) -> TraceFigure:
    """Bars of the sensitivity measure, those of first order within total ones.

    A fraction of the variance is drawn from 0 to 1, as its estimate can be outside.
    """
    effects, measure = sensitivity.effects[:MOST_BARS], sensitivity.measure
    unit, most = (analysed.display, np.inf) if measure == MU_STAR else (DisplayUnit("1", "%"), 1.0)

    def drawn(value: float) -> float:
        return unit.factor * float(np.clip(value, 0.0, most))

    rows = [(-float(k), effect, effect.estimates[measure]) for k, effect in enumerate(effects)]
    lines, names = list[TraceLine](), ("total", "total, choice") if measure == TOTAL else ("factor", "choice")
    for kind, name, colour in zip(("factor", "choice"), names, LIGHT, strict=False):
        of_kind = [(row, 0.0, drawn(estimate.value)) for row, e, estimate in rows if e.kind == kind]
        lines += [bars(of_kind, 0.36, colour, name)] if of_kind else []
    if measure == TOTAL:
        within = [(row, 0.0, drawn(e.estimates[FIRST].value)) for row, e, _ in rows]
        lines.append(bars(within, 0.17, DARK[0], "first order"))
    if limits := [(row, e.floor, e.ceiling) for row, _, e in rows if e.low is not None]:
        x = np.ravel([(drawn(low), drawn(high), np.nan) for _, low, high in limits])
        y = np.ravel([(row, row, np.nan) for row, *_ in limits])
        lines.append(TraceLine(x, y, {"color": PALETTE.ink, "linewidth": 1.4}, "95 %"))
    if spread := [(row, e.more["sigma"]) for row, e, _ in rows if "sigma" in e.more]:
        style = {"color": PALETTE.bad, "marker": "D"}
        y, sigma = np.array(spread).T
        lines.append(TraceLine(unit.factor * sigma, y, style, "\N{GREEK SMALL LETTER SIGMA} of the effects"))
    right = max(float(np.nanmax(line.time)) for line in lines)
    words = {row: effect.label.replace(" (", "\n(") for row, effect, _ in rows}
    axis = name_with_unit(LABELS.get(measure, "fraction of the variance"), unit.display)
    row_height = 0.9 if any("\n" in word for word in words.values()) else 0.6
    panel = TracePanel("", lines, heights=(row_height * len(effects) + 0.8, 0.0), words=words)
    return TraceFigure([panel], (0.0, right or 1.0), axis=axis)


PAGE, NUMBERS = "report.html", "analysis.json"
REASONS = 5  # of failures that a terminal shows
BANDS = (
    "Line: median over the runs at each time. Area: 5 to 95 %. Dashed: smallest and largest. A single run can"
    " differ from all of these curves"
)
METHODS = {"latin": "Latin hypercube", "sobol": "Sobol' points", "grid": "full grid"}
METHODS |= {"saltelli": "Saltelli design", "morris": "Morris trajectories"}
PURE = DisplayUnit("", "")


def write(folder: Path, results: Results) -> Report:
    """Analyse a study and write both files; equal results give equal bytes."""
    made = study_report(results, analyse(results))
    made.write(folder / PAGE, folder / NUMBERS)
    return made


def study_report(results: Results, analysis: Analysis) -> Report:
    """What affects the outputs most, then each output, its signals over time, failures and the definition."""
    study, outputs = results.study, {output.name: output for output in results.study.outputs}
    answers = [sentences(found)[0] for found in analysis.findings]
    failed = analysis.runs - analysis.succeeded
    left_out = f"{failed} of {analysis.runs} runs failed or ended early; all statistics leave them out"
    kinds = [(study.factors, "factor"), (study.compared, "choice")]
    varied = [f"{len(some)} {name}{'s' * (len(some) != 1)}" for some, name in kinds if some]
    lead = [
        f"{analysis.runs} runs of `{study.system}`, {', '.join([*varied, METHODS[study.method]])}",
        left_out if failed else "All finished",
    ]
    sections = [_output(results, outputs[f.name], f) for f in analysis.findings]
    known: dict[str, Any] = json_values(study)
    known.pop("folder")  # the location of the study is not a result
    single = {n: v for n, v in known.items() if v not in ("", None) and not isinstance(v, list | dict)}
    parts: list[Part] = [
        Text([counts(results), *causes(analysis.failures)], only=TERMINAL),
        Text(answers[1:]),
        Table(_outputs(analysis)),
        Text([f"warning: {w}" for w in results.warnings], only=TERMINAL),
        *sections,
        *(Section(f"{name} over time", drawn) for name, drawn in _bands(results)),
        Section("Failed runs", [Text([left_out] if failed else []), Table(_failures(results, analysis))]),
        Section("Factors and choices", _varied(results, analysis), folded=True),
        Section("Definition of the study", [Facts(single)], folded=True),
    ]
    texts = {analysed.name: sentences(analysed) for analysed in analysis.findings}
    data = {"study": known, **json_values(analysis), "sentences": texts}
    data.pop("title")
    return Report(analysis.title, answers[0] if answers else "", parts, data, lead=lead)


def causes(failures: Sequence[Failure]) -> list[str]:
    """The most frequent reasons of failed runs, for a terminal."""
    shown, more = failures[:REASONS], len(failures) - REASONS
    lines = [f"{f.count} of them{', such as' if f.various else ''}: {f.reason}" for f in shown]
    return [*lines, *([f"... and for {more} other reasons"] if more > 0 else [])]


def _outputs(analysis: Analysis) -> TextTable:
    """Median and spread of each output."""
    rows = []
    for found in analysis.findings:
        spread, unit = found.spread, found.display
        if spread is None:
            cells = [NO_VALUE, "no run has it"]
        elif found.constant:
            cells = [unit.ascii(spread.median), f"in all {spread.runs} runs"]
        else:
            cells = [unit.ascii(spread.median), f"{unit.plain(spread.low)} to {unit.ascii(spread.high)}"]
        rows.append([found.name, *cells, output_description(found)])
    return TextTable(["output", "median", "in nine of ten runs", "what it is"], rows, left=(0, 3))


def _output(results: Results, output: Output, found: OutputAnalysis) -> Section:
    """Sentences, figures and tables of an output."""
    what, sensitivity = output_description(found), found.sensitivity
    unit = f", in {found.display.name}" if found.display.name else ""
    parts: list[Part] = [
        Text([f"{what}{unit}"], "soft"),
        Text([" ".join(sentences(found))]),
        Columns(_figures(results, output, found)),
        Table(replace(_spreads(found), title=f"Statistics{unit}")),
    ]
    if sensitivity is not None:
        samples = {"mu_star": "trajectories"}.get(sensitivity.measure, "samples")
        counted = f"{sensitivity.samples} {'runs' if results.study.method == 'grid' else samples}"
        effects = [Table(_effects(sensitivity, found.display), ["Brackets: 95 % intervals"])]
        parts.append(Section(f"All estimates: {sensitivity.method}, {counted}", effects, folded=True))
        parts.append(Text([*sensitivity.notes, *found.notes], "soft"))
    return Section(found.name, parts)


def _failures(results: Results, analysis: Analysis) -> TextTable:
    """Reasons of failed runs with their counts."""
    rows, choices = [], results.study.compared
    for failure in analysis.failures:
        first = f" (run {failure.examples[0]}; the numbers differ from run to run)" if failure.various else ""
        by = [
            ", ".join(f"{option} {n}" for option, n in failure.by_choice[choice.name].items() if n)
            for choice in choices
        ]
        examples = ", ".join(map(str, failure.examples))
        rows.append([str(failure.count), failure.reason + first, examples, *by])
    head = ["runs", "reason", "example runs", *(f"by {choice.name}" for choice in choices)]
    return TextTable(head, rows, left=range(1, len(head)))


def _varied(results: Results, analysis: Analysis) -> list[Part]:
    """Factors with their samples, choices with their options, and fixed values."""
    study = results.study
    rows = [[f.name, f.distribution, distribution_text(f)] for f in study.factors]
    factors = TextTable(["factor", "distribution", "parameters"], rows, left=range(3))

    def drawn(choice: Choice) -> str:
        if len(choice.options) == 1:
            return "in all runs"
        return "drawn with each sample" if choice.sampled else "each with every sample"

    choices = {c.name: f"{', '.join(c.options)} ({drawn(c)})" for c in study.choices}
    # without unit if the name sets several variables
    units = {name: results.units.get(f"{START}{name}", "") for name in study.fixed}
    fixed = {name: display_unit(units[name], v).text(v, 6) for name, v in study.fixed.items()}
    return [
        Table(factors),
        Section("Choices", [Facts(choices)]),
        Section("Fixed values of all runs", [Facts(fixed)]),
        Text(analysis.notes, "soft"),
    ]


def distribution_text(factor: Factor) -> str:
    """The distribution of a factor as text, such as `0.5 to 3 bar`."""
    unit = factor_unit(factor)
    suffix = " times its value" if factor.relative else f" {unit.name}".rstrip()
    text = {
        name: ", ".join(unit.text(float(value), 4, with_unit=False) for value in np.atleast_1d(values))
        for name, values in factor.numbers.items()
    }
    if factor.distribution == "values":
        return text["values"] + suffix
    if factor.distribution in ("normal", "lognormal"):
        return f"mean {text['mean']}, standard deviation {text['sd']}{suffix}"
    mode = f", most often {text['mode']}" if factor.distribution == "triangular" else ""
    return f"{text['minimum']} to {text['maximum']}{suffix}{mode}"


def _spreads(analysed: OutputAnalysis) -> TextTable:
    """Table of distributions, a row for all runs, then one for each option."""
    spreads = [(Markup("all"), analysed.spread)] if analysed.spread else []
    for choice, options in analysed.by_choice.items():
        name = Markup('<span class="soft">{}</span> {}')
        spreads += [(name.format(choice, short(option)), spread) for option, spread in options.items()]
    text = analysed.display.text
    rows = [
        [name, str(s.runs)]
        + [text(v, with_unit=False) for v in (s.mean, s.sd, s.minimum, s.low, s.median, s.high, s.maximum)]
        for name, s in spreads
    ]
    head = ["case", "runs", "mean", "sd", "least", "5 %", "median", "95 %", "largest"]
    return TextTable(head, rows)


def _effects(sensitivity: Sensitivity, unit: DisplayUnit) -> TextTable:
    """A row per effect, in the order of the tornado, and a column for each measure that an effect has."""
    measures = {key for effect in sensitivity.effects for key in (*effect.estimates, *effect.more)}
    columns = {key: head for key, head in HEAD.items() if key in measures}
    rows = []
    for effect in sensitivity.effects:
        trend = "" if effect.direction is None else f"{effect.direction:+.2f}".replace("-", MINUS)
        rows.append([effect.label, *(_measure(effect, key, unit) for key in columns), trend])
    return TextTable(["factor or choice", *columns.values(), "rank correlation"], rows)


def _measure(effect: Effect, key: str, unit: DisplayUnit) -> str:
    if key in effect.estimates:
        return size(effect.estimates[key], key, unit)
    if key not in effect.more:
        return ""
    return (unit if key in ("mu", "sigma") else PURE).text(effect.more[key])


def _figures(results: Results, output: Output, analysed: OutputAnalysis) -> list[Figure]:
    """Sensitivities, distribution, and all runs over the factors with the largest effects, of an output."""
    sensitivity, figures, name = analysed.sensitivity, list[Figure](), output.name
    if sensitivity is not None:
        count = len(sensitivity.effects)
        caption = f"The {MOST_BARS} largest of {count}, which are in the table." if count > MOST_BARS else ""
        drawn = tornado(analysed, sensitivity)
        figures.append(Figure(drawn, f"Sensitivities of {name}", caption, "Sensitivities"))
    if analysed.spread is not None and not analysed.constant:
        drawn = histogram(results, output, analysed, colouring(results, sensitivity))
        figures.append(Figure(drawn, f"Distribution of {name}", heading="Distribution"))
    if sensitivity is not None and analysed.spread is not None:
        line = "; the line is the median" if shows_medians(results) else ""
        figures += [
            Figure(drawn, f"{name} over {factor}", f"{_dots(analysed.spread.runs)}{line}.", f"Over {factor}")
            for factor, drawn in scatter(results, output, analysed, sensitivity).items()
        ]
    return figures


def _dots(runs: int) -> str:
    """Which runs have a dot."""
    return f"Dots for {MARKS} of {runs} runs" if runs > MARKS else "A dot for each run"


def _bands(results: Results) -> Iterator[tuple[str, list[Part]]]:
    """Figures of each stored signal: all runs, then one figure per choice."""
    if not results.points or (runs := drawn_runs(results, None)).empty:
        return
    count = len(done(results))
    text = Text([f"{BANDS}, drawn from {len(runs)} of {count} runs" if len(runs) < count else BANDS], "soft")
    for signal in results.study.bands:
        values = results.stored(signal, runs["run"].to_numpy())[signal]
        unit = display_unit(results.units.get(signal, ""), float(values.abs().max()))
        cases = [("all runs", None), *((f"by {choice.name}", choice) for choice in results.study.compared)]
        figures = (Figure(bands(results, signal, unit, c), f"{signal}, {n}", heading=n) for n, c in cases)
        yield signal, [text, *figures]
