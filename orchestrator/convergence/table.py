"""A study as tables: error and order over the step, and what each run cost."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.measure import Measurement
from rich.table import Table
from rich.text import Text as Words

from orchestrator.convergence.study import Row, Study
from orchestrator.symbols import linear
from orchestrator.validation.wording import finer

UNSTABLE, REFUSED = "unstable", "not possible"
ORDER = "behind an error: the order of convergence, measured from the next smaller step"


@dataclass(frozen=True)
class Text:
    """One table as text: a line for each setting, a column for each step."""

    title: str
    head: tuple[str, ...]
    lines: tuple[tuple[str, ...], ...]


def share(value: float) -> str:
    """A pure number with two digits, such as 6.4e-5."""
    return _short(f"{value:.1e}")


def _short(number: str) -> str:
    return number.replace("e-0", "e-").replace("e+0", "e+")


def duration(step: float) -> str:
    """A step in milliseconds."""
    return f"{1e3 * step:g} ms"


def nrmse(study: Study, group: str) -> Text:
    """The worst signal of a group: root mean square error over its range, and the order."""

    def cell(row: Row) -> str:
        order = study.order(row, group)
        return share(row.error(group)) + ("" if order is None else f" {order:4.1f}")

    return _text(study, f"{group}: worst NRMSE against {study.truth.title}; {ORDER}", cell)


def maximum(study: Study, group: str) -> Text:
    """The largest difference of a group at any instant, in the unit of a reader."""
    unit = study.truth.groups[group][0].unit

    def cell(row: Row) -> str:
        error = row.maximum(group)
        return _short(f"{error.maximum * linear(error.unit, finer(unit), error.signal)[0]:.2g}")

    return _text(study, f"{group}: largest difference [{finer(unit) or '1'}] from {study.truth.title}", cell)


def cost(study: Study) -> Text:
    """Wall time of the stable runs."""
    return _text(study, "wall time [ms] for each second simulated", _cost)


def _cost(row: Row) -> str:
    return f"{1e3 * row.cost:.2g}"


def own_steps(study: Study) -> Text | None:
    """Settings that choose their steps: a line for each case; None if there are none."""
    groups = list(study.truth.groups)
    lines = []
    for row in (row for row in study.rows if row.case):
        errors = [share(row.error(group)) if row.stable else _cell(row, _cost) for group in groups]
        known = (str(row.taken), f"{1e3 * row.mean_step:.3g} ms", *errors, _cell(row, _cost))
        lines.append((f"{row.setting.label} {row.case}", *known))
    head = ("master", "steps", "mean step", *groups, "wall [ms/s]")
    return (
        Text(f"steps of their own: worst NRMSE against {study.truth.title}", head, tuple(lines))
        if lines
        else None
    )


def tables(study: Study) -> list[Text]:
    """All tables of a study."""
    found = [*(nrmse(study, group) for group in study.truth.groups), cost(study), own_steps(study)]
    return [table for table in found if table]


def _text(study: Study, title: str, cell: Callable[[Row], str]) -> Text:
    lines = []
    for setting in (setting for setting in study.settings if not setting.own):
        by_step = {row.step: row for row in study.of(setting)}
        cells = [_cell(by_step.get(step), cell) for step in study.steps]
        lines.append((setting.label, *cells))
    return Text(title, ("master", *map(duration, study.steps)), tuple(lines))


def _cell(row: Row | None, cell: Callable[[Row], str]) -> str:
    if row is None:
        return ""
    return REFUSED if row.refused else cell(row) if row.stable else UNSTABLE


def ends(study: Study) -> Iterator[str]:
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


def show(console: Console, text: Text) -> None:
    """Print a table; a narrow terminal breaks lines, but no cell is cut."""
    table = rich(text)
    console.width = max(
        console.width, Measurement.get(console, console.options.update(max_width=400), table).maximum
    )
    console.print(Words(text.title, "bold"), table, sep="\n")


def rich(text: Text) -> Table:
    """For the terminal, without its title."""
    table = Table(box=SIMPLE_HEAD)
    for place, heading in enumerate(text.head):
        table.add_column(Words(heading), justify="right" if place else "left", no_wrap=True)
    for line in text.lines:
        table.add_row(*(Words(c, "red" if c in (UNSTABLE, REFUSED) else "") for c in line))
    return table


def markdown(text: Text) -> str:
    """For a document; what is unstable stands out."""

    def line(cells: Sequence[str]) -> str:
        return "| " + " | ".join(f"**{c}**" if c in (UNSTABLE, REFUSED) else c for c in cells) + " |"

    rule = "|---|" + "--:|" * (len(text.head) - 1)
    return "\n".join([line(text.head), rule, *map(line, text.lines)])
