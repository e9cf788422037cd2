"""What opens over the page: choice of the machine, choice of a file, the map of the keys."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import Any

from nicegui import ui

from orchestrator.view.choice import USUAL, Choice, poses, variants
from orchestrator.view.controls.panel import KEYS
from orchestrator.view.session import Session

Do = Callable[..., Awaitable[bool]]

HOW = "Take the controls, hold the dead-man, then move a stick. Let go and the machine rests."
AS_IS = "as the system is"
PAGE = (
    ("P", "play or pause"),
    ("Home", "from the beginning"),
)
MOUSE = (
    ("drag in the picture", "turn the view"),
    ("wheel", "nearer, farther"),
    ("right button, drag", "shift the view"),
)


def machine(session: Session, do: Do) -> None:
    """Pose and fidelity; the machine starts anew with them."""
    now = session.plan.choice
    with _window("Machine") as window:
        beside = sorted(path.name for path in now.system.parent.glob("*.ssp"))
        systems = list(dict.fromkeys([now.system.name, *beside]))
        system = ui.select(systems, value=now.system.name, label="System")
        names = poses(now.system)
        pose = None
        if names:
            pose = ui.select([AS_IS, *names], value=now.pose or AS_IS, label="Pose")
            pose.mark("pose")
        parts: dict[str, ui.select] = {}
        for part, known in variants(now.system).items():
            value = now.swap.get(part, USUAL)
            if known[USUAL] == f"{value} ({USUAL})":
                value = USUAL
            options = {value: value, **known}
            parts[part] = ui.select(options, value=value, label=part.replace("_", " and "))

        async def begin() -> None:
            swap = {part: str(chosen.value) for part, chosen in parts.items() if chosen.value != USUAL}
            place = str(pose.value) if pose is not None and pose.value != AS_IS else ""
            file = now.system.with_name(str(system.value))
            if await do(session.start, Choice(file, place, swap, now.set)):
                window.close()

        _buttons(window, "Start", begin)


def files(session: Session, do: Do) -> None:
    """Result files of the open folders."""
    names = session.files()
    with _window("Replay a result file") as window:
        if not names:
            there = ", ".join(str(folder) for folder in session.folders) or "none"
            ui.label(f"No .csv or .parquet file with the angles of a machine in {there}")
            _buttons(window)
            return
        chosen = ui.select(names, value=names[0], label="File", with_input=True).mark("file")

        async def begin() -> None:
            if chosen.value and await do(session.replay, chosen.value):
                window.close()

        _buttons(window, "Replay", begin)


def keys() -> None:
    """The map of keys and of the mouse."""
    with _window("Keys, sticks and mouse") as window:
        with ui.element("dl").classes("keys"):
            for key, meaning in (*KEYS, *PAGE, *MOUSE):
                with ui.element("dt"):
                    ui.label(key)
                with ui.element("dd"):
                    ui.label(meaning)
        ui.label(HOW).classes("hint")
        _buttons(window)


def _window(title: str) -> Any:
    """An open dialog that is gone when it is closed; use as context."""
    window = ui.dialog(value=True)
    window.on("hide", window.delete)
    with window, ui.card().classes("window"):
        ui.label(title).classes("heading")
    return _Inside(window)


class _Inside:
    """The card of a dialog as a context that gives the dialog."""

    def __init__(self, window: ui.dialog) -> None:
        self._window = window
        self._card = next(iter(window.default_slot.children))

    def __enter__(self) -> ui.dialog:
        self._card.__enter__()
        return self._window

    def __exit__(self, *of: object) -> None:
        self._card.__exit__(*of)


def _buttons(window: ui.dialog, text: str = "", action: Callable[[], Awaitable[None]] | None = None) -> None:
    with ui.row().classes("buttons"):
        ui.button("Close", on_click=window.close).props("flat")
        if text:
            ui.button(text, on_click=action).mark("confirm")
