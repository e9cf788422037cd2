"""Strip charts of the last twenty seconds: commands, speeds, pressures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from nicegui import ui

from orchestrator.view.panels.gauges import DEGREES, MEGA
from orchestrator.view.panels.history import WINDOW, History

# Okabe and Ito 2008: told apart with every kind of colour blindness; a joint has one colour in all charts
SWING, BOOM, STICK, OTHER = "#009e73", "#0072b2", "#d55e00", "#7d7d7d"
FAINT, TEXT = "#8a958f55", "#7b868a"  # on light and on dark ground


@dataclass(frozen=True)
class Curve:
    """A signal by its bare name; `dashed` is the second of a pair."""

    name: str
    text: str
    colour: str
    dashed: bool = False
    factor: float = 1.0


@dataclass(frozen=True)
class Chart:
    """A title with its unit, curves, and where the axis may end: at the first that is enough.

    both   the axis goes as far below zero; else it begins there
    """

    title: str
    curves: Sequence[Curve]
    ends: Sequence[float]
    both: bool = True


COMMANDS = Chart(
    "Command [V]",
    (
        Curve("swing_command", "swing", SWING),
        Curve("boom_command", "boom", BOOM),
        Curve("stick_command", "stick", STICK),
    ),
    (10,),
)
SPEEDS = Chart(
    "Speed [°/s]",
    (
        Curve("swing_speed", "swing", SWING, factor=DEGREES),
        Curve("boom_speed", "boom", BOOM, factor=DEGREES),
        Curve("stick_speed", "stick", STICK, factor=DEGREES),
    ),
    (20, 40, 80, 160),
)
PRESSURES = Chart(
    "Pressure [MPa]",
    (
        Curve("boom_head_pressure", "boom, head", BOOM, factor=MEGA),
        Curve("boom_rod_pressure", "boom, rod", BOOM, True, MEGA),
        Curve("stick_head_pressure", "stick, head", STICK, factor=MEGA),
        Curve("stick_rod_pressure", "stick, rod", STICK, True, MEGA),
        Curve("swing_pressure_a", "swing, A", SWING, factor=MEGA),
        Curve("swing_pressure_b", "swing, B", SWING, True, MEGA),
        Curve("supply_pressure", "supply", OTHER, factor=MEGA),
    ),
    (25, 50, 100),
    both=False,
)
CHARTS = (PRESSURES, COMMANDS, SPEEDS)  # what is first is seen in a low window, too
NAMES = tuple(curve.name for chart in CHARTS for curve in chart.curves)


class Charts:
    """The charts of one page."""

    def __init__(self) -> None:
        self._number, self._turn = -1, 0
        with ui.column().classes("charts"):
            self._charts = [ui.echart(options(chart)).classes("chart") for chart in CHARTS]

    def show(self, history: History, one: bool = False) -> None:
        """New curves; of one chart alone, each in turn, for a browser that takes long to draw them."""
        times, table = history.table()
        if not len(times) or history.number == self._number:
            return
        self._number = history.number
        place = {name: k for k, name in enumerate(history.names)}
        shared = [round(t, 2) for t in times.tolist()]
        self._turn += 1
        for k, (chart, element) in enumerate(zip(CHARTS, self._charts, strict=True)):
            if one and k != self._turn % len(CHARTS):
                continue
            source: dict[str, Any] = {"t": shared}
            peak = 0.0
            for n, curve in enumerate(chart.curves):
                if curve.name in place:
                    values = curve.factor * table[:, place[curve.name]]
                    peak = max(peak, float(abs(values).max(initial=0.0)))
                    source[str(n)] = [round(v, 2) for v in values.tolist()]
            high = next((end for end in chart.ends if end >= peak), chart.ends[-1])
            axis = {"min": -high if chart.both else 0, "max": high}
            element.run_chart_method("setOption", {"dataset": {"source": source}, "yAxis": axis})


def options(chart: Chart) -> dict[str, Any]:
    """The chart as ECharts wants it, without data."""
    label = {"color": TEXT, "fontSize": 10}
    axis: dict[str, Any] = {"type": "value", "axisLabel": label, "axisLine": {"show": False}}
    axis |= {"axisTick": {"show": False}, "splitLine": {"lineStyle": {"color": FAINT}}}
    title = {"fontSize": 11, "color": TEXT}
    rows = 1 + len(chart.curves) // 5
    return {
        "animation": False,
        "title": {"text": chart.title, "left": 0, "top": 0, "padding": [4, 0, 0, 0], "textStyle": title},
        "grid": {"left": 30, "right": 6, "top": 22 + 15 * rows, "bottom": 18},
        "legend": {"top": 19, "left": 0, "padding": 0, "itemWidth": 18, "itemHeight": 7, "itemGap": 8}
        | {"textStyle": label, "selectedMode": False},
        "xAxis": axis
        | {"min": -WINDOW, "max": 0, "splitNumber": 4, "axisLabel": label | {"formatter": "{value} s"}},
        "yAxis": axis | {"splitNumber": 2},
        "dataset": {"source": {"t": []}},
        "series": [_series(k, curve) for k, curve in enumerate(chart.curves)],
    }


def _series(k: int, curve: Curve) -> dict[str, Any]:
    line = {"width": 1.4, "color": curve.colour, "type": [4, 3] if curve.dashed else "solid"}
    return {
        "type": "line",
        "name": curve.text,
        "encode": {"x": "t", "y": str(k)},
        "symbol": "none",
        "silent": True,
        "lineStyle": line,
        "itemStyle": {"color": curve.colour},
    }
