"""The figure: error over wall time for a simulated second, a panel for each system; and the same as CSV."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.transforms import Bbox

from benchmarks.peers.cases import ORDER, Case
from benchmarks.peers.measure import Job, at_error

COST = "ms_per_simulated_second"
HEAD = ("system", "title", "setting", "drawn", "option", "value", "error", COST, "problem")
Row = Mapping[str, str]
EQUAL = "equal error"
COLUMNS = {
    "wired": "work cycle",
    "cut": "without rate wires",
    "m1": "M1",
    "oscillator": "oscillator",
    "motor": "DC motor",
    "truck": "quarter truck",
}
OURS = {
    "jacobi": "#5b9bd5",
    "gauss-seidel": "#1f6fb4",
    "gauss-seidel order 3": "#3949ab",
    "hermite": "#0b3c6f",
    "interface-jacobian": "#00897b",
}
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
FONT = 8  # points, of the names of lines


def write_csv(measured: Sequence[tuple[Case, Sequence[Job]]], path: Path) -> list[Row]:
    """A row for each run that is recorded, and what each setting costs at the target error. Returns all rows,
    also those of other systems, which stay in the file."""
    new = {case.name for case, _ in measured}
    kept = [row for row in read_csv(path) if row["system"] not in new] if path.exists() else []
    rows = [*kept, *(row for case, jobs in measured for row in _rows(case, jobs))]
    rows.sort(key=lambda row: ORDER.index(row["system"]))
    with path.open("w", newline="", encoding="utf-8") as file:
        table = csv.DictWriter(file, HEAD, lineterminator="\n")
        table.writeheader()
        table.writerows(rows)
    return rows


def read_csv(path: Path) -> list[Row]:
    """All rows."""
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def _rows(case: Case, jobs: Sequence[Job]) -> Iterator[Row]:
    yield from (_row(case, job) for job in jobs if job.record)
    for label in dict.fromkeys(job.setting.label for job in jobs):
        equal = at_error([job for job in jobs if job.setting.label == label], case.target)
        if equal:
            cells = (case.name, case.title, label, "", EQUAL, f"{equal.value:.3g}", f"{case.target:g}")
            yield dict(zip(HEAD, (*cells, f"{equal.per_second:.3g}", ""), strict=True))


def _row(case: Case, job: Job) -> Row:
    setting = job.setting
    error = "" if job.error is None else f"{job.error:.3g}"
    cost = f"{job.per_second:.4g}" if job.runs else ""
    cells = (case.name, case.title, setting.label, setting.drawn, setting.vary, f"{job.value:g}", error, cost)
    return dict(zip(HEAD, (*cells, job.failed.partition("\n")[0]), strict=True))


def equal_table(rows: Sequence[Row]) -> str:
    """Markdown: wall time for a simulated second at equal error, a column for each system."""
    equal = [row for row in rows if row["option"] == EQUAL]
    systems = [name for name in ORDER if any(row["system"] == name for row in equal)]
    targets = {row["system"]: row["error"] for row in equal}
    heads = [f"{COLUMNS[name]}, {float(targets[name]):.0e}".replace("e-0", "e-") for name in systems]
    lines = [f"||{'|'.join(heads)}|", f"|---|{'--:|' * len(systems)}"]
    for label in dict.fromkeys(row["setting"] for row in equal):
        costs = {row["system"]: row[COST] for row in equal if row["setting"] == label}
        lines.append(f"|{label}|{'|'.join(costs.get(name, '-') for name in systems)}|")
    return "\n".join(lines)


def draw(rows: Sequence[Row], path: Path) -> None:
    """Two panels in a row."""
    systems = list(dict.fromkeys(row["system"] for row in rows))
    height = -(-len(systems) // 2)
    style = {"font.size": 9, "axes.spines.top": False, "axes.spines.right": False, "axes.titlesize": 10}
    with plt.rc_context(style):
        figure, grid = plt.subplots(
            height, 2, figsize=(SIZE[0], SIZE[1] * height / 3), squeeze=False, dpi=DPI
        )
        panels = {}
        for axes, system in zip(grid.flat, systems, strict=False):
            panels[axes] = _panel(axes, [row for row in rows if row["system"] == system])
        for axes in grid.flat[len(systems) :]:
            axes.axis("off")
        figure.tight_layout(w_pad=2.5, h_pad=1.8)
        for axes, lines in panels.items():
            _label(axes, lines)
        figure.savefig(path, dpi=DPI)
        plt.close(figure)


def _panel(axes: Axes, rows: Sequence[Row]) -> dict[str, np.ndarray]:
    """Draw the lines; return them."""
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
    return lines


def _lines(rows: Iterable[Row]) -> dict[str, np.ndarray]:
    """Label -> cost and error of each run that ended well, shape (n, 2), from the coarsest to the finest."""
    found: dict[str, list[tuple[float, float]]] = {}
    for row in sorted(rows, key=lambda row: -float(row["value"])):
        numbers = [float(row[name] or "inf") for name in (COST, "error")]
        if row["drawn"] and np.isfinite(numbers).all():
            found.setdefault(row["drawn"], []).append((numbers[0], numbers[1]))
    return {label: np.array(points) for label, points in found.items()}


def _label(axes: Axes, lines: Mapping[str, np.ndarray]) -> None:
    """Names beside points of their lines, where they hide least of all lines and no other name."""
    axes.margins(x=0.12, y=0.08)
    axes.autoscale_view()
    places = {label: axes.transData.transform(points) for label, points in lines.items()}
    drawn = np.concatenate([_dense(points) for points in places.values()])
    frame, taken = axes.get_window_extent(), list[Bbox]()
    point = axes.figure.dpi / 72
    for label, points in places.items():
        width, height = 0.62 * FONT * point * len(label), 1.25 * FONT * point
        boxes = [box for end in points[::-1] for box in _beside(end, width, height, 5 * point)]
        best = min(boxes, key=lambda box: _hidden(box, drawn, frame, taken))
        taken.append(best)
        middle = axes.transData.inverted().transform(((best.x0 + best.x1) / 2, (best.y0 + best.y1) / 2))
        axes.text(*middle, label, color=COLOURS[label], fontsize=FONT, ha="center", va="center")


def _dense(points: np.ndarray) -> np.ndarray:
    """A point each few pixels of a line, shape (n, 2)."""
    parts = [np.linspace(a, b, 40) for a, b in pairwise(points)]
    return np.concatenate([points, *parts])


def _beside(point: np.ndarray, width: float, height: float, gap: float) -> list[Bbox]:
    """Places for a name around a point, the ones at its right first."""
    sides = [(x, y) for x in (1, 0, -1) for y in (0, 1, -1) if x or y]
    centres = [point + np.array([x * (width / 2 + gap), y * (height / 2 + gap / 2)]) for x, y in sides]
    return [Bbox.from_bounds(*(c - (width / 2, height / 2)), width, height) for c in centres]


def _hidden(box: Bbox, drawn: np.ndarray, frame: Bbox, taken: Sequence[Bbox]) -> float:
    """How much of the lines a name hides; more if it covers another name or leaves the panel."""
    inside = frame.x0 <= box.x0 and box.x1 <= frame.x1 and frame.y0 <= box.y0 and box.y1 <= frame.y1
    covered = ((drawn >= box.min) & (drawn <= box.max)).all(axis=1).sum()
    return float(covered) + 1e3 * sum(box.overlaps(other) for other in taken) + (0.0 if inside else 1e4)
