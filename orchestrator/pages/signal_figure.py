"""Signals of runs over time as a figure: which are shown, and how their curves differ."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from orchestrator.base.signals import span
from orchestrator.base.text import grouped, short_names
from orchestrator.base.units import in_reader_unit, quantity, reader_unit
from orchestrator.pages.figures import (
    PALETTE,
    Array,
    Style,
    TraceArea,
    TraceFigure,
    TraceLine,
    TracePanel,
    curve_style,
)

MAX_PANELS, MAX_LINES = 4, 6  # of a figure without chosen signals: one page, one colour for each line
MAX_DASHES = 3  # line styles that can be told apart in curves that change fast
FIRST_QUANTITIES = ("voltage", "angle", "speed", "pressure", "position", "velocity", "flow", "force", "power")
SAME = 1e-3  # of its range: a curve that is closer to an earlier one cannot be seen beside it
ENTRY, GAP, LEAST = (
    0.35,
    0.54,
    3.8,
)  # heights of a legend's entry and of the rest, and the least of a panel, in rows


def default_signals(signals: Mapping[str, Array], units: Mapping[str, str]) -> list[str]:
    """The signals of a figure on one page: at most `MAX_LINES` of each of `MAX_PANELS` quantities.

    Quantities of `FIRST_QUANTITIES` come first, others in the order of the signals. Left out are constant
    signals, and signals that repeat an earlier one, such as an input that is connected to an output.
    """
    groups: dict[str, list[str]] = {}
    for name, values in signals.items():
        group = groups.setdefault(reader_unit(units.get(name, "")), [])
        if len(group) < MAX_LINES and _informative(values, [signals[n] for n in group]):
            group.append(name)
    moving = [group for group in groups.values() if group]
    rank = {q: i for i, q in enumerate(FIRST_QUANTITIES)}
    moving.sort(key=lambda group: rank.get(quantity(units.get(group[0], "")), len(rank)))
    return [name for group in moving[:MAX_PANELS] for name in group] or list(signals)[:MAX_LINES]


def _informative(values: Array, others: Sequence[Array]) -> bool:
    """Does a curve change, and differ from the others?"""
    finite = values[np.isfinite(values)]
    least = SAME * span(finite) if finite.size else 0.0
    return least > 0 and not any(np.nanmax(np.abs(values - other)) < least for other in others)


def signal_figure(
    runs: Mapping[str, tuple[Array, Mapping[str, Array]]],
    units: Mapping[str, str],
    title: str = "",
    below: str = "",
    bands: Mapping[str, Array] | None = None,
) -> TraceFigure:
    """Signals over time, one panel per display unit, in the order of the signals of the first run.

    runs    label -> times [s] and signals; the line style distinguishes several runs, and the colour if
            each panel has one signal
    below   a short line below the figure
    bands   signal of the first run -> half width of a band around it, in the unit of the signal
    """
    first = next(iter(runs.values()))[1]
    panels = grouped(first, lambda name: reader_unit(units.get(name, "")))
    labels = short_names(first)
    styles = _styles(list(panels.values()), labels) if len(runs) == 1 else {}
    # then colours distinguish runs, too, and the signal is the title of its panel
    single = len(runs) > 1 and max(map(len, panels.values()), default=0) == 1
    drawn = []
    for unit, names in panels.items():
        lines, areas = list[TraceLine](), list[TraceArea]()
        for k, name in enumerate(names):
            for i, (time, signals) in enumerate(runs.values()):
                if name in signals:
                    of_signal = units.get(name, "")
                    values = in_reader_unit(signals[name], of_signal)
                    dashes = i if len(runs) > 1 else k // len(PALETTE.series)
                    style = styles.get(name) or curve_style(i if single else k, dashes)
                    lines.append(TraceLine(time, values, style, "" if i or single else labels[name]))
                    if bands and name in bands and not i:
                        edges = (signals[name] - bands[name], signals[name] + bands[name])
                        low, high = (in_reader_unit(edge, of_signal) for edge in edges)
                        areas.append(TraceArea(time, low, high, style["color"]))
        height = max(LEAST, ENTRY * len(names) + GAP)
        label = "" if (word := quantity(units.get(names[0], ""))).startswith(("[", "without")) else word
        name = labels[names[0]] if single else ""
        drawn.append(
            TracePanel(unit, lines, label, name, heights=(height, 0.0), areas=areas, key_beside=True)
        )
    ends = [t for time, _ in runs.values() for t in (float(time[0]), float(time[-1]))]
    colours = {} if single else {"color": PALETTE.ink}
    key = [(n, {**curve_style(i, i), **colours}) for i, n in enumerate(runs)] if len(runs) > 1 else []
    return TraceFigure(drawn, (min(ends), max(ends)), title, below, key)


def _styles(panels: Sequence[Sequence[str]], labels: Mapping[str, str]) -> dict[str, Style]:
    """One colour for each first word of the names (swing, boom, stick) in all panels, if that suffices.

    Line styles distinguish the curves of one colour in a panel. Empty if there are too many of them.
    """
    words = {name: label.rpartition(".")[2].partition("_")[0] for name, label in labels.items()}
    order = list(dict.fromkeys(words.values()))
    largest = max(sum(words[n] == word for n in panel) for panel in panels for word in order)
    if not 1 < len(order) <= len(PALETTE.series) or largest > MAX_DASHES:
        return {}
    styles = dict[str, Style]()
    for panel in panels:
        used: dict[str, int] = {}
        for name in panel:
            word = words[name]
            styles[name] = curve_style(order.index(word), used.get(word, 0))
            used[word] = used.get(word, 0) + 1
    return styles
