"""The bar of buttons: play, pause, restart, speed, pose and fidelity, replay, save, views, help."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from nicegui import run, ui
from nicegui.element import Element

from orchestrator.errors import Problem
from orchestrator.live.setup import Frame
from orchestrator.view.panels import dialogs
from orchestrator.view.panels.seek import Seek
from orchestrator.view.safety.pilot import Pilot
from orchestrator.view.scene.canvas import TIP, VIEWS, Canvas
from orchestrator.view.session import Session

SPEEDS: Mapping[float, str] = {f: f"\N{MULTIPLICATION SIGN} {f:g}" for f in (0.1, 0.25, 0.5, 1.0, 2.0, 5.0)}

Allowed = Callable[[], str]


class Shortcuts(Element, component="shortcuts.js"):
    """Keys for the page, by their places on the keyboard."""

    def __init__(self, actions: Mapping[str, Callable[[], Any]]) -> None:
        super().__init__()
        self._props["codes"] = list(actions)
        self.on("press", lambda event: actions[event.args]() if event.args in actions else None)


class Bar:
    """The bar of one page."""

    def __init__(self, session: Session, canvas: Canvas, allowed: Allowed, pilot: Pilot) -> None:
        """allowed: why this page may not decide for all, or nothing; pilot: rests before anything changes."""
        self._session, self._allowed, self._pilot = session, allowed, pilot
        with ui.row().classes("bar") as self._row:
            self._title = ui.label().classes("title")
            self._seek = Seek(session)
            self._play = button("play_arrow", "Play or pause (P)", self._toggle).mark("play")
            button("replay", "From the beginning (Home)", self._again).mark("restart")
            self._speed = ui.select(dict(SPEEDS), value=1.0, on_change=lambda e: self._set_speed(e.value))
            self._speed.props('dense borderless options-dense hide-bottom-space aria-label="Speed"')
            self._speed.classes("speed").tooltip("Simulated over real time")
            button("tune", "Pose and fidelity", lambda: dialogs.machine(session, self.do), "Machine").mark(
                "machine"
            )
            button("folder_open", "Replay a result file", lambda: dialogs.files(session, self.do), "Replay")
            self._live = button("sensors", "Back to the live machine", self._back, "Live").mark("live")
            button("save_alt", "Save the session as a result file", self._save, "Save").mark("save")
            with button("videocam", "View", None, "View"), ui.menu():
                for name in (*VIEWS, TIP):
                    ui.menu_item(name.capitalize(), lambda n=name: canvas.look(n, 0.6))
            button("keyboard", "Keys, sticks and mouse", dialogs.keys, "Keys").mark("help")
            Shortcuts({"KeyP": self._toggle, "Home": self._again})

    def extra(self, icon: str, text: str, action: Callable[..., Any], name: str) -> None:
        """One more button, at the end."""
        with self._row:
            button(icon, text, action, name)

    def show(self, frame: Frame) -> None:
        """What changes with the state; nothing is sent while nothing changes."""
        playing = frame.state in ("running", "starting")
        self._play.set_icon("pause" if playing else "play_arrow")
        self._title.set_text(self._session.title)
        self._live.set_visibility(self._session.replaying)
        self._seek.show(frame.t)
        self._speed.value = self._session.machine.factor  # another page may have changed it

    async def do(self, action: Callable[..., Any], *arguments: Any) -> bool:
        """Something that all pages see, after which nobody drives; a mistake is told in one line."""
        return await self._done(self._pilot.stop, action, *arguments)

    async def go_on(self, action: Callable[..., Any], *arguments: Any) -> bool:
        """The same machine goes on: who drives keeps the controls, and needs the dead-man afresh."""
        return await self._done(self._pilot.halt, action, *arguments)

    async def _done(self, before: Callable[[], None], action: Callable[..., Any], *arguments: Any) -> bool:
        refused = self._allowed()
        if refused:
            ui.notify(refused, type="warning")
            return False
        before()
        try:
            await run.io_bound(action, *arguments)
        except Problem as problem:
            ui.notify(str(problem), type="negative", multi_line=True)
            return False
        return True

    async def _again(self) -> None:
        await self.do(self._session.again)

    async def _back(self) -> None:
        await self.do(self._session.back)

    async def _toggle(self) -> None:
        state = self._session.machine.latest().state
        if state in ("running", "starting"):
            self._session.machine.pause()  # to stop is allowed to everybody
        elif state in ("ended", "failed"):
            await self.do(self._session.again)
        else:
            await self.go_on(self._session.machine.play)

    async def _set_speed(self, factor: float) -> None:
        if factor != self._session.machine.factor:
            await self.go_on(self._session.machine.speed, factor)

    async def _save(self) -> None:
        try:
            path = await run.io_bound(self._session.save)
        except Problem as problem:
            ui.notify(str(problem), type="negative", multi_line=True)
            return
        if path is None:  # the server ends
            return
        ui.notify(f"saved: {path}", type="positive")
        ui.download(path)


def button(icon: str, text: str, action: Callable[..., Any] | None, name: str = "") -> ui.button:
    """A small flat button with a tooltip; where there is room, its name beside the icon."""
    found = ui.button(name, icon=icon, on_click=action)
    found.props(f'flat dense no-caps size=md aria-label="{text}"')
    return found.tooltip(text)
