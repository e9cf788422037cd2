"""Strip charts of the last twenty seconds, drawn from the smallest and largest value in each time bin."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from nicegui import ui
from numpy.typing import NDArray

from orchestrator.realtime.setup import Machine
from orchestrator.scene.view_description import Chart, ChartCurve
from orchestrator.view.session import SignalIndex

Array = NDArray[np.float64]

WINDOW, BIN = 20.0, 0.2  # s, of simulated time


class History:
    """Smallest and largest values of signals in the time bins of the last `WINDOW`. All pages share it.

    names    names of the signals that the machine has
    number   number of the last frame that was added
    """

    def __init__(self, machine: Machine, index: SignalIndex, names: Sequence[str]) -> None:
        self.names = tuple(name for name in names if index.contains(name))
        self._machine = machine
        self._columns = [index.column(name) for name in self.names]
        self.number = -1
        self._bins = dict[int, Array]()  # bin -> shape (2, names)

    def look(self) -> None:
        """Add the frames since the last call."""
        if not self.names:
            return
        if self.number < 0:  # the first call needs only the last `WINDOW`
            self.number = self._machine.latest().number - round(WINDOW / 0.01) - 1
        numbers, times, axes, values = self._machine.since(self.number)
        if not len(numbers):
            return
        if times[0] < self.end - BIN:  # restarted
            self._bins.clear()
        self.number = int(numbers[-1])
        table = np.stack(
            [(axes if c and c[0] == "axes" else values)[:, c[1] if c else 0] for c in self._columns], 1
        )
        self._add(np.floor(times / BIN).astype(int), table)

    @property
    def end(self) -> float:
        """Time of the last bin [s]."""
        return max(self._bins, default=0) * BIN

    def table(self) -> tuple[Array, Array]:
        """Times relative to the end [s], two for each bin, and values, shape (times, names)."""
        bins = sorted(self._bins)
        if not bins:
            return np.zeros(0), np.zeros((0, len(self.names)))
        last = bins[-1]
        times = np.array([(k - last + half) * BIN for k in bins for half in (-0.5, 0.0)])
        return times, np.concatenate([self._bins[k] for k in bins])

    def _add(self, bins: NDArray[np.int64], table: Array) -> None:
        for k in np.unique(bins):
            rows = table[bins == k]
            if k in self._bins:
                rows = np.concatenate((self._bins[k], rows))
            self._bins[int(k)] = extremes(rows)
        oldest = max(self._bins) - round(WINDOW / BIN)
        for k in [k for k in self._bins if k < oldest]:
            del self._bins[k]


def extremes(rows: Array) -> Array:
    """Smallest and largest value of each column, in order of time, shape (2, columns)."""
    low, high = rows.argmin(axis=0), rows.argmax(axis=0)
    columns = np.arange(rows.shape[1])
    first, second = np.minimum(low, high), np.maximum(low, high)
    return np.stack((rows[first, columns], rows[second, columns]))


FAINT, TEXT = "#8a958f55", "#5b6468"  # page.css inverts them on a dark page
PER_ROW = 3  # entries of the legend


class Charts:
    """The charts of one page."""

    def __init__(self, charts: Sequence[Chart]) -> None:
        self._number, self._turn = -1, 0
        self._shown: list[Chart] = list(charts)
        self._specs = tuple(charts)
        with ui.column().classes("charts"):
            self._charts = [ui.echart(options(chart)).classes("chart") for chart in charts]
        for chart, element in zip(charts, self._charts, strict=True):
            element.props(f'role=img aria-label="{chart.title} over the last {WINDOW:.0f} s"')

    def fit(self, index: SignalIndex) -> None:
        """Show the curves that this machine has, and no chart without any."""
        self._number = -1
        self._shown = [
            replace(chart, curves=tuple(c for c in chart.curves if index.contains(c.name)))
            for chart in self._specs
        ]
        for chart, element in zip(self._shown, self._charts, strict=True):
            element.set_visibility(bool(chart.curves))
            element.options.clear()
            element.options.update(options(chart))
            element.update()

    def show(self, history: History, one: bool = False) -> None:
        """Update the curves. one: only one chart per call, in turn, for a slow browser."""
        times, table = history.table()
        if not len(times) or history.number == self._number:
            return
        self._number = history.number
        index = {name: k for k, name in enumerate(history.names)}
        shared = [round(t, 2) for t in times.tolist()]
        self._turn += 1
        for k, (chart, element) in enumerate(zip(self._shown, self._charts, strict=True)):
            if one and k != self._turn % len(self._shown):
                continue
            source: dict[str, Any] = {"t": shared}
            peak = 0.0
            for n, curve in enumerate(chart.curves):
                if curve.name in index:
                    values = chart.factor * table[:, index[curve.name]]
                    peak = max(peak, float(abs(values).max(initial=0.0)))
                    source[str(n)] = [round(v, 2) for v in values.tolist()]
            high = next((end for end in chart.ends if end >= peak), chart.ends[-1])
            axis = {"min": -high if chart.both else 0, "max": high}
            element.run_chart_method("setOption", {"dataset": {"source": source}, "yAxis": axis})


def options(chart: Chart) -> dict[str, Any]:
    """ECharts options of the chart, without data."""
    label = {"color": TEXT, "fontSize": 10}
    axis: dict[str, Any] = {"type": "value", "axisLabel": label, "axisLine": {"show": False}}
    axis |= {"axisTick": {"show": False}, "splitLine": {"lineStyle": {"color": FAINT}}}
    title = {"fontSize": 11, "color": TEXT}
    rows = -(-len(chart.curves) // PER_ROW)
    return {
        "animation": False,
        "title": {
            "text": f"{chart.title} [{chart.unit}]",
            "left": 0,
            "top": 0,
            "padding": [4, 0, 0, 0],
            "textStyle": title,
        },
        "grid": {"left": 30, "right": 6, "top": 22 + 15 * rows, "bottom": 18},
        "legend": {"top": 19, "left": 0, "padding": 0, "itemWidth": 18, "itemHeight": 7, "itemGap": 8}
        | {"textStyle": label, "selectedMode": False},
        "xAxis": axis
        | {"min": -WINDOW, "max": 0, "splitNumber": 4, "axisLabel": label | {"formatter": "{value} s"}},
        "yAxis": axis | {"splitNumber": 2},
        "dataset": {"source": {"t": []}},
        "series": [_series(k, curve) for k, curve in enumerate(chart.curves)],
    }


def _series(k: int, curve: ChartCurve) -> dict[str, Any]:
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
