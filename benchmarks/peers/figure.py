"""The figure: error over wall time for a simulated second, a panel for each system; and the same as CSV."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

from benchmarks.peers.cases import ORDER, Case
from benchmarks.peers.measure import Job

HEAD = (
    "system",
    "title",
    "setting",
    "drawn",
    "option",
    "value",
    "error",
    "ms_per_simulated_second",
    "problem",
)
Row = Mapping[str, str]
OURS = {"jacobi": "#5b9bd5", "gauss-seidel": "#1f6fb4", "hermite": "#0b3c6f", "interface-jacobian": "#00897b"}
PEERS = {
    "FMPy": "#8c8c8c",
    "PyFMI": "#c0504d",
    "PyFMI, order 1": "#e08a3c",
    "OMSimulator": "#a67c00",
    "Ecos": "#8e5ea2",
    "libcosim": "#d16ba5",
}
COLOURS = {**OURS, **PEERS, "--accuracy": "#111111"}
SIZE, DPI = (10.0, 11.5), 110  # inches
GAP = 0.042  # of the height of a panel, between the middles of two labels


def write_csv(measured: Sequence[tuple[Case, Sequence[Job]]], path: Path) -> list[Row]:
    """A row for each run that is recorded; rows of other systems that the file has stay. All rows."""
    kept: list[Row] = []
    if path.exists():
        with path.open(newline="", encoding="utf-8") as file:
            kept = [r for r in csv.DictReader(file) if r["system"] not in {c.name for c, _ in measured}]
    rows = [*kept, *(_row(case, job) for case, jobs in measured for job in jobs if job.record)]
    rows.sort(key=lambda row: ORDER.index(row["system"]))
    with path.open("w", newline="", encoding="utf-8") as file:
        table = csv.DictWriter(file, HEAD, lineterminator="\n")
        table.writeheader()
        table.writerows(rows)
    return rows


def _row(case: Case, job: Job) -> Row:
    setting = job.setting
    error = "" if job.error is None else f"{job.error:.3g}"
    cost = f"{job.per_second:.4g}" if job.runs else ""
    cells = (case.name, case.title, setting.label, setting.drawn, setting.vary, f"{job.value:g}", error, cost)
    return dict(zip(HEAD, (*cells, job.failed.partition("\n")[0]), strict=True))


def draw(rows: Sequence[Row], path: Path) -> None:
    """Two panels in a row."""
    systems = list(dict.fromkeys(row["system"] for row in rows))
    height = -(-len(systems) // 2)
    style = {"font.size": 9, "axes.spines.top": False, "axes.spines.right": False, "axes.titlesize": 10}
    with plt.rc_context(style):
        figure, grid = plt.subplots(height, 2, figsize=(SIZE[0], SIZE[1] * height / 3), squeeze=False)
        for axes, system in zip(grid.flat, systems, strict=False):
            _panel(axes, [row for row in rows if row["system"] == system])
        for axes in grid.flat[len(systems) :]:
            axes.axis("off")
        figure.tight_layout(w_pad=2.5, h_pad=1.8)
        figure.savefig(path, dpi=DPI)
        plt.close(figure)


def _panel(axes: Axes, rows: Sequence[Row]) -> None:
    lines = _lines(rows)
    for label, points in lines.items():
        peer = label in PEERS
        axes.plot(
            *points.T,
            color=COLOURS[label],
            linewidth=1.2 if peer else 1.8,
            linestyle=(0, (4, 1.5)) if peer else "-",
            marker="o",
            markersize=3.2,
        )
    title, _, judged = rows[0]["title"].partition(", ")
    axes.set(xscale="log", yscale="log", xlabel="wall time per simulated second [ms]", ylabel="error")
    axes.set_title(f"{title}\n", loc="left", fontweight="bold")
    axes.text(0, 1.02, judged, transform=axes.transAxes, fontsize=8, color="#555555")
    axes.grid(True, which="major", color="#e6e6e6", linewidth=0.7)
    axes.set_axisbelow(True)
    _label(axes, lines)


def _lines(rows: Iterable[Row]) -> dict[str, np.ndarray]:
    """Label -> cost and error of each run that ended well, shape (n, 2), from the coarsest to the finest."""
    found: dict[str, list[tuple[float, float]]] = {}
    for row in sorted(rows, key=lambda row: -float(row["value"])):
        numbers = [float(row[name] or "inf") for name in ("ms_per_simulated_second", "error")]
        if row["drawn"] and np.isfinite(numbers).all():
            found.setdefault(row["drawn"], []).append((numbers[0], numbers[1]))
    return {label: np.array(points) for label, points in found.items()}


def _label(axes: Axes, lines: Mapping[str, np.ndarray]) -> None:
    """Names beside the finest run of each line, moved apart where they would overlap."""
    if not lines:
        return
    low, high = axes.get_xlim()
    axes.set_xlim(low, high * (high / low) ** 0.38)  # room for the names
    to_axes = axes.transData + axes.transAxes.inverted()
    ends = {label: to_axes.transform(points[-1]) for label, points in lines.items()}
    order = sorted(ends, key=lambda label: float(ends[label][1]))
    heights = np.array([ends[label][1] for label in order])
    for _ in range(200):  # push neighbours apart until all keep the gap
        lacking = GAP - np.diff(heights)
        if (lacking <= 1e-6).all():
            break
        for i in np.flatnonzero(lacking > 0):
            heights[i] -= lacking[i] / 2
            heights[i + 1] += lacking[i] / 2
    heights += max(0.0, 0.01 - heights[0])
    column = max(float(end[0]) for end in ends.values()) + 0.03
    for label, height in zip(order, heights, strict=True):
        axes.annotate(
            label,
            ends[label],
            (column, height),
            xycoords="axes fraction",
            textcoords="axes fraction",
            color=COLOURS[label],
            fontsize=8,
            va="center",
            arrowprops={"arrowstyle": "-", "color": COLOURS[label], "linewidth": 0.5, "alpha": 0.6},
        )
