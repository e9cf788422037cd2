"""Report of a validation: what `harvester validate` prints, its page, and its numbers for programs.

The page answers first: pass or not, the signal with the largest use of its limit, and the machine to drive.
A figure shows signals as in Figs. 10 and 11 of the paper: the reference is a broad solid line, the simulation
is dotted, and the strip below shows simulation - reference on its own scale.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, replace
from operator import itemgetter
from types import MappingProxyType
from typing import Any

from markupsafe import Markup, escape

from orchestrator.base.errors import Problem
from orchestrator.base.text import (
    NO_VALUE,
    TextTable,
    display_unit,
    error_display_unit,
    grouped,
    number,
    percentage,
    short_names,
    typeset,
)
from orchestrator.base.units import in_reader_unit, pretty, reader_unit
from orchestrator.data.trace import Trace
from orchestrator.pages.figures import PALETTE, REFERENCE, SIMULATION, TraceFigure, TraceLine, TracePanel
from orchestrator.pages.html_page import breakable, upper_first
from orchestrator.results.layout import FigureSpec, PanelSpec
from orchestrator.results.metrics import GIVEN
from orchestrator.results.rating import PARTS
from orchestrator.results.report import TERMINAL, Facts, Figure, Machine, Part, Report, Section, Table, Text
from orchestrator.results.validation import ValidatedSignal, Validation

NAMES = {
    "nrmse": "NRMSE",
    "rmse": "RMSE",
    "maximum": "max. error",
    "maximum_relative": "max. relative error",
    "fit": "fit",
    "vaf": "VAF",
    "iso18571": (RATED := "ISO/TS 18571"),
}
ALMOST = 99.99  # [%]
MISSED = 20  # signals outside their limits that are listed
SAME_EQUATIONS = (
    "Reference: a simulation of the same equations. Pass means that the co-simulation is accurate, not that"
    " the model agrees with a machine"
)
METRICS = (
    "Error = simulation - reference. NRMSE: RMSE over the range of the reference. Fit:"
    " 100 (1 - ‖error‖ / ‖reference - its mean‖). VAF: variance accounted for,"
    " 100 (1 - var(error) / var(reference))"
)


def validation_report(
    title: str,
    validation: Validation,
    figures: Sequence[FigureSpec] = (),
    trace: Trace | None = None,
    run: Mapping[str, Any] = MappingProxyType({}),
    machine: Markup = Markup(),  # noqa: B008  immutable
    caution: str = "",
) -> Report:
    """The report of a validation.

    trace        the run, for figures of signals that were not compared, such as commands
    run          facts: settings of the run; accuracy: its card; notes; warnings
                 components: of each FMU name, file, version, fmi, tool, text, guid, sha256
                 parameters: component, name, value, unit, text, source, note; `changed` if it was set for
                 this run; `shipped` and `origin` of one that differs from the shipped value
    machine      the machine that replays the run and can be driven, as HTML
    caution      remark before the verdict
    """
    none = dict.fromkeys(("components", "parameters", "notes", "warnings"), ())
    run = {"facts": {}, "accuracy": None, **none, **run}
    simulated = str(validation.about.get("kind", "")).startswith("simulation")
    start, stop = validation.window
    against = f"Compared with {validation.title} from {number(start)} to {number(stop)} s"
    changed = sum(bool(p.get("changed")) for p in run["parameters"])
    of_run = f", {changed} changed for this run" if changed else ""
    told = run["accuracy"].text().splitlines() if run["accuracy"] else ()
    card = Text([line for line in told if not line.startswith(("note: ", "warning: "))], "pre")
    about = {"file": validation.source, **validation.about}
    drawn = [(f.title, Figure(traces(f, validation, trace), f.title, f.caption)) for f in figures]
    of_parameters = f"Parameters ({len(run['parameters'])}{of_run})"
    parts: list[Part] = [
        Text(_summary(validation), only=TERMINAL),
        _numbers(validation),
        *_worst(validation, trace),
        ratings(validation.rows, RATED),
        Machine(machine),
        Section("Warnings of the run", [Text(run["warnings"], "warn")]),
        *(Section(name, [figure]) for name, figure in drawn),
        Section("Signals", [Table(_signals(validation)), Text([METRICS], "soft")], folded=True),
        Section("Run", [Facts(run["facts"]), card, Text(run["notes"], "soft")], folded=True),
        Section("FMUs", [_components(run["components"])], folded=True),
        Section(of_parameters, [Table(_parameters(run["parameters"]))], True),
        Section("Reference", [Facts(about), Text(validation.notes, "soft")], folded=True),
    ]
    data = {
        "reference": about,
        "window": {"start": start, "stop": stop},
        "signals": [_data(row) for row in validation.rows],
        **run,
        "notes": [*run["notes"], *validation.notes],
    }
    passed = validation.passed if validation.judged or validation.unreliable else None
    lead = [against, caution or (SAME_EQUATIONS if simulated else "")]
    return Report(title, validation.verdict, parts, data, passed, list(filter(None, lead)))


def summary(validation: Validation) -> str:
    """What a terminal shows: failed signals, a table, notes, and the verdict as the last line."""
    return validation_report("", validation).text()


def _data(row: ValidatedSignal) -> dict[str, Any]:
    """A signal for programs, in SI units or its declared unit."""
    metrics = asdict(row.metrics)
    metrics.pop("notes")
    return {
        **{name: getattr(row, name) for name in ("signal", "label", "group", "unit")},
        "samples": len(row.time),
        "metrics": metrics,
        "tolerance": row.tolerance and {**asdict(row.tolerance), "value": row.judged_value},
        "passed": row.passed,
        "notes": row.notes,
    }


def ratings(rows: Iterable[ValidatedSignal], title: str) -> Table:
    """Table of the signals that were rated by ISO/TS 18571, and why some of them have no rating."""
    cells, below = list[list[str]](), list[str]()
    for row in rows:
        if rating := row.metrics.iso18571:
            values = (getattr(rating, part) for part in PARTS)
            numbers = [NO_VALUE if value is None else f"{value:.3f}" for value in values]
            cells.append([row.signal, *numbers, rating.grade])
            below += [f"{row.signal}: {rating.grade}, {rating.reason}"] if rating.reason else []
    return Table(TextTable([title, *PARTS, "grade"], cells, left=(0, len(PARTS) + 1)), below)


# ---- parts of the page


def _worst(validation: Validation, trace: Trace | None) -> list[Figure]:
    """The signal with the largest use of its limit, else with the largest NRMSE, beside its limit.

    A signal that is not listed is only shown if it fails.
    """
    rows = validation.judged or validation.rows
    rows = validation.failed or tuple(row for row in rows if row.listed) or rows
    if not rows:
        return []
    row = max(rows, key=lambda row: (row.limit_use, row.metrics.nrmse or 0.0))
    figure = traces(FigureSpec("", (PanelSpec("", (row.signal,)),)), validation, trace)
    panel = replace(figure.panels[0], remarks=(), heights=(4.0, 2.2), whole=True)
    if row.tolerance is None:
        caption = f"NRMSE {percentage(row.metrics.nrmse)}; no limit."
    else:
        limits = f"{judged_text(row, row.judged_value)}; limit: {limit_text(row)}"
        band = " Green: errors within the limit." if panel.bounds else ""
        caption = (
            f"Uses {limit_share(row.limit_use)} of its limit. {NAMES[row.tolerance.metric]}: {limits}.{band}"
        )
    heading = f"Worst signal: {row.title}"
    return [Figure(replace(figure, panels=[panel]), row.title, typeset(caption), heading)]


def _signals(validation: Validation) -> TextTable:
    """All signals with their metrics, by group."""
    rows: list[list[str]] = []
    soft = Markup('<br><span class="soft">{}</span>')
    for name, members in validation.groups.items():
        rows += [[upper_first(name)]] if name else []
        for row in members:
            m, unit = row.metrics, error_display_unit(row.unit)
            label = Markup("{}<br>").format(row.label) if row.label else Markup()
            state = "pass" if row.passed else "fail"
            result = Markup('<span class="mark {}">{}</span>').format(state, state) + soft.format(
                typeset(f"{limit_share(row.limit_use)} of {limit_text(row)}")
            )
            rows.append(
                [
                    label + Markup("<code>{}</code>").format(breakable(row.signal)),
                    result if row.tolerance else "not judged",
                    percentage(m.nrmse),
                    escape(unit.text(m.maximum_error)) + soft.format(f"at {m.time_of_maximum:.2f} s"),
                    unit.text(m.rmse),
                    percent(m.fit, m.rmse),
                    percent(m.vaf, m.rmse),
                ]
            )
            rows += [[f"{row.signal}: {note}"] for note in row.notes]
    head = ["signal", "result", "NRMSE over range", "max. error", "RMSE", "fit", "VAF"]
    return TextTable(head, rows, left=(0, 1))


def _components(components: Sequence[Mapping[str, str]]) -> Table:
    """The FMUs of a run."""
    keys = ("name", "file", "version", "fmi", "tool", "text", "guid", "sha256")
    rows = [[c.get(key) or "" for key in keys] for c in components]
    head = ["component", "file", "version", "FMI", "tool", "text", "GUID", "SHA-256 of the file"]
    return Table(TextTable(head, rows, left=range(len(head))))


def _parameters(parameters: Sequence[Mapping[str, Any]]) -> TextTable:
    """All parameters, by component."""
    rows: list[list[str]] = []
    for component, members in grouped(parameters, itemgetter("component")).items():
        rows.append([component])
        for p in members:
            name = Markup("<code>{}</code>").format(breakable(p["name"]))
            name += Markup(' <span class="mark none">changed</span>') if p.get("changed") else ""
            shipped = f"; shipped: {_value(p['shipped'])}" if p.get("shipped") is not None else ""
            origin = p.get("origin")
            name += Markup('<br><span class="soft">{}{}</span>').format(origin, shipped) if origin else ""
            texts = (p.get("text", ""), p.get("note", ""))
            row = [name, _value(p["value"]), pretty(p.get("unit", "")), p.get("source", "")]
            rows.append([*row, " ".join(filter(None, texts))])
    return TextTable(["parameter", "value", "unit", "source", "meaning"], rows, left=(0, 2, 3, 4))


def _value(value: Any) -> str:
    return number(value, 6) if isinstance(value, float) else str(value)


# ---- text for a terminal


def percent(value: float | None, rmse: float = 0.0) -> str:
    """Fit or VAF [%], rounded down. 100 % means that there is no error at all: otherwise it is `> 99.99 %`.

    rmse   of the signal: the squares in VAF lose an error of 1e-9, which fit still shows
    """
    if value is None:
        return NO_VALUE
    if value >= ALMOST and (value < 100 or rmse > 0):
        return f"> {ALMOST} %"
    return f"{math.floor(100 * value) / 100:.2f} %"


def judged_text(row: ValidatedSignal, value: float | None) -> str:
    """A value or limit of the judged metric with its unit or percent sign."""
    if row.tolerance is None or value is None:
        return NO_VALUE
    if row.tolerance.in_unit:
        return error_display_unit(row.unit).ascii(value)
    if row.tolerance.metric in ("nrmse", "maximum_relative"):
        return percentage(value)
    rounded = f"{math.floor(1e4 * value + 1e-6) / 1e4:g}"  # a rating, fit or VAF, rounded down
    return rounded if row.tolerance.metric == "iso18571" else f"{rounded} %"


def limit_text(row: ValidatedSignal) -> str:
    """The limit with its metric, such as `NRMSE ≤ 0.5 %`."""
    if row.tolerance is None:
        return NO_VALUE
    sign = "≤" if row.tolerance.upper else "≥"
    return f"{NAMES[row.tolerance.metric]} {sign} {judged_text(row, row.tolerance.limit)}"


def limit_share(use: float) -> str:
    """Use of a limit in percent, rounded up, so that only a kept limit is shown as at most 100 %."""
    # infinite without a value of the metric
    tenths = max(math.ceil(min(1000 * use, 1e6) - 1e-9), int(use > 0))
    return "over 100 times" if tenths > 99_999 else f"{tenths / 10:g} %"


def miss_text(row: ValidatedSignal) -> str:
    """How much a failed row exceeds its limit, such as `NRMSE 0.73 %, limit 0.5 % (1.46 times)`."""
    if row.tolerance is None or row.passed:
        return ""
    metric, allowed, value = NAMES[row.tolerance.metric], row.tolerance.limit, row.judged_value
    limits = f"limit {judged_text(row, allowed)}"
    if value is None:
        rating = row.metrics.iso18571
        reason = rating.reason if rating else "; ".join(row.notes)
        return f"no {metric}, {limits}" + (f" ({reason})" if reason else "")
    if not row.tolerance.upper:
        return f"{metric} {judged_text(row, value)}, {limits} ({judged_text(row, allowed - value)} short)"
    ratio = value / allowed
    return f"{metric} {judged_text(row, value)}, {limits} ({number(ratio, 3 if ratio > 1.01 else 9)} times)"


def _summary(validation: Validation) -> list[str]:
    """Why a run is not reliable, and the failed signals, the worst first."""
    lines = [f"FAIL: {reason}" for reason in validation.unreliable]
    if failed := sorted(validation.failed, key=lambda row: -row.limit_use):
        verb = "is outside its limit" if len(failed) == 1 else "are outside their limits"
        lines.append(f"FAIL: {len(failed)} of {len(validation.judged)} signals {verb}")
        lines += [f"! {row.signal}: {miss_text(row)}" for row in failed[:MISSED]]
        lines += [f"! {len(failed) - MISSED} more, in the report"] if len(failed) > MISSED else []
    return lines


def _numbers(validation: Validation) -> Table:
    """The listed signals by group, unit and metric; those without limit are last."""
    listed = [row for row in validation.rows if row.listed]
    names, rows = short_names(row.signal for row in listed), list[list[str]]()
    for title, members in grouped(sorted(listed, key=lambda row: row.tolerance is None), _section).items():
        rows.append([title + _limits(members)])
        for row in members:
            m, unit, mark = row.metrics, error_display_unit(row.unit), "!" if row.passed is False else " "
            shares = percentage(m.nrmse), percent(m.fit, m.rmse), percent(m.vaf, m.rmse)
            plain = [text.removesuffix(" %").replace("> ", ">") for text in shares]
            used = NO_VALUE if row.passed is None else limit_share(row.limit_use)
            used = f"FAIL {used}" if row.passed is False else used
            cells = [unit.plain(m.maximum_error), unit.plain(m.rmse), *plain, used]
            rows.append([f"{mark} {names[row.signal]}", *cells])
    others = [row.limit_use for row in validation.rows if not row.listed]
    below = [f"{len(others)} others: at most {limit_share(max(others))} of their limits"] if others else []
    below.append("NRMSE: over the range of the reference, or a given one")
    head = ["", "max error", "RMSE", "NRMSE %", "fit %", "VAF %", "of limit"]
    table = TextTable(head, rows, title=f"Compared with: {validation.title}")
    return Table(table, [*below, *validation.notes, *_remarks(validation)], only=TERMINAL)


def _section(row: ValidatedSignal) -> str:
    """Group, unit and judged metric of a signal."""
    judged = NAMES[row.tolerance.metric] if row.tolerance else "not judged"
    return f"{row.group or 'signals'} [{error_display_unit(row.unit).display or '1'}]: {judged}"


def _limits(members: Sequence[ValidatedSignal]) -> str:
    """The limit of signals with one metric, or the ends of their limits; empty if they are not judged."""
    judged = sorted((row.tolerance.limit, k) for k, row in enumerate(members) if row.tolerance)
    ends = dict.fromkeys(judged_text(members[k], limit) for limit, k in (judged[:1] + judged[-1:]))
    return f", limit {' to '.join(ends)}" if ends else ""


def _remarks(validation: Validation) -> list[str]:
    """Each note with its signals that are listed; given ranges are in the report."""
    listed = ((note, row.signal) for row in validation.rows for note in row.notes if row.listed)
    notes = grouped((pair for pair in listed if not pair[0].startswith(GIVEN)), itemgetter(0))
    return [f"{note}: {', '.join(signal for _, signal in pairs)}" for note, pairs in notes.items()]


# ---- figures


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
    value = judged_text(row, row.judged_value)
    text = f"{'✓' if row.passed else '✗'} {name} {value}\n{limit_text(row)}".replace("  ", " ")
    return text, PALETTE.good if row.passed else PALETTE.bad


def _bounds(row: ValidatedSignal) -> Iterable[float]:
    """The limit as an error in the display unit, for metrics that have one."""
    if row.tolerance is not None and row.tolerance.metric in ("nrmse", "rmse", "maximum"):
        scale = 1.0 if row.tolerance.in_unit else row.metrics.normalised_by
        yield row.tolerance.limit * scale * display_unit(row.unit).factor
