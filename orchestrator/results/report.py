"""The report of a validation: one self-contained HTML file, and the same numbers as JSON.

The HTML needs no network: styles, script, figures (SVG) and the motion's data are inside. What ran is data
handed in by the caller; this module knows no system.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from orchestrator.data.trace import Trace
from orchestrator.results import summary
from orchestrator.results.compare import Row, Validation
from orchestrator.results.figures import FigureSpec, draw, embed
from orchestrator.results.motion import Motion, frames, strobe

TEMPLATES = Path(__file__).with_name("templates")


@dataclass(frozen=True)
class Component:
    """One FMU of the run."""

    name: str
    file: str
    version: str = ""
    guid: str = ""
    fmi: str = ""
    tool: str = ""
    text: str = ""


@dataclass(frozen=True)
class Parameter:
    """One parameter of the run; source and note where they are known, changed when set for this run."""

    component: str
    name: str
    value: float | int | bool | str
    unit: str = ""
    text: str = ""
    source: str = ""
    note: str = ""
    changed: bool = False


@dataclass(frozen=True)
class Report:
    """What to report.

    facts    what ran, in the order to show: system, scenario, master, step, start, stop, command line ...
    card     the accuracy card of the run: name -> number, text or a mapping of those
    trace    the run: for figures of signals that were not compared, such as commands
    motion, ghost   the machine's motion in the run and in the reference
    warnings        what the run reported, one line each
    notes           remarks on the run
    caution         what to know before the verdict is read
    """

    title: str
    validation: Validation
    figures: Sequence[FigureSpec] = ()
    trace: Trace | None = None
    facts: Mapping[str, Any] = field(default_factory=dict)
    components: Sequence[Component] = ()
    parameters: Sequence[Parameter] = ()
    card: Mapping[str, Any] = field(default_factory=dict)
    motion: Motion | None = None
    ghost: Motion | None = None
    warnings: Sequence[str] = ()
    notes: Sequence[str] = ()
    caution: str = ""


def write_report(path: Path | str, report: Report) -> tuple[Path, Path]:
    """Write the HTML to `path` and the JSON beside it; returns both paths."""
    html = Path(path)
    html.parent.mkdir(parents=True, exist_ok=True)
    html.write_text(render(report), encoding="utf-8", newline="\n")
    data = html.with_suffix(".json")
    data.write_text(
        json.dumps(numbers(report), indent=1, allow_nan=False) + "\n", encoding="utf-8", newline="\n"
    )
    return html, data


def numbers(report: Report) -> dict[str, Any]:
    """All numbers and texts of the report in SI or the signal's stated unit, ready for JSON."""
    checked = report.validation
    return {
        "title": report.title,
        "passed": checked.passed,
        "verdict": checked.verdict,
        "reference": {"file": checked.source, **checked.about},
        "window": {"start": checked.window[0], "stop": checked.window[1]},
        "signals": [_row(row) for row in checked.rows],
        "facts": _plain(report.facts),
        "accuracy": _plain(report.card),
        "components": [asdict(component) for component in report.components],
        "parameters": [_plain(asdict(parameter)) for parameter in report.parameters],
        "notes": [*report.notes, *checked.notes],
        "warnings": list(report.warnings),
    }


def render(report: Report) -> str:
    """The HTML text."""
    environment = Environment(
        loader=FileSystemLoader(TEMPLATES),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["figure"] = _number
    checked = report.validation
    movement = None if report.motion is None else frames(report.motion, report.ghost)
    return environment.get_template("report.html.j2").render(
        report=report,
        checked=checked,
        groups=checked.groups,
        tiles=[_tile(name, rows) for name, rows in checked.groups.items()],
        words=summary,
        figures=[
            (spec, embed(draw(spec, checked, report.trace), f"f{k}-", spec.title))
            for k, spec in enumerate(report.figures)
        ],
        motion=None if movement is None else _script(movement),
        still=None if report.motion is None else embed(strobe(report.motion), "m-", "motion"),
        style=Markup((TEMPLATES / "report.css").read_text(encoding="utf-8")),
        script=Markup((TEMPLATES / "motion.js").read_text(encoding="utf-8")),
    )


def _row(row: Row) -> dict[str, Any]:
    """One signal's numbers as a mapping."""
    judged = None
    if row.tolerance is not None:
        judged = {**asdict(row.tolerance), "value": row.judged_value}
    metrics = asdict(row.metrics)
    metrics["iso"]["grade"] = row.metrics.iso.grade
    metrics.pop("notes")
    return {
        "signal": row.signal,
        "label": row.label,
        "group": row.group,
        "unit": row.unit,
        "samples": len(row.time),
        "metrics": metrics,
        "tolerance": judged,
        "passed": row.passed,
        "notes": list(row.notes),
    }


def _tile(name: str, rows: Sequence[Row]) -> dict[str, Any]:
    """A group in one line: how many are within limits, and the one that comes closest to its limit."""
    judged = [(row.limit_use, row) for row in rows if row.tolerance is not None]
    use, worst = max(judged, key=lambda entry: entry[0], default=(None, None))
    return {
        "name": name or "signals",
        "count": len(rows),
        "failed": sum(row.passed is False for _, row in judged),
        "judged": len(judged),
        "worst": worst,
        "use": None if use is None else min(use, 1.0),
    }


def _plain(values: Any) -> Any:
    """Mappings, sequences and NumPy numbers as JSON knows them; what is not finite becomes None."""
    if isinstance(values, Mapping):
        return {str(key): _plain(value) for key, value in values.items()}
    if isinstance(values, str | bool | int) or values is None:
        return values
    if isinstance(values, Iterable):
        return [_plain(value) for value in values]
    if isinstance(values, float) or hasattr(values, "__float__"):
        return float(values) if abs(float(values)) < float("inf") else None
    return str(values)


def _number(value: Any) -> str:
    """A value of facts, card or parameters as text."""
    if isinstance(value, bool) or value is None:
        return {True: "yes", False: "no", None: summary.NONE}[value]
    return summary.number(value, 6) if isinstance(value, float) else str(value)


def _script(data: Any) -> Markup:
    """Data for a script element; `<` could otherwise end it."""
    return Markup(json.dumps(data, separators=(",", ":")).replace("<", "\\u003c"))
