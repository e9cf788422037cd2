"""The toolbar: buttons, dialogs for machine, replay file and keys, slider of a replay, and shortcuts."""

from collections.abc import Awaitable, Callable, Mapping
from functools import partial
from typing import Any

from nicegui import run, ui
from nicegui.element import Element

from orchestrator.base.errors import Problem
from orchestrator.realtime.setup import Frame
from orchestrator.scene.drawing import VIEWS
from orchestrator.view.choice import USUAL, MachineChoice, poses, variants
from orchestrator.view.driving.authority import ControlAuthority
from orchestrator.view.driving.endpoint import KEYS
from orchestrator.view.scene.canvas import TIP, Canvas
from orchestrator.view.session import Session

Do = Callable[..., Awaitable[bool]]

HOW = "Take the controls, hold the dead-man, then move a stick. Release the dead-man and the machine rests."
AS_IS = "As in the system"
PAGE = (("P", "play or pause"), ("Home", "start again"))
MOUSE = (
    ("drag in the picture", "rotate the view"),
    ("wheel", "zoom"),
    ("right button, drag", "shift the view"),
)


def machine(session: Session, do: Do) -> None:
    """Dialog for system, pose and variants. The machine starts again with them."""
    now = session.plan.choice
    with _window("Machine") as window:
        others = sorted(path.name for path in now.system.parent.glob("*.ssp"))
        systems = list(dict.fromkeys([now.system.name, *others]))
        system = ui.select(systems, value=now.system.name, label="System")
        names = poses(now.system)
        pose = None
        if names:
            pose = ui.select([AS_IS, *names], value=now.pose or AS_IS, label="Pose")
            pose.mark("pose")
        parts: dict[str, ui.select] = {}
        for part, labels in variants(now.system).items():
            value = now.swap.get(part, USUAL)
            if labels[USUAL] == f"{value} ({USUAL})":
                value = USUAL
            options = {value: value, **labels}
            parts[part] = ui.select(options, value=value, label=part.replace("_", " and ").capitalize())

        async def begin() -> None:
            swap = {part: str(chosen.value) for part, chosen in parts.items() if chosen.value != USUAL}
            chosen_pose = str(pose.value) if pose is not None and pose.value != AS_IS else ""
            file = now.system.with_name(str(system.value))
            if await do(session.start, MachineChoice(file, chosen_pose, swap, now.set)):
                window.close()

        _buttons(window, "Start", begin)


def files(session: Session, do: Do) -> None:
    """Dialog for the result files of the open folders."""
    names = session.files()
    with _window("Replay a result file") as window:
        if not names:
            folders = ", ".join(str(folder) for folder in session.folders) or "none"
            ui.label(f"No .csv or .parquet file with signals of this machine in {folders}")
            _buttons(window)
            return
        chosen = ui.select(names, value=names[0], label="File", with_input=True).mark("file")

        async def begin() -> None:
            if chosen.value and await do(session.replay, chosen.value):
                window.close()

        _buttons(window, "Replay", begin)


def keys() -> None:
    """Dialog with the keys and mouse actions."""
    with _window("Keys, sticks and mouse") as window:
        with ui.element("dl").classes("keys"):
            for key, meaning in (*KEYS, *PAGE, *MOUSE):
                with ui.element("dt"):
                    ui.label(f"{key[:1].upper()}{key[1:]}")
                with ui.element("dd"):
                    ui.label(meaning)
        ui.label(HOW).classes("hint")
        _buttons(window)


def _window(title: str) -> Any:
    """Context of an open dialog, which is deleted when it is closed."""
    window = ui.dialog(value=True)
    window.on("hide", window.delete)
    window.props(f'aria-label="{title}"')
    with window, ui.card().classes("window"):
        ui.label(title).classes("heading").props("role=heading aria-level=2")
    return _Inside(window)


class _Inside:
    """Context that adds elements to the card of a dialog, and returns the dialog."""

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
        ui.button("Close", on_click=window.close).props("flat no-caps")
        if text:
            ui.button(text, on_click=action).props("no-caps").mark("confirm")


