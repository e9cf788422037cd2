"""Report of a study: report.html and analysis.json in the folder of its results.

The page is one file that needs no network. The JSON file contains the same values in the units of the FMUs.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from markupsafe import Markup

from orchestrator.base.text import MINUS, NO_VALUE, DisplayUnit, TextTable, display_unit
from orchestrator.pages import html_page
from orchestrator.pages.figures import plot
from orchestrator.pages.html_page import json_values
from orchestrator.pages.plotting import embed
from orchestrator.studies.analysis.analyse import analyse
from orchestrator.studies.analysis.analysis_text import MEASURES, output_description, sentences, size
from orchestrator.studies.analysis.output_samples import done
from orchestrator.studies.analysis.results import HEAD, MU_STAR, Analysis, Effect, OutputAnalysis, Sensitivity
from orchestrator.studies.report.study_figures import (
    MOST_BARS,
    bands,
    colouring,
    factor_unit,
    histogram,
    scatter,
    shows_medians,
    tornado,
)
from orchestrator.studies.store import Results, read
from orchestrator.studies.study import START, Factor, Output, short

PAGE, NUMBERS = "report.html", "analysis.json"
TEMPLATE = Path(__file__).parent / "templates" / "study.html.j2"
CaptionedFigure = tuple[str, Markup, str]  # title, figure, caption
METHODS = {"latin": "Latin hypercube", "sobol": "Sobol' points", "grid": "full grid"}
METHODS |= {"saltelli": "Saltelli design", "morris": "Morris trajectories"}
BINS = 16  # of the small histograms
PURE = DisplayUnit("", "")


def report(folder: Path) -> Path:
    """Analyse the finished study in a folder and write both files there; returns the path of the page."""
    results = read(folder)
    write(folder, results, analyse(results))
    return folder / PAGE


def write(folder: Path, results: Results, analysis: Analysis) -> None:
    """Write both files; equal results give equal bytes."""
    study: dict[str, Any] = json_values(results.study)
    study.pop("folder")  # the location of the study is not a result
    texts = {analysed.name: sentences(analysed) for analysed in analysis.findings}
    html_page.write_json(folder / NUMBERS, {"study": study, **json_values(analysis), "sentences": texts})
    html_page.write_text(folder / PAGE, render(results, analysis))


def render(results: Results, analysis: Analysis) -> str:
    """The page as HTML."""
    study = results.study
    outputs = {output.name: output for output in study.outputs}
    over_time = _bands(results)
    # without unit if the name sets several variables
    units = {name: results.units.get(f"{START}{name}", "") for name in study.fixed}
    return html_page.render(
        TEMPLATE,
        title=analysis.title,
        study=study,
        analysis=analysis,
        method=METHODS[study.method],
        measures=MEASURES,
        sentences=sentences,
        description=output_description,
        varied=[(f, distribution_text(f), _bar_heights(results.table[f.column])) for f in study.factors],
        sections=[
            (f, _columns(results, outputs[f.name], f, k), _spreads(f), *_estimates(f))
            for k, f in enumerate(analysis.findings)
        ],
        bands=over_time,
        plots=bool(over_time),
        fixed=[(name, display_unit(units[name], v).text(v, 6)) for name, v in study.fixed.items()],
    )


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


def _bar_heights(column: pd.Series) -> list[float]:
    """Heights of the bars of a histogram of samples, the highest 1."""
    values = column.to_numpy(float)
    if not len(values) or np.ptp(values) == 0:
        return [1.0]
    counts, _ = np.histogram(values, bins=BINS)
    return [round(float(count / counts.max()), 3) for count in counts]


def _estimates(analysed: OutputAnalysis) -> tuple[Markup | None, Markup | None]:
    """Table of all effects, and that of each combination of choices."""
    sensitivity, unit = analysed.sensitivity, analysed.display
    if sensitivity is None:
        return None, None
    return _effects(sensitivity, unit).html(), _apart(sensitivity, unit).html() if sensitivity.apart else None


def _spreads(analysed: OutputAnalysis) -> Markup | None:
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
    return TextTable(head, rows).html() if rows else None


def _effects(sensitivity: Sensitivity, unit: DisplayUnit) -> TextTable:
    """A row per effect, in the order of the tornado, and a column for each measure that an effect has."""
    measures = {key for effect in sensitivity.effects for key in (*effect.estimates, *effect.more)}
    columns = {key: head for key, head in HEAD.items() if key in measures}
    rows = []
    for effect in sensitivity.effects:
        trend = "" if effect.direction is None else f"{effect.direction:+.2f}".replace("-", MINUS)
        rows.append([_code(effect.label), *(_measure(effect, key, unit) for key in columns), trend])
    return TextTable(["factor or choice", *columns.values(), "rank correlation"], rows)


def _code(name: str) -> Markup:
    return Markup("<code>{}</code>").format(name)


def _measure(effect: Effect, key: str, unit: DisplayUnit) -> str:
    if key in effect.estimates:
        return size(effect.estimates[key], key, unit)
    if key not in effect.more:
        return ""
    return (unit if key in ("mu", "sigma") else PURE).text(effect.more[key])


def _apart(sensitivity: Sensitivity, unit: DisplayUnit) -> TextTable:
    """The sensitivity measure of each factor in each combination of choices."""
    measure, rows = sensitivity.measure, []
    combinations = [{e.name: e.estimates[measure] for e in effects} for effects in sensitivity.apart.values()]
    for name in (effect.name for effect in sensitivity.effects if effect.kind == "factor"):
        cells = [size(c[name], measure, unit) if name in c else NO_VALUE for c in combinations]
        rows.append([_code(name), *cells])
    return TextTable(["factor", *sensitivity.apart], rows)


def _columns(
    results: Results, output: Output, analysed: OutputAnalysis, index: int
) -> list[list[CaptionedFigure]]:
    """The figures of an output in two columns of about the same height."""
    sensitivity, left, right = analysed.sensitivity, list[CaptionedFigure](), list[CaptionedFigure]()
    if sensitivity is not None:
        drawn = embed(tornado(analysed, sensitivity), f"t{index}-", "tornado")
        left.append(("Sensitivities", drawn, _hidden_effects(sensitivity, analysed.display)))
        dots = scatter(results, output, analysed, sensitivity)
        if dots is not None:
            caption = "A dot for each run" + ("; the line is the median." if shows_medians(results) else ".")
            right.append(("Factors with the largest effect", embed(dots, f"s{index}-", "scatter"), caption))
    if analysed.spread is not None and not analysed.constant:
        figure = histogram(results, output, analysed, colouring(results, sensitivity))
        drawn = embed(figure, f"h{index}-", "histogram")
        left.append(("Distribution", drawn, "Dashed: 5, 50 and 95 % quantiles."))
    return [column for column in (left, right) if column]


def _hidden_effects(sensitivity: Sensitivity, unit: DisplayUnit) -> str:
    """Caption about the effects that a tornado does not show."""
    hidden = sensitivity.effects[MOST_BARS:]
    if not hidden:
        return ""
    largest = max(hidden[0].estimates[sensitivity.measure].value, 0.0)
    bound = unit.text(largest) if sensitivity.measure == MU_STAR else f"{math.ceil(100 * largest)} %"
    return f"Not shown: {len(hidden)} more, none with more than {bound}."


def _bands(results: Results) -> list[tuple[str, list[tuple[str, Markup]]]]:
    """Figures of each stored signal: all runs, then one figure per choice."""
    if results.bands is None or results.bands.empty or done(results).empty:
        return []
    figures_by_signal = []
    for signal in results.study.bands:
        unit = display_unit(results.units.get(signal, ""), float(results.bands[signal].abs().max()))
        figures = [("all runs", plot(bands(results, signal, unit, None), f"{signal}, all runs"))]
        for choice in results.study.compared:
            title = f"by {choice.name}"
            figures.append((title, plot(bands(results, signal, unit, choice), f"{signal} {title}")))
        figures_by_signal.append((signal, figures))
    return figures_by_signal
