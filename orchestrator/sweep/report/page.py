"""The page of a study: one self-contained HTML file, and the same numbers as JSON.

The HTML needs no network: styles and figures (SVG) are inside.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from orchestrator.sweep.analysis import Analysis, Finding, Sensitivity, sentences
from orchestrator.sweep.analysis.outcome import MU_STAR, short
from orchestrator.sweep.analysis.results import done
from orchestrator.sweep.analysis.wording import MEASURES, what
from orchestrator.sweep.report import tables
from orchestrator.sweep.report.scatter import colouring, has_line, scatter
from orchestrator.sweep.report.spreads import bands, histogram
from orchestrator.sweep.report.tornado import MOST, tornado
from orchestrator.sweep.report.varied import varied
from orchestrator.sweep.store import Results
from orchestrator.sweep.study import START, Output
from orchestrator.sweep.units import Unit, display, factor, number, seen, told
from orchestrator.validation.embed import embed

HERE = Path(__file__).parent / "templates"
# what all reports of this project look like, and what is particular to this one
STYLES = (Path(__file__).parents[2] / "validation" / "templates" / "report.css", HERE / "study.css")
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
        "spreads": tables.spreads(finding),
        "heads": tables.heads(sensitivity) if sensitivity else [],
        "effects": tables.effects(sensitivity, finding.seen) if sensitivity else [],
        "apart": tables.apart(sensitivity, finding.seen) if sensitivity and sensitivity.apart else None,
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
