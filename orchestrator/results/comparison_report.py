"""Report of a comparison of runs.

The figure shows each signal of all runs, and below it the differences from the reference.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from markupsafe import Markup

from orchestrator.base.text import (
    NO_VALUE,
    TextTable,
    error_display_unit,
    first_names,
    grouped,
    join_words,
    number,
    percentage,
)
from orchestrator.base.units import convert, factor_and_offset, reader_unit
from orchestrator.data.trace import inside
from orchestrator.engine.result import RunMetadata
from orchestrator.pages.figures import REFERENCE, Style, TraceFigure, TraceLine, TracePanel, curve_style
from orchestrator.pages.html_page import typeset_table
from orchestrator.results.comparison import (
    CONSTANT,
    DEFAULT_QUANTITIES,
    Cell,
    Comparison,
    Run,
    different_fmus,
    different_values,
)
from orchestrator.results.metrics import AT_REST, HARDLY_MOVES
from orchestrator.results.report import PAGE, TERMINAL, Figure, Part, Report, Section, Table, Text
from orchestrator.results.validation import ValidatedSignal
from orchestrator.results.validation_report import RATED, ratings
from orchestrator.ssp.provenance import value_text

SIDE_BY_SIDE = 3  # runs in a table of signals
MOST_PANELS = 6  # of a figure on one page
MOST_OF_QUANTITY = 3  # panels
MOST_VALUES = 15  # rows of parameters in which runs differ
# metadata of a run in comparison.json -> unit
WRITTEN = {
    **dict.fromkeys(("system", "fmus", "swapped", "given", "provenance", "master", "coupling"), ""),
    **{"step": "s", "steps": "", "passes": "", "repeated": "", "simulated": "s", "wall": "s", "inside": "s"},
}
FLOORED = " *"  # after an NRMSE over the floor
EQUAL = "equal"


def drawn_signals(comparison: Comparison) -> list[str]:
    """The signals of the figure: the worst one, then of each quantity those with the largest differences."""
    chosen = set(comparison.signals)
    rows = [row for v in comparison.against.values() for row in v.rows if row.signal in chosen]
    rows = _different(comparison) or rows
    groups = grouped(sorted(rows, key=lambda row: -row.metrics.maximum_error), lambda row: row.group)
    most = MOST_OF_QUANTITY if len(groups) > 1 else MOST_PANELS
    shown = {name for of in groups.values() for name in list(dict.fromkeys(r.signal for r in of))[:most]}
    first = [found[1].signal] if (found := _worst_of_all(comparison)) else []
    worst = [name for name in first if name in chosen or not comparison.requested]
    return list(dict.fromkeys([*worst, *(n for n in comparison.signals if n in shown)]))[:MOST_PANELS]


def _different(comparison: Comparison) -> list[ValidatedSignal]:
    """The rows of the signals to show, of all runs, without those that are equal."""
    runs, chosen = comparison.against, set(comparison.signals)
    return [r for n in runs for r in runs[n].rows if r.signal in chosen and not comparison.equal(n, r)]


def traces(comparison: Comparison, signals: Sequence[str] | None = None) -> TraceFigure:
    """The figure; default signals: those of the comparison with the largest differences."""
    reference, broad = comparison.reference, {**REFERENCE, "linewidth": 2.8, "alpha": 0.6}
    shown: list[tuple[Run, str, Style]] = [(reference, f"{reference.label} (reference)", broad)]
    for i, run in enumerate(run for run in comparison.runs if run.label in comparison.against):
        shown.append((run, run.label, {**curve_style(i, i), "linewidth": 1.2}))
    names = drawn_signals(comparison) if signals is None else signals
    panels = [_panel(comparison, shown, name) for name in names]
    return TraceFigure(panels, comparison.window, key=[(label, style) for _, label, style in shown])


def _panel(comparison: Comparison, shown: Sequence[tuple[Run, str, Style]], name: str) -> TracePanel:
    """A signal of all runs, and below it its differences from the reference."""
    unit = comparison.reference.trace.units.get(name, "")
    lines, errors, error_unit = list[TraceLine](), list[TraceLine](), ""
    for run, label, style in shown:
        time, values = run.trace.time, run.trace[name]
        within = inside(time, *comparison.window)
        converted = convert(values[within], run.trace.units.get(name, unit), reader_unit(unit), name)
        lines.append(TraceLine(time[within], converted, style, key=label))
        if run is not comparison.reference:
            row = comparison.against[run.label][name]
            error_unit = error_unit or error_display_unit(row.unit).display
            factor, _ = factor_and_offset(row.unit, error_unit, name)
            errors.append(TraceLine(row.time, factor * (row.simulation - row.reference), style, key=label))
    return TracePanel(
        reader_unit(unit), lines, "", name, errors, "difference", error_unit, heights=(2.5, 1.2)
    )


def tables(comparison: Comparison) -> Iterator[Table]:
    """All tables."""
    if any(run.metadata for run in comparison.runs):
        yield from _costs(comparison)
    yield from _different_values(comparison)
    for label in comparison.against:
        yield Table(_worst(comparison, label))
    yield from map(Table, _signals(comparison))
    for label, validation in comparison.against.items():
        yield ratings(validation.rows, f"{RATED}, {label}")


def worst_tables(comparison: Comparison) -> Iterator[TextTable]:
    """The worst signals of each run, as on the page."""
    return (typeset_table(_worst(comparison, label)) for label in comparison.against)


def _different_values(comparison: Comparison) -> Iterator[Table]:
    """Table of the parameters in which the runs differ, with their origins; and FMUs that differ."""
    runs, values = comparison.runs, different_values(comparison.runs)
    shown = list(values.items())[:MOST_VALUES]
    rows = [[name, reader_unit(u), *(_value_cell(cell, u) for cell in cells)] for (name, u), cells in shown]
    head = ["parameters that differ", "unit", *(run.label for run in runs)]
    below = []
    if len(values) > MOST_VALUES:
        below.append(f"and {len(values) - MOST_VALUES} more, all of them in comparison.json")
    if others := different_fmus(runs):
        below.append(f"the FMU files of {join_words(others)} differ")
    if rows or below:
        yield Table(TextTable(head, rows, left=(0, 1)), below)


def _value_cell(cell: Cell | None, unit: str) -> str:
    if cell is None:
        return NO_VALUE
    value, origin = cell
    return f"{value_text(value, unit)} ({origin})" if origin else value_text(value, unit)


def _notes(comparison: Comparison) -> Iterator[str]:
    """Notes on all runs first, then on single runs."""
    yield from comparison.notes
    rows = (comparison.worst(label, q) for label in comparison.against for q in comparison.quantities())
    if any(row and CONSTANT in row.notes for row in rows):
        yield f"{CONSTANT}: its NRMSE is over the range of both runs"
    if any(FLOORED in _cells(row)[0] for row in _different(comparison)):
        yield f"{FLOORED.strip()} {HARDLY_MOVES}: NRMSE over {percentage(AT_REST)} of the nominal value"
    notes = {label: validation.notes for label, validation in comparison.against.items()}
    for note in dict.fromkeys(note for of_run in notes.values() for note in of_run):
        labels = [label for label, of_run in notes.items() if note in of_run]
        yield note if len(labels) == len(comparison.against) else f"{', '.join(labels)}: {note}"


def _costs(comparison: Comparison) -> Iterator[Table]:
    """Table of masters, steps and times of the runs, and table of the times inside each FMU."""
    runs, reference = comparison.runs, comparison.reference
    head = ["run", "master", "step", "real-time factor", "total [us/ms]", "in FMUs [us/ms]"]
    head.append("in FMUs, relative")
    rows = [_cost(run, reference) for run in runs]
    swapped = {run.label: run.metadata.swapped for run in runs if run.metadata}
    swaps = [f"{n}: swapped {c} for {Path(file).stem}" for n, of in swapped.items() for c, file in of.items()]
    note = f"us/ms: computing time per simulated millisecond; relative: in FMUs, {reference.label} is 1"
    yield Table(TextTable(head, rows, left=(0, 1)), [*swaps, note])
    inside = {run.label: _inside(run.metadata) for run in runs}
    components = list(dict.fromkeys(name for times in inside.values() for name in times))
    rows = [[label, *(number(times.get(name), 2) for name in components)] for label, times in inside.items()]
    yield Table(TextTable(["in each FMU [us/ms]", *components], rows))


def _cost(run: Run, reference: Run) -> list[str]:
    if run.metadata is None:
        return [run.label, *[NO_VALUE] * 6]
    meta, length = run.metadata, run.metadata.simulated or float("nan")
    of_reference, total = sum(_inside(reference.metadata).values()), sum(_inside(meta).values())
    return [
        run.label,
        meta.master,
        f"{meta.step:.3g} s mean" if meta.adaptive else f"{meta.step:g} s",
        number(length / meta.wall if meta.wall else None),
        number(1e3 * meta.wall / length),
        number(total, 2),
        number(total / of_reference if of_reference else None, 2),
    ]


def _inside(meta: RunMetadata | None) -> dict[str, float]:
    """Component -> time in its steps [us] per simulated millisecond."""
    length = (meta.simulated if meta else 0) or float("nan")
    return {name: 1e3 * spent / length for name, spent in meta.inside.items()} if meta else {}


def _worst(comparison: Comparison, label: str) -> TextTable:
    """Table of the worst signal of each quantity; speeds, pressures and angles first.

    It is the one with the largest NRMSE. Another one with a larger difference has a row of its own.
    """
    groups = comparison.quantities()
    order = [q for q in DEFAULT_QUANTITIES if q in groups]
    order += [q for q in groups if q not in DEFAULT_QUANTITIES]
    rows = []
    for quantity in order:
        worst, largest = comparison.worst(label, quantity), comparison.largest(label, quantity)
        equal = comparison.equal(label, largest)
        first = _worst_row(worst) if worst else ["all are constant", NO_VALUE, _difference(largest)]
        if equal:
            first = [EQUAL, "", ""]
        rows.append([quantity, str(len(groups[quantity])), *first])
        if worst and largest.signal != worst.signal and not equal:
            rows.append(["", "", *_worst_row(largest)])
    against = f"{label} against {comparison.reference.label}"
    head = [against, "signals", "worst signal", "NRMSE", "largest difference"]
    return TextTable(head, rows, left=(0, 2))


def _worst_row(row: ValidatedSignal) -> list[str]:
    """Name, NRMSE and largest difference; no name if there is no difference."""
    mark = f" ({CONSTANT})" if CONSTANT in row.notes else ""
    name = f"{row.signal}{mark}" if row.metrics.rmse else ""
    return [name, percentage(row.metrics.nrmse), _difference(row)]


def _difference(row: ValidatedSignal) -> str:
    return error_display_unit(row.unit).ascii(row.metrics.maximum_error)


def _signals(comparison: Comparison) -> Iterator[TextTable]:
    """NRMSE and largest difference of the shown signals, a column for each run, a few runs in a table."""
    runs = list(comparison.against)
    for labels in (runs[k : k + SIDE_BY_SIDE] for k in range(0, len(runs), SIDE_BY_SIDE)):
        found = [{row.signal: row for row in comparison.against[label].rows} for label in labels]
        groups = {signal: found[0][signal].group for signal in comparison.signals}
        rows = list[list[str]]()
        for group, signals in grouped(groups, groups.__getitem__).items():
            rows.append([group])
            for signal in signals:
                pairs = zip(labels, (of_run[signal] for of_run in found), strict=True)
                cells = (EQUAL if comparison.equal(n, row) else ", ".join(_cells(row)) for n, row in pairs)
                rows.append([f"  {signal}", *cells])
        yield TextTable(["NRMSE, largest difference", *labels], rows)


def _cells(row: ValidatedSignal) -> tuple[str, str]:
    """NRMSE, none for a constant reference, and the largest difference in a convenient unit."""
    m = row.metrics
    is_constant = any(note.startswith("the reference is") for note in row.metrics.notes)
    at_rest = any(note.startswith(HARDLY_MOVES) for note in m.notes)
    undefined = (is_constant and m.rmse) or (at_rest and m.rmse > m.normalised_by)
    nrmse = NO_VALUE if undefined else f"{percentage(m.nrmse)}{FLOORED if at_rest else ''}"
    return nrmse, error_display_unit(row.unit).ascii(m.maximum_error)


def report(comparison: Comparison) -> Report:
    """Runs that are not reliable, other experiments, cost of each run, worst and chosen signals, notes."""
    reference, others = comparison.reference.label, first_names(comparison.against)
    doubts, notes = [*comparison.unreliable, *comparison.experiments], list(_notes(comparison))
    start, stop = comparison.window
    caption = f"Below each signal: its difference from {reference}."
    lead = [
        Markup("Differences from <b>{}</b>, {} to {} s.").format(reference, number(start), number(stop)),
        f"NRMSE: root mean square difference over the range of the signal in {reference}",
    ]
    parts: list[Part] = [
        Text([f"warning: {text}" for text in doubts], "warn", only=TERMINAL),
        Text(doubts, "warn", only=PAGE),
        Figure(traces(comparison), "Signals that differ most", caption),
        Section("Numbers", [*tables(comparison)], only=""),
        Text([f"note: {note}" for note in notes], only=TERMINAL),
        Section("Notes", [Text(notes, "soft")]),
        Section("Runs", [Table(_runs(comparison))], folded=True),
    ]
    data = {
        "reference": reference,
        "shown": comparison.signals,
        "runs": {
            run.label: _run_data(run) | _difference_data(comparison, run.label) for run in comparison.runs
        },
        "notes": comparison.notes,
        "experiments": comparison.experiments,
        "unreliable": comparison.unreliable,
    }
    return Report(f"{others} against {reference}", verdict(comparison), parts, data, lead=lead)


def verdict(comparison: Comparison) -> str:
    """The signal with the largest NRMSE of all runs, of the quantities that are shown."""
    if (found := _worst_of_all(comparison)) is None:
        return "no signal differs"
    label, worst = found
    nrmse, shown = percentage(worst.metrics.nrmse), _shown_quantities(comparison)
    part = worst.group in shown and len(shown) < len(comparison.quantities())
    of = f" of {join_words(shown)}" if part else ""
    return f"largest NRMSE{of}: {worst.signal} of {label}, {nrmse}; at most {_difference(worst)}"


def _shown_quantities(comparison: Comparison) -> list[str]:
    return [name for name, of in comparison.quantities().items() if {*comparison.signals} & {*of}]


def _worst_of_all(comparison: Comparison) -> tuple[str, ValidatedSignal] | None:
    """Run and signal with the largest NRMSE, of the shown quantities if one differs; None without."""
    quantities = [(label, q) for label in comparison.against for q in comparison.quantities()]
    rows = [(label, row) for label, q in quantities if (row := comparison.worst(label, q))]
    differ = [(label, row) for label, row in rows if not comparison.equal(label, row)]
    shown = [pair for pair in differ if pair[1].group in _shown_quantities(comparison)]
    return max(shown or differ, key=lambda pair: comparison.rank(*pair), default=None)


def _runs(comparison: Comparison) -> TextTable:
    """Files, systems and what was given of all runs."""
    rows = []
    for run in comparison.runs:
        given = run.metadata.given if run.metadata else {}
        several = {
            k: [f"{n}={v}" for n, v in of.items()] for k, of in given.items() if isinstance(of, Mapping)
        }
        settings = [f"{key} {', '.join(several.get(key, [str(value)]))}" for key, value in given.items()]
        system = run.metadata.system if run.metadata else ""
        rows.append([run.label, run.file, system, ", ".join(settings)])
    return TextTable(["run", "file", "system", "settings"], rows, left=(0, 1, 2, 3))


def _run_data(run: Run) -> dict[str, Any]:
    meta = run.metadata
    if meta is None:
        return {"file": run.file}
    written = {f"{name}{f' [{unit}]' if unit else ''}": getattr(meta, name) for name, unit in WRITTEN.items()}
    speed = meta.simulated / meta.wall if meta.wall else None
    return {"file": run.file, **written, "provenance": asdict(meta.provenance), "times real time": speed}


def _difference_data(comparison: Comparison, label: str) -> dict[str, Any]:
    if label not in comparison.against:
        return {}
    validation = comparison.against[label]
    worst = {q: row.signal for q in comparison.quantities() if (row := comparison.worst(label, q))}
    return {
        "window [s]": list(validation.window),
        "notes": list(validation.notes),
        "worst": worst,
        "largest": {q: comparison.largest(label, q).signal for q in comparison.quantities()},
        "signals": {row.signal: _row(row) for row in validation.rows},
    }


def _row(row: ValidatedSignal) -> dict[str, Any]:
    m = row.metrics
    return {
        "quantity": row.group,
        "unit": row.unit,
        "nrmse": m.nrmse,
        "rmse": m.rmse,
        "maximum": m.maximum_error,
        "time of maximum [s]": m.time_of_maximum,
        "iso18571": m.iso18571 and asdict(m.iso18571),
    }
