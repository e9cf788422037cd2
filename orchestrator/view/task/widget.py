"""The training task on the page: what to do next, how far it is, and the table of attempts.

training = Training(session.machine)     # one per server
mount(training, path)                    # in each page
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

from nicegui import ui

from orchestrator.errors import Problem
from orchestrator.view.task.exercise import EXERCISES
from orchestrator.view.task.training import Training

REFRESH = 0.25  # s
# key of a score, heading with unit, factor from SI, digits
COLUMNS: tuple[tuple[str, str, float, int], ...] = (
    ("cycle_time", "cycle s", 1, 1),
    ("path_length", "path m", 1, 1),
    ("simultaneous", "two or more %", 100, 0),
    ("functions", "functions", 1, 2),
    ("energy", "energy kJ", 1e-3, 0),
    ("peak_pressure", "peak bar", 1e-5, 0),
    ("smoothness", "smoothness", 1, 2),
)


def mount(
    training: Training, path: Path | None = None, shown: Callable[[], bool] = lambda: True
) -> Callable[[], None]:
    """The task, at this place of the page; with a path the table can be written there.

    shown     whether it is seen; while no page shows it, nothing is counted
    returns   what to call when that has changed
    """
    seen = False
    with ui.column().classes("gap-1 w-full").mark("task"):
        with ui.row().classes("items-center gap-2"):
            chosen = ui.select(list(EXERCISES), value=training.exercise.name).props("dense")
            chosen.on_value_change(lambda e: _choose(training, e.value))
            ui.button("New attempt", on_click=training.again).props("dense flat")
            if path is not None:
                write = ui.button("Write table", on_click=lambda: _write(training, path)).props("dense flat")
                write.bind_visibility_from(training, "attempts", backward=bool)
            state = ui.label().props("role=status")
        held = ui.linear_progress(0.0, show_value=False)
        heads: list[dict[str, Any]] = [{"name": "attempt", "label": "attempt", "field": "attempt"}]
        heads += [{"name": key, "label": text, "field": key} for key, text, *_ in COLUMNS]
        table = ui.table(rows=[], columns=heads).props("dense flat").classes("w-full")

    def show() -> None:
        if not seen:
            return
        training.update()
        status = training.status()
        state.text, held.value = words(status), min(1.0, status["held"])
        chosen.value = status["exercise"]
        rows = [row(entry) for entry in training.table()]
        held.set_visibility(status["phase"] == "holding")
        table.set_visibility(bool(rows))
        if rows != table.rows:
            table.rows = rows
            table.update()

    def turn(on: bool) -> None:
        nonlocal seen
        if on != seen:
            seen = on
            (training.open if on else training.close)()
        show()

    turn(shown())
    ui.timer(REFRESH, show)
    ui.context.client.on_delete(lambda: turn(False))
    return lambda: turn(shown())


def words(status: dict[str, Any]) -> str:
    """Where the attempt stands, in one line."""
    if status["problem"]:
        return str(status["problem"])
    if status["phase"] == "done":
        return f"done in {status['time']:.1f} s"
    far = "" if status["way"] is None else f": {directions(status['way'])}"
    time = ": the clock starts as you move" if status["time"] is None else f", {status['time']:.1f} s"
    return f"{status['target']['name']}{far}; {status['phase']}{time}"


def directions(way: tuple[float, float, float]) -> str:
    """The way to a target, as the hands have to do it."""
    out, up, left = way[0], way[1], math.degrees(way[2])
    ends = (("out", "in", out, 2, " m"), ("up", "down", up, 2, " m"), ("left", "right", left, 0, "°"))
    return ", ".join(f"{a if v >= 0 else b} {abs(v):.{n}f}{unit}" for a, b, v, n, unit in ends)


def row(entry: dict[str, Any]) -> dict[str, str]:
    """An attempt in the units of the table; a dash where there is no figure."""
    cells = {
        key: "-" if entry[key] is None else f"{entry[key] * factor:.{digits}f}"
        for key, _, factor, digits in COLUMNS
    }
    return {"attempt": f"{entry['attempt']}{'' if entry['finished'] else ', given up'}", **cells}


def _choose(training: Training, name: str) -> None:
    if name in EXERCISES and name != training.exercise.name:
        training.choose(EXERCISES[name])


def _write(training: Training, path: Path) -> None:
    try:
        ui.notify(f"written: {training.write(path).name}")
    except Problem as error:
        ui.notify(str(error))
