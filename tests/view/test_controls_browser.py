"""The sticks in a real browser: keys, gamepad, mouse, and everything that must let go."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from kit import shards
from view.driving import (
    BOOM,
    STICK,
    SWING,
    Hands,
    answers,
    command,
    full,
    heard,
    hold,
    keys,
    open_page,
    state,
    swings,
    take,
)
from view.standin import LONG, comes, wait

from orchestrator.view.driving.authority import AGAIN, HOLD

pytestmark = shards.browser

PAD = """() => {
  window.pad = { id: "stub", connected: true, mapping: "standard", axes: [0, 0, 0, 0],
                 buttons: Array.from({ length: 17 }, () => ({ pressed: false })) };
  navigator.getGamepads = () => [null, window.pad];
}"""


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    """A server with a stand-in for the machine."""
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        port = found.getsockname()[1]
    script = Path(__file__).with_name("standin_page.py")
    # the library would take this for a test of its own
    free = {name: value for name, value in os.environ.items() if not name.startswith(("PYTEST", "NICEGUI"))}
    child = subprocess.Popen([sys.executable, script, str(port)], cwd=Path(__file__).parents[2], env=free)
    try:
        wait(lambda: child.poll() is not None or answers(f"http://127.0.0.1:{port}"))
        assert child.poll() is None, "the server did not start; its reason stands above"
        yield f"http://127.0.0.1:{port}"
    finally:
        child.terminate()
        child.wait(LONG)


@pytest.fixture
def page(chromium: Any, address: str) -> Iterator[Any]:
    """A page that drives, by the keyboard alone."""
    opened = open_page(chromium, address)
    wait(lambda: state(address)["role"] == "free")
    take(opened, address)
    yield opened
    opened.close()


KEYS = {
    "KeyA": (SWING, 1), "KeyD": (SWING, -1), "KeyW": (STICK, -1), "KeyS": (STICK, 1),
    "ArrowUp": (BOOM, -1), "ArrowDown": (BOOM, 1), "KeyI": (BOOM, -1), "KeyK": (BOOM, 1),
}  # fmt: skip


@pytest.mark.parametrize("dead_man", ["Space", "ShiftLeft", "ShiftRight"])
def test_keys(page: Any, address: str, dead_man: str) -> None:
    """With the dead-man each key moves its function; none scrolls the page; without it nothing moves."""
    for key, (name, sign) in KEYS.items() if dead_man == "Space" else [("KeyA", (SWING, 1))]:
        hold(page, address, keys(page, dead_man, key), lambda name=name, sign=sign: full(address, name, sign))
        page.keyboard.up(dead_man)
        wait(lambda: command(address) == {})
        page.keyboard.up(key)
    assert page.evaluate("scrollY") == 0


LET_GO = {
    "blur": "window.dispatchEvent(new Event('blur'))",
    "hidden": "document.dispatchEvent(new Event('visibilitychange'))",
    "menu": "document.dispatchEvent(new Event('contextmenu'))",
    "field": "document.querySelector('input').focus()",
}


@pytest.mark.parametrize("way", LET_GO)
def test_let_go(page: Any, address: str, way: str) -> None:
    """Whatever may swallow the release of a key counts as its release; it takes a new press to move again."""
    hold(page, address, keys(page, "Space", "KeyA"), lambda: swings(address))
    page.evaluate(LET_GO[way])
    wait(lambda: command(address) == {})
    stays_at_rest(address)
    page.keyboard.up("Space")
    page.keyboard.up("KeyA")


def stays_at_rest(address: str) -> None:
    """While ten further messages come, unless the page was away for so long that it drives no more."""
    before = heard(address)
    wait(lambda: heard(address) >= before + 10 or state(address)["role"] == "free")
    assert command(address) == {}


def test_lost_release(page: Any, address: str) -> None:
    """A key that is pressed twice without a release between lets go of everything."""
    hold(page, address, keys(page, "Space", "KeyA"), lambda: swings(address))
    page.evaluate("window.dispatchEvent(new KeyboardEvent('keydown', { code: 'KeyA' }))")
    wait(lambda: command(address) == {})


def hang(page: Any, milliseconds: int) -> None:
    """The page is busy from now on; this returns at once."""
    busy = "() => { const end = Date.now() + time; while (Date.now() < end); }"
    page.evaluate(f"(time) => {{ setTimeout({busy}); }}", milliseconds)


def test_frozen_page(page: Any, address: str) -> None:
    """A page that hangs lets go of the dead-man; then it is silent, and others can drive."""
    hold(page, address, keys(page, "Space", "KeyA"), lambda: swings(address))
    hang(page, 16000)  # it is silent after 1 s, and gone after 6 s more
    wait(lambda: command(address) == {})
    assert state(address)["rested"], "a page that is slow for a moment keeps the controls"
    wait(lambda: state(address)["role"] == "free")
    # where the browser stands still, too, its connections may end before the silence is noticed
    gone = ("the driver was silent", "the driver's page was closed", "the connection to the driver was lost")
    assert state(address)["why"] in gone
    page.keyboard.up("Space")
    page.keyboard.up("KeyA")


def test_slow_page(page: Any, address: str) -> None:
    """After a long picture the page says what to do, draws cheaper ones, and goes on after a new hold."""
    page.evaluate("() => window.addEventListener('harvester-slow', () => (window.slow = true))")
    hold(page, address, keys(page, "Space", "KeyA"), lambda: swings(address))
    hang(page, 600)
    wait(lambda: command(address) == {})
    page.get_by_text(AGAIN).wait_for()
    assert page.evaluate("window.slow") is True
    stays_at_rest(address)  # the dead-man is held
    page.keyboard.up("Space")
    page.get_by_text(HOLD).wait_for()
    hold(page, address, keys(page, "Space", "KeyA"), lambda: swings(address))
    page.keyboard.up("Space")
    page.keyboard.up("KeyA")


def test_busy_page(page: Any, address: str) -> None:
    """Messages do not wait for the page: many come while it does nothing but compute."""
    hold(page, address, keys(page, "Space", "KeyA"), lambda: swings(address))
    hang(page, 5000)
    wait(lambda: command(address) == {})  # it hangs: its own timers have stopped
    before = heard(address)
    wait(lambda: heard(address) > before + 3)
    page.keyboard.up("Space")
    page.keyboard.up("KeyA")


def test_keys_without_controls(chromium: Any, address: str) -> None:
    """A key of the sticks on a page that does not drive says which button is missing."""
    opened = open_page(chromium, address)
    wait(lambda: state(address)["role"] == "free")
    told = opened.get_by_text('press "Take controls" first')

    def says() -> bool:
        opened.keyboard.press("KeyD")
        return comes(told.is_visible, 1.0)

    wait(says)  # the word goes after 2.5 s, which a halt may take
    opened.close()


def test_typing(page: Any, address: str) -> None:
    """Letters in a field are letters, and move nothing; Escape goes back to the sticks."""
    field = page.locator("input").first
    field.click()
    page.keyboard.down("Shift")
    page.keyboard.type("wasd ")
    page.keyboard.up("Shift")
    assert field.input_value().lower() == "wasd "
    assert command(address) == {}
    page.keyboard.press("Escape")
    assert page.evaluate("document.activeElement.className") == "harvester-sticks"


@pytest.mark.parametrize(
    ("axis", "value", "name", "sign"), [(0, -1, SWING, 1), (1, -1, STICK, -1), (3, 1, BOOM, 1)]
)
def test_gamepad(page: Any, address: str, axis: int, value: int, name: str, sign: int) -> None:
    """Both sticks of a standard gamepad, with a bumper held; unplugged or of another mapping it is rest."""
    page.evaluate(PAD)
    page.evaluate(f"pad.axes[{axis}] = {value}")
    stays_at_rest(address)  # no bumper is held
    bumper = Hands(
        lambda: page.evaluate("pad.buttons[5].pressed = true"),
        lambda: page.evaluate("pad.buttons[5].pressed = false"),
    )
    for off, on in (
        ("pad.connected = false", "pad.connected = true"),
        ("pad.mapping = ''", "pad.mapping = 'standard'"),
    ):
        hold(page, address, bumper, lambda: full(address, name, sign))
        page.evaluate(off)
        wait(lambda: command(address) == {})
        bumper.release()
        page.evaluate(on)


def test_gamepad_that_drifts(page: Any, address: str) -> None:
    """A stick of a gamepad whose bumper is not held does not count when the keyboard's dead-man is."""
    page.evaluate(PAD)
    page.evaluate("pad.axes[0] = 1")
    hold(page, address, keys(page, "Space", "ArrowDown"), lambda: full(address, BOOM, 1))
    page.keyboard.up("Space")
    page.keyboard.up("ArrowDown")


def test_mouse(page: Any, address: str) -> None:
    """A stick on the screen follows the mouse, springs back, and is its own dead-man."""
    box = page.locator("[data-hand=left]").bounding_box()
    middle = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2

    def press() -> None:
        page.mouse.move(*middle)
        page.mouse.down()
        page.mouse.move(middle[0] - 200, middle[1])

    hold(page, address, Hands(press, page.mouse.up), lambda: full(address, SWING, 1))
    page.mouse.up()
    wait(lambda: command(address) == {})


def test_second_page(page: Any, chromium: Any, address: str) -> None:
    """A second page sees who drives and asks; closing the first is rest, and the second can take over."""
    hold(page, address, keys(page, "Space", "KeyA"), lambda: swings(address))
    second = open_page(chromium, address)  # in a window of its own: the first one keeps its focus
    second.get_by_role("button", name="Request controls").click()
    wait(lambda: state(address)["asked"] != "")
    page.close()
    wait(lambda: command(address) == {})
    second.get_by_role("button", name="Take controls").click()
    wait(lambda: state(address)["role"] == "driving")
    second.close()
    wait(lambda: state(address)["role"] == "free")
