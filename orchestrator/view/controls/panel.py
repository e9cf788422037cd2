"""The controls on the page: sticks, lamp, who drives, pattern and mode.

pilot = Pilot(machine)                  # one per server
endpoint.serve(app, pilot)              # before the server starts
app.on_startup / lifespan: endpoint.watching(pilot)
mount(machine, pilot)                   # in each page
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from nicegui import ui
from nicegui.element import Element

from orchestrator.errors import Problem
from orchestrator.live.setup import Machine
from orchestrator.view.controls.endpoint import PATH
from orchestrator.view.controls.patterns import PATTERNS, legend, pattern
from orchestrator.view.safety.pilot import Pilot
from orchestrator.view.safety.seat import Seat

LIBRARY = {"harvester-sticks": "assets/lib"}
REFRESH = 0.2  # s
TAKE = {"driving": "Let go", "watching": "Ask for controls", "free": "Take controls"}
KEYS = (
    ("Space or Shift, held", "dead-man: without it the machine rests"),
    ("W A S D", "left stick"),
    ("arrows or I J K L", "right stick"),
    ("Esc", "back from a button to the sticks"),
    ("gamepad", "both sticks, a bumper is the dead-man"),
    ("touch or mouse", "on the sticks; holding one is the dead-man"),
)
STYLE = Path(__file__).with_name("assets") / "sticks.css"


class Sticks(Element, component="assets/sticks.js", esm=LIBRARY):
    """The part in the browser; it speaks to the pilot through its own websocket."""

    def __init__(self, seat: Seat) -> None:
        super().__init__()
        self._props.update({"seat": seat.key, "path": PATH, "legend": {}})

    def label(self, words: dict[str, str]) -> None:
        """What each end of each axis does."""
        if self._props["legend"] != words:
            self._props["legend"] = words
            self.update()


def mount(machine: Machine, pilot: Pilot, slow: Callable[[], object] = lambda: None) -> Seat:
    """The controls of one page, at this place of the page; they leave with the page.

    slow   called when the page was too busy to say what the hands do
    """
    seat = pilot.join()
    ui.add_css(STYLE)
    with ui.column().classes("items-center gap-1").mark("controls"):
        sticks = Sticks(seat)
        sticks.on("slow", lambda _: slow())
        with ui.row().classes("items-center gap-3"):
            take = ui.button(TAKE["free"], on_click=lambda: _take(pilot, seat, sticks)).mark("take")
            take.classes("take")
            patterns = ui.toggle(list(PATTERNS), on_change=lambda e: _choose(pilot, seat, e.value))
            modes = ui.toggle([], on_change=lambda e: _choose(pilot, seat, mode=e.value))
        asked = ui.label().classes("text-caption")
        _key_map()

    def show() -> None:
        status = pilot.status(seat)
        take.text = TAKE[status.role]
        take.set_enabled(machine.drives)
        others = status.asked and status.role == "driving"
        asked.text = "another page asks for the controls" if others else ""
        if modes.options != list(status.modes):
            modes.set_options(list(status.modes))
        for toggle, value in ((patterns, status.pattern), (modes, status.mode)):
            toggle.set_enabled(status.role != "watching")
            if toggle.value != value and value:
                toggle.value = value
        sticks.label(legend(pattern(status.pattern), status.mode))

    show()
    ui.timer(REFRESH, show)
    ui.context.client.on_delete(lambda: pilot.leave(seat))
    return seat


def _key_map() -> None:
    with (
        ui.expansion("Keys").props("dense").classes("w-full text-caption"),
        ui.grid(columns=2).classes("gap-0"),
    ):
        for keys, meaning in KEYS:
            ui.label(keys)
            ui.label(meaning)


def _take(pilot: Pilot, seat: Seat, sticks: Sticks) -> None:
    if pilot.status(seat).role == "driving":
        pilot.release(seat)
    elif pilot.take(seat):
        sticks.run_method("focus")
    else:
        ui.notify("asked; who drives has to let go")


def _choose(pilot: Pilot, seat: Seat, pattern_name: str | None = None, mode: str | None = None) -> None:
    status = pilot.status(seat)
    if (pattern_name or status.pattern, mode or status.mode) == (status.pattern, status.mode):
        return
    try:
        pilot.choose(seat, pattern_name, mode)
    except Problem as error:
        ui.notify(str(error))
