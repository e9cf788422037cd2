"""Tables of the page: spreads and effects as text.

What was varied, in words and as a small picture of what was drawn.

The page of a study: one self-contained HTML file, and the same numbers as JSON.

The HTML needs no network: styles and figures (SVG) are inside.

The report of a study: report.html and analysis.json beside its results.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from orchestrator.results.figures import embed
from orchestrator.studies.analysis.analyse import analyse
from orchestrator.studies.analysis.results import (
    FIRST,
    MU_STAR,
    REGRESSION,
    TOTAL,
    Analysis,
    Effect,
    Finding,
    Sensitivity,
    Spread,
    done,
    short,
)
from orchestrator.studies.analysis.wording import MEASURES, sentences, size, what
from orchestrator.studies.report.plots import (
    MOST,
    bands,
    colouring,
    has_line,
    histogram,
    scatter,
    shown_factor,
    tornado,
)
from orchestrator.studies.report.quantities import Unit, display, factor, number, seen, told
from orchestrator.studies.store import Results, read
from orchestrator.studies.study import START, Factor, Output

HEADS = {
    TOTAL: "total",
    FIRST: "by itself",
    REGRESSION: "linear model, squared",
    MU_STAR: "μ*",
    "mu": "μ",
    "sigma": "\N{GREEK SMALL LETTER SIGMA}",
    "regression": "coefficient",
    "rank_regression": "coefficient of ranks",
}


def spreads(finding: Finding) -> list[dict[str, Any]]:
    """A row for all runs, then one for each option."""
    rows = (
        [{"choice": "", "option": "all", "cells": _cells(finding.spread, finding.seen)}]
        if finding.spread
        else []
    )
    for choice, options in finding.by_choice.items():
        rows += [
            {"choice": choice, "option": option, "cells": _cells(found, finding.seen)}
            for option, found in options.items()
        ]
    return rows


def _cells(found: Spread, unit: Unit) -> list[str]:
    numbers = (found.mean, found.sd, found.minimum, found.low, found.median, found.high, found.maximum)
    return [str(found.runs), *(told(value, unit, False) for value in numbers)]


def heads(sensitivity: Sensitivity) -> list[tuple[str, str]]:
    """Columns that any effect has: key and words."""
    known = {key for effect in sensitivity.effects for key in (*effect.estimates, *effect.more)}
    return [(key, words) for key, words in HEADS.items() if key in known]


def effects(sensitivity: Sensitivity, unit: Unit) -> list[dict[str, Any]]:
    """A row per effect, in the order of the tornado."""
    columns = heads(sensitivity)
    return [
        {
            "name": effect.label,
            "cells": [_cell(effect, key, unit) for key, _ in columns],
            "direction": ""
            if effect.direction is None
            else f"{effect.direction:+.2f}".replace("-", "\N{MINUS SIGN}"),
        }
        for effect in sensitivity.effects
    ]


def _cell(effect: Effect, key: str, unit: Unit) -> str:
    if key in effect.estimates:
        return size(effect.estimates[key], key, unit)
    if key not in effect.more:
        return ""
    return told(effect.more[key], unit if key in ("mu", "sigma") else "")


def apart(sensitivity: Sensitivity, unit: Unit) -> dict[str, Any]:
    """The ordering measure of each factor in each combination of choices."""
    names = [effect.name for effect in sensitivity.effects if effect.kind == "factor"]
    measure = sensitivity.measure
    rows = []
    for name in names:
        cells = []
        for found in sensitivity.apart.values():
            own = next((e.estimates[measure] for e in found if e.name == name), None)
            cells.append("-" if own is None else size(own, measure, unit))
        rows.append((name, cells))
    return {"combinations": list(sensitivity.apart), "rows": rows}


BARS = 16


def varied(results: Results) -> list[dict[str, Any]]:
    """A row per factor: name, distribution in words, unit, heights of bars 0..1."""
    return [
        {
            "name": own.name,
            "distribution": own.distribution,
            "numbers": words(own),
            "bars": bars(results.table[own.column]),
        }
        for own in results.study.factors
    ]


def words(own: Factor) -> str:
    """The numbers of a distribution with their unit, such as `0.5 to 3 bar`."""
    unit = shown_factor(own)
    scale = factor(unit)
    ending = " times its value" if own.relative else f" {display(unit)}".rstrip()

    def told(key: str) -> str:
        value = own.numbers[key]
        assert not isinstance(value, tuple)
        return number(value * scale, 4)

    if own.distribution == "values":
        values = own.numbers["values"]
        assert isinstance(values, tuple)
        return ", ".join(number(value * scale, 4) for value in values) + ending
    if own.distribution in ("normal", "lognormal"):
        return f"mean {told('mean')}, standard deviation {told('sd')}{ending}"
    mode = f", most often {told('mode')}" if own.distribution == "triangular" else ""
    return f"{told('minimum')} to {told('maximum')}{ending}{mode}"


def bars(column: pd.Series) -> list[float]:
    """Heights of a histogram of what was drawn, the highest 1."""
    values = column.to_numpy(float)
    if not len(values) or np.ptp(values) == 0:
        return [1.0]
    counts, _ = np.histogram(values, bins=BARS)
    return [round(float(count / counts.max()), 3) for count in counts]


HERE = Path(__file__).parent / "templates"
# what all reports of this project look like, and what is particular to this one
STYLES = (Path(__file__).parents[2] / "results" / "templates" / "report.css", HERE / "study.css")
Picture = tuple[str, Markup, str]  # title, figure, caption
METHODS = {
    "latin": "Latin hypercube",
    "sobol": "Sobol' points",
    "grid": "full grid",
    "saltelli": "Saltelli design",
    "morris": "Morris trajectories",
}


def render(results: Results, analysis: Analysis) -> str:
    """The HTML text."""
    environment = Environment(
        loader=FileSystemLoader(HERE),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters.update(number=number, display=display, short=short)
    study = results.study
    outputs = {output.name: output for output in study.outputs}
    sections = [_section(results, outputs[f.name], f, k) for k, f in enumerate(analysis.findings)]
    return environment.get_template("study.html.j2").render(
        study=study,
        analysis=analysis,
        method=METHODS[study.method],
        measures=MEASURES,
        answers=[(k, f.name, sentences(f)) for k, f in enumerate(analysis.findings)],
        tiles=[_tile(finding) for finding in analysis.findings],
        varied=varied(results),
        sections=sections,
        bands=_bands(results),
        fixed=[_fixed(results, *item) for item in study.fixed.items()],
        style=Markup("\n".join(path.read_text(encoding="utf-8") for path in STYLES)),
    )


def as_json(results: Results, analysis: Analysis) -> str:
    """All numbers in the units of the FMUs, with the sentences; the same results give the same text."""
    found = {
        "study": asdict(results.study),
        **asdict(analysis),
        "sentences": {finding.name: sentences(finding) for finding in analysis.findings},
    }
    found["study"].pop("folder")  # where the study lies is no result
    return json.dumps(_plain(found), indent=1, allow_nan=False, ensure_ascii=False) + "\n"


def _fixed(results: Results, name: str, value: float) -> tuple[str, str]:
    """A number of all runs with its unit, where the name is that of one variable."""
    unit = seen(results.units.get(f"{START}{name}", ""), value)
    return name, f"{number(value * factor(unit), 6)} {display(unit)}".rstrip()


def _tile(finding: Finding) -> dict[str, Any]:
    """An output in one line."""
    if finding.spread is None:
        return {"name": finding.name, "value": "-", "range": "no run has it", "what": what(finding)}
    low, high = told(finding.spread.low, finding.seen, False), told(finding.spread.high, finding.seen)
    middle = told(finding.spread.median, finding.seen)
    ends = f"median; {low} to {high} in nine of ten runs"
    if finding.constant:
        ends = f"in all {finding.spread.runs} runs"
    return {"name": finding.name, "value": middle, "range": ends, "what": what(finding)}


def _section(results: Results, output: Output, finding: Finding, place: int) -> dict[str, Any]:
    """An output: figures and tables."""
    sensitivity = finding.sensitivity
    return {
        "finding": finding,
        "what": what(finding),
        "sentences": sentences(finding),
        "columns": _columns(results, output, finding, place),
        "spreads": spreads(finding),
        "heads": heads(sensitivity) if sensitivity else [],
        "effects": effects(sensitivity, finding.seen) if sensitivity else [],
        "apart": apart(sensitivity, finding.seen) if sensitivity and sensitivity.apart else None,
    }


def _columns(results: Results, output: Output, finding: Finding, place: int) -> list[list[Picture]]:
    """The figures of an output in two columns of about the same height."""
    sensitivity, left, right = finding.sensitivity, list[Picture](), list[Picture]()
    if sensitivity is not None:
        drawn = embed(tornado(finding, sensitivity), f"t{place}-", "tornado")
        left.append(("What moves it", drawn, left_out(sensitivity, finding.seen)))
        dots = scatter(results, output, finding, sensitivity)
        if dots is not None:
            words = "A dot for each run" + ("; the line is the median." if has_line(results) else ".")
            right.append(("The top factors", embed(dots, f"s{place}-", "scatter"), words))
    if finding.spread is not None and not finding.constant:
        drawn = embed(
            histogram(results, output, finding, colouring(results, sensitivity)), f"h{place}-", "histogram"
        )
        left.append(("How it spreads", drawn, "Dashed: 5, 50 and 95 % of the runs lie below."))
    return [column for column in (left, right) if column]


def left_out(sensitivity: Sensitivity, unit: Unit) -> str:
    """What a tornado does not show."""
    rest = sensitivity.effects[MOST:]
    if not rest:
        return ""
    largest = max(rest[0].estimates[sensitivity.measure].value, 0.0)
    bound = told(largest, unit) if sensitivity.measure == MU_STAR else f"{math.ceil(100 * largest)} %"
    return f"Not shown: {len(rest)} more, none with more than {bound}."


def _bands(results: Results) -> list[tuple[str, list[tuple[str, Markup]]]]:
    """Each kept signal: all runs, then a figure per choice."""
    found = []
    if results.bands is None or results.bands.empty or done(results).empty:
        return []
    for place, signal in enumerate(results.study.bands):
        largest = float(results.bands[signal].abs().max())
        unit = seen(results.units.get(signal, ""), largest)
        own = [("all runs", embed(bands(results, signal, unit, None), f"b{place}-", signal))]
        for k, choice in enumerate(results.study.compared):
            drawn = bands(results, signal, unit, choice)
            own.append((f"by {choice.what}", embed(drawn, f"b{place}-{k}-", f"{signal} by {choice.what}")))
        found.append((signal, own))
    return found


def _plain(values: Any) -> Any:
    """Mappings and sequences as JSON knows them; what is not finite becomes None."""
    if isinstance(values, Mapping):
        return {str(key): _plain(value) for key, value in values.items()}
    if isinstance(values, list | tuple):
        return [_plain(value) for value in values]
    if isinstance(values, float):
        return values if math.isfinite(values) else None
    return values


PAGE, NUMBERS = "report.html", "analysis.json"


def report(folder: Path) -> Path:
    """Analyse the finished study in a folder and write both files there; returns the path of the page."""
    results = read(folder)
    write(folder, results, analyse(results))
    return folder / PAGE


def write(folder: Path, results: Results, analysis: Analysis) -> None:
    """Both files; equal results give equal bytes."""
    texts = {NUMBERS: as_json(results, analysis), PAGE: render(results, analysis)}
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8", newline="\n")


__all__ = ["NUMBERS", "PAGE", "report", "write"]