STEP = 0.001  # fraction of the file; the knob is not moved for a smaller difference


class Seek:
    """Slider with the position in the replayed file; hidden for a live machine."""

    def __init__(self, session: Session) -> None:
        self._session, self._held = session, False
        self._slider = ui.slider(min=0.0, max=1.0, step=STEP, value=0.0).classes("seek").mark("seek")
        self._slider.props('dense aria-label="Time of the replay"')
        self._slider.on("pan", self._pan)
        self._slider.on("change", self._go)

    def show(self, t: float) -> None:
        """Follow the replay, unless the knob is held."""
        span = self._session.span
        self._slider.set_visibility(span is not None)
        if span is None or self._held:
            return
        position = (t - span[0]) / max(span[1] - span[0], 1e-9)
        if abs(self._slider.value - position) > STEP:
            self._slider.value = position

    def _pan(self, event: Any) -> None:
        self._held = event.args == "start"

    def _go(self, event: Any) -> None:
        if (span := self._session.span) is not None:
            self._session.seek(span[0] + float(event.args) * (span[1] - span[0]))


SPEEDS: Mapping[float, str] = {f: f"\N{MULTIPLICATION SIGN} {f:g}" for f in (0.1, 0.25, 0.5, 1.0, 2.0, 5.0)}

Allowed = Callable[[], str]


class Shortcuts(Element, component="shortcuts.js"):
    """Keys of the page, by key code, so that they do not depend on the keyboard layout."""

    def __init__(self, actions: Mapping[str, Callable[[], Any]]) -> None:
        super().__init__()
        self._props["codes"] = list(actions)
        self.on("press", lambda event: actions[event.args]() if event.args in actions else None)


class Bar:
    """The toolbar of one page."""

    def __init__(
        self, session: Session, canvas: Canvas | None, allowed: Allowed, authority: ControlAuthority
    ) -> None:
        """allowed: returns a reason why this page may not change the machine, or empty."""
        self._session, self._allowed, self._authority = session, allowed, authority
        with ui.row().classes("bar") as self._row:
            self._title = ui.label().classes("title").props("role=heading aria-level=1")
            self._seek = Seek(session)
            self._play = button("play_arrow", "Play or pause (P)", self._toggle).mark("play")
            button("replay", "Start again (Home)", self._again).mark("restart")
            self._speed = ui.select(dict(SPEEDS), value=1.0, on_change=lambda e: self._set_speed(e.value))
            self._speed.props('dense borderless options-dense hide-bottom-space aria-label="Speed"')
            self._speed.classes("speed").tooltip("Simulated time over real time")
            button("tune", "Pose and fidelity", lambda: machine(session, self.do), "Machine").mark("machine")
            button("folder_open", "Replay a result file", lambda: files(session, self.do), "Replay")
            self._live = button("sensors", "Back to the live machine", self._back, "Live").mark("live")
            button("save_alt", "Save the session as a result file", self._save, "Save").mark("save")
            if canvas is not None:
                with button("videocam", "View", None, "View"), ui.menu():
                    for name in (*VIEWS, TIP):
                        ui.menu_item(name.capitalize(), partial(canvas.look, name, 0.6))
            button("keyboard", "Keys, sticks and mouse", keys, "Keys").mark("help")
            Shortcuts({"KeyP": self._toggle, "Home": self._again})

    def extra(self, icon: str, text: str, action: Callable[..., Any], name: str) -> None:
        """Add a button at the end."""
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
        return await self._done(self._authority.stop, action, *arguments)

    async def go_on(self, action: Callable[..., Any], *arguments: Any) -> bool:
        """Change the running machine. The driver keeps the controls and must hold the dead-man again."""
        return await self._done(self._authority.halt, action, *arguments)

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
            self._session.machine.pause()  # every page may pause
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
    """A small flat button with a tooltip; its name is shown next to the icon if there is room."""
    element = ui.button(name, icon=icon, on_click=action)
    element.props(f'flat dense no-caps size=md aria-label="{text}"')
    return element.tooltip(text)
