"""Report of a validation: one self-contained HTML file, and the same values as JSON.

The caller supplies all data of the run. A figure shows signals as in Figs. 10 and 11 of the paper: the
reference is a broad solid line, the simulation is dotted, and the strip below shows simulation - reference on
its own scale.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from markupsafe import Markup

from orchestrator.base.errors import Problem
from orchestrator.base.text import NO_VALUE, display_unit, error_display_unit, number, percentage, typeset
from orchestrator.base.units import in_reader_unit, reader_unit
from orchestrator.data.trace import Trace
from orchestrator.pages import html_page
from orchestrator.pages.figures import (
    PALETTE,
    REFERENCE,
    SIMULATION,
    TraceFigure,
    TraceLine,
    TracePanel,
    plot,
)
from orchestrator.results import summary
from orchestrator.results.layout import FigureSpec, PanelSpec
from orchestrator.results.validation import ValidatedSignal, Validation

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TEMPLATES = Path(__file__).with_name("templates")


@dataclass(frozen=True)
class ReportedComponent:
    """One FMU of the run."""

    name: str
    file: str
    version: str = ""
    guid: str = ""
    fmi: str = ""
    tool: str = ""
    text: str = ""
    sha256: str = ""


@dataclass(frozen=True)
class ReportedParameter:
    """One parameter of the run; `changed` if it was set for this run.

    shipped, origin   shipped value of a parameter that differs from it, and where its value comes from
    """

    component: str
    name: str
    value: float | int | bool | str
    unit: str = ""
    text: str = ""
    source: str = ""
    note: str = ""
    changed: bool = False
    shipped: float | int | bool | str | None = None
    origin: str = ""


@dataclass(frozen=True)
class Report:
    """Contents of a report.

    facts           settings of the run in the order of the report: system, scenario, master, step, ...
    card            accuracy card of the run: name -> number, text or a mapping of those
    trace           the run, for figures of signals that were not compared, such as commands
    machine         the machine that replays the run and can be driven, as HTML
    warnings        warnings of the run, one line each
    notes           remarks on the run
    caution         remark before the verdict
    """

    title: str
    validation: Validation
    figures: Sequence[FigureSpec] = ()
    trace: Trace | None = None
    facts: Mapping[str, Any] = field(default_factory=dict)
    components: Sequence[ReportedComponent] = ()
    parameters: Sequence[ReportedParameter] = ()
    card: Mapping[str, Any] = field(default_factory=dict)
    machine: Markup = Markup()  # noqa: RUF009  immutable
    warnings: Sequence[str] = ()
    notes: Sequence[str] = ()
    caution: str = ""


def write_report(path: Path | str, report: Report) -> tuple[Path, Path]:
    """Write the HTML to `path` and the JSON next to it; returns both paths."""
    html = Path(path)
    html_page.write_text(html, render(report))
    return html, html_page.write_json(html.with_suffix(".json"), as_dict(report))


def as_dict(report: Report) -> dict[str, Any]:
    """The report for the JSON file, in SI units or the declared unit of a signal."""
    validation = report.validation
    return {
        "title": report.title,
        "passed": validation.passed,
        "verdict": validation.verdict,
        "reference": {"file": validation.source, **validation.about},
        "window": {"start": validation.window[0], "stop": validation.window[1]},
        "signals": [_signal_dict(row) for row in validation.rows],
        "facts": report.facts,
        "accuracy": report.card,
        "components": report.components,
        "parameters": report.parameters,
        "notes": [*report.notes, *validation.notes],
        "warnings": report.warnings,
    }


def _signal_dict(row: ValidatedSignal) -> dict[str, Any]:
    metrics = asdict(row.metrics)
    metrics["iso"]["grade"] = row.metrics.iso.grade
    metrics.pop("notes")
    judged = row.tolerance and {**asdict(row.tolerance), "value": row.judged_value}
    return {
        "signal": row.signal,
        "label": row.label,
        "group": row.group,
        "unit": row.unit,
        "samples": len(row.time),
        "metrics": metrics,
        "tolerance": judged,
        "passed": row.passed,
        "notes": row.notes,
    }


def render(report: Report) -> str:
    """The page as HTML."""
    validation = report.validation
    return html_page.render(
        TEMPLATES / "validation_report.html.j2",
        title=report.title,
        report=report,
        checked=validation,
        tiles=[_tile(name, rows) for name, rows in validation.groups.items()],
        words=summary,
        error=lambda value, row: error_display_unit(row.unit).text(value),
        share=percentage,
        value=_value,
        figures=[(spec, plot(traces(spec, validation, report.trace), spec.title)) for spec in report.figures],
        plots=bool(report.figures),
    )


def _tile(name: str, rows: Sequence[ValidatedSignal]) -> dict[str, Any]:
    """Tile of a group: number of failed signals, and the signal with the largest use of its limit."""
    judged = [(row.limit_use, row) for row in rows if row.tolerance is not None]
    use, worst = max(judged, key=lambda entry: entry[0], default=(0.0, None))
    return {
        "name": name or "signals",
        "count": len(rows),
        "failed": sum(row.passed is False for _, row in judged),
        "judged": len(judged),
        "worst": worst,
        "use": min(use, 1.0),
        "share": summary.limit_share(use),
    }


def _value(value: Any) -> str:
    """Text of a value of facts, card or parameters."""
    if isinstance(value, bool) or value is None:
        return {True: "yes", False: "no", None: NO_VALUE}[value]
    return typeset(number(value, 6)) if isinstance(value, float) else str(value)


def draw(spec: FigureSpec, validation: Validation, trace: Trace | None = None) -> Figure:
    """The figure of a validation with its title, drawn by matplotlib."""
    from orchestrator.pages import plotting

    return plotting.draw(replace(traces(spec, validation, trace), title=spec.title))


def traces(spec: FigureSpec, validation: Validation, trace: Trace | None = None) -> TraceFigure:
    """Figure of a validation; signals that were not compared, such as commands, are from the trace."""
    panels = [_panel(spec, panel, validation, trace) for panel in spec.panels]
    return TraceFigure(panels, validation.window, key=(("reference", REFERENCE), ("simulation", SIMULATION)))


def _panel(spec: FigureSpec, panel: PanelSpec, validation: Validation, trace: Trace | None) -> TracePanel:
    """Signals of a panel, from the comparison, or from the trace if they were not compared."""
    rows = {row.signal: row for row in validation.rows}
    lines, errors, units = list[TraceLine](), list[TraceLine](), set[str]()
    compared: list[tuple[str, ValidatedSignal]] = []
    for i, signal in enumerate(panel.signals):
        light, dark = PALETTE.pair(i)
        name = panel.names[i] if i < len(panel.names) else ""
        if signal in rows:
            row = rows[signal]
            units.add(reader_unit(row.unit))
            simulation, reference = (in_reader_unit(y, row.unit) for y in (row.simulation, row.reference))
            broad, dotted = {**REFERENCE, "color": light}, {**SIMULATION, "color": dark}
            lines.append(TraceLine(row.time, reference, broad, name, "reference"))
            lines.append(TraceLine(row.time, simulation, dotted, key="simulation"))
            if row.passed is not None or not validation.judged:
                errors.append(TraceLine(row.time, simulation - reference, {"color": dark}, name))
            compared.append((name, row))
        elif trace is not None and signal in trace.signals:
            unit = trace.units.get(signal, "")
            units.add(reader_unit(unit))
            values = in_reader_unit(trace[signal], unit)
            lines.append(TraceLine(trace.time, values, {"color": dark, "linewidth": 1.2}, name))
        else:
            expected = "expected a signal of the comparison or of the run"
            raise Problem(f"figure {spec.title!r}: {expected}, got {signal!r}")
    return TracePanel(
        unit=", ".join(sorted(units)),
        lines=lines,
        label=panel.label,
        errors=errors,
        error_unit=", ".join(sorted(units)),
        bounds={bound for _, row in compared for bound in _bounds(row)},
        remarks=[_verdict(name, row) for name, row in compared if row.tolerance],
        heights=(2.5 if errors else 1.5, 1.0),
    )


def _verdict(name: str, row: ValidatedSignal) -> tuple[str, str]:
    """Text with the judged value and its limit, and its colour."""
    value = summary.judged_text(row, row.judged_value)
    text = f"{'✓' if row.passed else '✗'} {name} {value}\n{summary.limit_text(row)}".replace("  ", " ")
    return text, PALETTE.good if row.passed else PALETTE.bad


def _bounds(row: ValidatedSignal) -> Iterable[float]:
    """The limit as an error in the display unit, for metrics that have one."""
    if row.tolerance is not None and row.tolerance.metric in ("nrmse", "rmse", "maximum"):
        scale = 1.0 if row.tolerance.in_unit else row.metrics.normalised_by
        yield row.tolerance.limit * scale * display_unit(row.unit).factor
