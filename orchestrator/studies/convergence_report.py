"""What a convergence study found: tables, pictures for people, files for programs.

The pictures show the error over the step and over the wall time. Settings that give the same share one line,
and each line has its name next to its end.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator

from orchestrator.base.html_page import plain, write_json
from orchestrator.base.plotting import PALETTE, frame, new_figure, png
from orchestrator.base.text import TextTable, finer
from orchestrator.base.units import linear
from orchestrator.studies.convergence import ConvergenceStudy, SettingRun

# One colour for each family, different in hue and in lightness (Okabe and Ito, darkened).
COLOURS = {"plain": "#c2341d", "jacobi": "#c98500", "gauss-seidel": "#00735a", "hermite": "#0b5fa5"}
COLOURS |= {"own steps": "#8f3f8f"}
OTHER = "#333333"
ALIKE = 0.01  # settings whose errors differ by less share a line


@dataclass(eq=False)
class StudyLine:
    """The rows of one setting, or of several that give the same."""

    names: list[str]
    rows: list[SettingRun]
    colour: str
    place: int  # in its family

    stable: list[SettingRun] = field(init=False)
    lost: list[SettingRun] = field(init=False)

    def __post_init__(self) -> None:
        self.stable = [row for row in self.rows if row.stable]
        self.lost = [row for row in self.rows if not row.stable and not row.refused]

    @property
    def name(self) -> str:
        """The settings, a common first word once."""
        first = self.names[0].split()[0]
        return ", ".join([self.names[0], *(n.removeprefix(f"{first} ") for n in self.names[1:])])


def lines_of(study: ConvergenceStudy, group: str) -> list[StudyLine]:
    """One for each setting; those that give the same as one before share its line."""
    lines: list[StudyLine] = []
    count: dict[str, int] = {}
    for setting in study.settings:
        rows = study.of(setting)
        twin = next((line for line in lines if _alike(line.rows, rows, group)), None)
        if twin is not None:
            twin.names.append(setting.label)
            continue
        place = count.get(setting.family, 0)
        count[setting.family] = place + 1
        lines.append(StudyLine([setting.label], rows, COLOURS.get(setting.family, OTHER), place))
    return lines


def _alike(first: Sequence[SettingRun], second: Sequence[SettingRun], group: str) -> bool:
    """The same steps, stable at the same ones, with the same errors there."""
    if [(r.mean_step, r.stable) for r in first] != [(r.mean_step, r.stable) for r in second]:
        return False
    pairs = [(a.error(group), b.error(group)) for a, b in zip(first, second, strict=True) if a.stable]
    return bool(pairs) and all(abs(a - b) <= ALIKE * max(a, b) for a, b in pairs)


APART = 0.034  # of the height of the picture, between two names
LETTER = 0.0062  # width of a letter of a name, of the width of the picture
TEXT: dict[str, Any] = {"color": PALETTE.ink, "fontsize": 8, "va": "center"}
LEADER: dict[str, Any] = {"arrowstyle": "-", "linewidth": 0.6, "alpha": 0.6, "shrinkA": 1.0, "shrinkB": 3.0}


def room(lines: Sequence[StudyLine]) -> float:
    """For the names, as a share of the width of what is drawn next to them."""
    width = 0.05 + LETTER * max((len(line.name) for line in lines), default=0)
    return width / (1 - width)


def write_names(axes: Axes, ends: Mapping[StudyLine, tuple[float, float]], left: bool) -> None:
    """The name of each line next to its end, moved up or down where names would touch."""
    to_axes = (axes.transData + axes.transAxes.inverted()).transform
    at = {line: to_axes(end) for line, end in ends.items()}
    lines = sorted(at, key=lambda line: float(at[line][1]))
    heights = _apart([float(at[line][1]) for line in lines])
    edges = [float(x) for x, _ in at.values()] or [0.0]
    x = min(edges) - 0.03 if left else max(edges) + 0.03
    for line, height in zip(lines, heights, strict=True):
        axes.annotate(
            line.name,
            tuple(at[line]),
            (x, height),
            xycoords="axes fraction",
            textcoords="axes fraction",
            ha="right" if left else "left",
            va="center",
            fontsize=8,
            color=line.colour,
            arrowprops=LEADER | {"color": line.colour, "relpos": (1.0 if left else 0.0, 0.5)},
        )


def _apart(heights: Sequence[float]) -> list[float]:
    """Increasing heights, moved as little as needed to stand apart and inside the picture."""
    found = np.array(heights)
    for _ in range(400):
        for i in range(len(found) - 1):
            short = APART - (found[i + 1] - found[i])
            if short > 0:
                found[i] -= short / 2
                found[i + 1] += short / 2
        found = np.clip(found, 0.02 + APART * np.arange(len(found)), None)
        found = np.clip(found, None, 0.98 - APART * np.arange(len(found))[::-1])
    return [float(height) for height in found]


DASHES = ("-", (0, (5, 1.5)), (0, (1.5, 1.2)), (0, (6, 1.5, 1.5, 1.5)))  # within a family
MARKERS = ("o", "s", "^", "D")
SIZE = (8.4, 5.2)  # [in]
TRIANGLES = (1, 2, 4)  # orders


def draw_error(study: ConvergenceStudy, group: str | None = None) -> Figure:
    """Error over step, of the worst signal of a group; by default of the first group."""
    chosen = group or next(iter(study.truth.groups))
    figure, axes = _figure(study, chosen)
    lines = lines_of(study, chosen)
    drawn = [line for line in lines if line.stable]
    for line in drawn:
        _plot(axes, line, lambda row: 1e3 * row.mean_step, chosen)
    axes.set_xlabel("communication step [ms]", color=PALETTE.ink)
    steps = [1e3 * step for step in study.steps]
    axes.set_xticks(steps, [f"{step:g}" for step in steps])
    steps = sorted([*steps, *(1e3 * row.mean_step for line in drawn for row in line.stable)])
    axes.set_xlim(steps[0] / (1.5 * steps[-1] / steps[0]) ** room(drawn), steps[-1] * 1.35)
    _losses(axes, lines, chosen)
    _triangles(axes, steps)
    ends = {line: (1e3 * line.stable[0].mean_step, line.stable[0].error(chosen)) for line in drawn}
    write_names(axes, ends, left=True)
    return figure


def draw_work(study: ConvergenceStudy, group: str | None = None) -> Figure:
    """Error over wall time for each second simulated: lower left is better."""
    chosen = group or next(iter(study.truth.groups))
    figure, axes = _figure(study, chosen)
    drawn = [line for line in lines_of(study, chosen) if line.stable]
    for line in drawn:
        _plot(axes, line, lambda row: 1e3 * row.cost, chosen)
    axes.set_xlabel("wall time [ms] for each second simulated", color=PALETTE.ink)
    costs = [1e3 * row.cost for line in drawn for row in line.stable]
    if costs:
        axes.set_xlim(min(costs) / 1.3, max(costs) * (1.5 * max(costs) / min(costs)) ** room(drawn))
        axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axes.xaxis.set_major_formatter("{x:g}")
    ends = {line: (1e3 * line.stable[0].cost, line.stable[0].error(chosen)) for line in drawn}
    write_names(axes, ends, left=False)
    return figure


def _figure(study: ConvergenceStudy, group: str) -> tuple[Figure, Axes]:
    figure = new_figure(*SIZE)
    axes = figure.subplots()
    frame(axes, y=f"worst {group}, root mean square error over range", size=10)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.minorticks_off()
    axes.set_title(f"against: {study.truth.title}", loc="left", fontsize=9, color=PALETTE.faint)
    return figure, axes


def _plot(axes: Axes, line: StudyLine, x: Callable[[SettingRun], float], group: str) -> None:
    axes.plot(
        [x(row) for row in line.stable],
        [row.error(group) for row in line.stable],
        color=line.colour,
        linestyle=DASHES[line.place % len(DASHES)],
        linewidth=1.4,
        marker=MARKERS[line.place % len(MARKERS)],
        markersize=4,
    )


def _losses(axes: Axes, lines: Sequence[StudyLine], group: str) -> None:
    """A cross above the picture for each unstable run, side by side where there are several."""
    low, high = axes.get_ylim()
    level = high * (high / low) ** 0.05
    axes.set_ylim(low, level * (high / low) ** 0.05)
    lost = [line for line in lines if line.lost]
    if not lost:
        return
    axes.axhline(high, color=PALETTE.faint, linewidth=0.8, linestyle=(0, (1, 3)))
    axes.text(0.01, level, "unstable", transform=axes.get_yaxis_transform(), **TEXT)
    for place, line in enumerate(lost):
        aside = 1.045 ** (place - (len(lost) - 1) / 2)
        at = [1e3 * row.step * aside for row in line.lost]
        axes.plot(at, [level] * len(at), color=line.colour, linestyle="", marker="x", markersize=5.5)
        before = [row for row in line.stable if row.step < line.lost[0].step]
        if before:
            ends = [1e3 * before[-1].mean_step, at[0]], [before[-1].error(group), level]
            axes.plot(*ends, color=line.colour, linewidth=0.7, linestyle=(0, (1, 2)))


def _triangles(axes: Axes, steps: Sequence[float]) -> None:
    """What orders 1, 2 and 4 look like, in the corner of long steps and small errors."""
    low, high = axes.get_ylim()
    decades = np.log10(high / low)
    right = steps[-1] * 1.2
    for order in reversed(TRIANGLES):
        run = min(10 ** (0.2 * decades / order), 1.45)
        left, bottom = right / run, low * 10 ** (0.03 * decades)
        top = bottom * run**order
        corners = [left, right, right, left], [bottom, bottom, top, bottom]
        axes.plot(*corners, color=PALETTE.faint, linewidth=0.9)
        axes.text(right / run**0.33, bottom * (top / bottom) ** 0.25, f"{order}", ha="center", **TEXT)
        right = left / 1.08


UNSTABLE, REFUSED = STRONG = "unstable", "not possible"
ORDER = "behind an error: the order of convergence, measured from the next smaller step"


def share(value: float) -> str:
    """A pure number with two digits, such as 6.4e-5."""
    return _short(f"{value:.1e}")


def _short(number: str) -> str:
    return number.replace("e-0", "e-").replace("e+0", "e+")


def duration(step: float) -> str:
    """A step in milliseconds."""
    return f"{1e3 * step:g} ms"


def nrmse(study: ConvergenceStudy, group: str) -> TextTable:
    """The worst signal of a group: root mean square error over its range, and the order."""

    def cell(row: SettingRun) -> str:
        order = study.order(row, group)
        return share(row.error(group)) + ("" if order is None else f" {order:4.1f}")

    return _text(study, f"{group}: worst NRMSE against {study.truth.title}; {ORDER}", cell)


def maximum(study: ConvergenceStudy, group: str) -> TextTable:
    """The largest difference of a group at any instant, in the unit of a reader."""
    unit = finer(study.truth.groups[group][0].unit).shown

    def cell(row: SettingRun) -> str:
        error = row.maximum(group)
        return _short(f"{error.maximum * linear(error.unit, unit, error.signal)[0]:.2g}")

    return _text(study, f"{group}: largest difference [{unit or '1'}] from {study.truth.title}", cell)


def cost(study: ConvergenceStudy) -> TextTable:
    """Wall time of the stable runs."""
    return _text(study, "wall time [ms] for each second simulated", _cost)


def _cost(row: SettingRun) -> str:
    return f"{1e3 * row.cost:.2g}"


def own_steps(study: ConvergenceStudy) -> TextTable | None:
    """Settings that choose their steps: a line for each case; None if there are none."""
    groups = list(study.truth.groups)
    lines = []
    for row in (row for row in study.rows if row.case):
        errors = [share(row.error(group)) if row.stable else _cell(row, _cost) for group in groups]
        known = (str(row.taken), f"{1e3 * row.mean_step:.3g} ms", *errors, _cell(row, _cost))
        lines.append((f"{row.setting.label} {row.case}", *known))
    head = ("master", "steps", "mean step", *groups, "wall [ms/s]")
    title = f"steps of their own: worst NRMSE against {study.truth.title}"
    return TextTable(head, lines, title=title, strong=STRONG) if lines else None


def tables(study: ConvergenceStudy) -> list[TextTable]:
    """All tables of a study."""
    found = [*(nrmse(study, group) for group in study.truth.groups), cost(study), own_steps(study)]
    return [table for table in found if table]


def _text(study: ConvergenceStudy, title: str, cell: Callable[[SettingRun], str]) -> TextTable:
    lines = []
    for setting in (setting for setting in study.settings if not setting.own):
        by_step = {row.step: row for row in study.of(setting)}
        cells = [_cell(by_step.get(step), cell) for step in study.steps]
        lines.append((setting.label, *cells))
    return TextTable(["master", *map(duration, study.steps)], lines, title=title, strong=STRONG)


def _cell(row: SettingRun | None, cell: Callable[[SettingRun], str]) -> str:
    if row is None:
        return ""
    return REFUSED if row.refused else cell(row) if row.stable else UNSTABLE


def ends(study: ConvergenceStudy) -> Iterator[str]:
    """Of each setting that is somewhere unstable or refused: from which step on, and why."""
    for setting in study.settings:
        lost = next((row for row in study.of(setting) if not row.stable), None)
        if lost is None:
            continue
        if lost.refused:
            yield f"{setting.label}: {REFUSED}: {lost.refused}"
            continue
        why = lost.ended or "ran to the end, but a signal was off by more than its range"
        yield f"{setting.label}: {UNSTABLE} at {lost.case or duration(lost.step)}: {why}"


DPI = 110


def write(study: ConvergenceStudy, folder: str | Path) -> list[Path]:
    """Write convergence.csv, .json, .png and work_precision.png to a folder; pictures of the first group."""
    home = Path(folder)
    home.mkdir(parents=True, exist_ok=True)
    table, numbers = home / "convergence.csv", home / "convergence.json"
    with table.open("w", newline="", encoding="utf-8") as file:
        rows = [_flat(study, row) for row in study.rows]
        writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    write_json(numbers, data(study))
    pictures = {home / "convergence.png": draw_error(study), home / "work_precision.png": draw_work(study)}
    for path, figure in pictures.items():
        path.write_bytes(png(figure, DPI))
    return [table, numbers, *pictures]


def data(study: ConvergenceStudy) -> Mapping[str, Any]:
    """All numbers."""
    return {
        "reference": study.truth.title,
        "groups": {group: [s.name for s in signals] for group, signals in study.truth.groups.items()},
        "notes": list(study.notes),
        "runs": [_row(study, row) for row in study.rows],
    }


def _about(row: SettingRun) -> dict[str, Any]:
    coupling = row.setting.own.get(row.case, row.setting.coupling)
    return {
        "setting": row.setting.label,
        "master": coupling.master,
        "order": coupling.extrapolation,
        "passes": coupling.rounds,
        "without rate wires": row.setting.bare,
        "case": row.case,
        "step [s]": row.step,
        "mean step [s]": row.mean_step,
        "steps": row.taken,
        "simulated [s]": row.simulated,
        "stable": row.stable,
        "wall [s]": plain(row.wall),
        "wall per simulated [1]": plain(row.cost),
        "ended": row.ended or row.refused,
    }


def _row(study: ConvergenceStudy, row: SettingRun) -> dict[str, Any]:
    errors = {
        group: {
            "order": study.order(row, group),
            "signals": {e.signal: {"nrmse": e.nrmse, "maximum": e.maximum, "unit": e.unit} for e in found},
        }
        for group, found in row.errors.items()
    }
    return {**_about(row), "walls [s]": list(row.walls), "errors": errors}


def _flat(study: ConvergenceStudy, row: SettingRun) -> dict[str, Any]:
    """A line of the CSV: of each group its worst signal."""
    line = _about(row)
    for group in study.truth.groups:
        worst = row.errors[group][0] if row.errors else None
        line |= {
            f"{group} nrmse": worst.nrmse if worst else None,
            f"{group} worst": worst.signal if worst else None,
            f"{group} order": study.order(row, group),
        }
    return line
