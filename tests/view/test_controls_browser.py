"""The sticks in a real browser: keys, gamepad, mouse, and everything that must let go."""

import os
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import httpx
import pytest
from kit import shards
from kit.driven_page import PAD
from kit.wait import LONG, until

from orchestrator.view.authority import AGAIN, HOLD

pytestmark = shards.browser

STATE = ".hm-state"
STAGE = "document.activeElement.classList.contains('hm-stage')"
TOLD = f"document.querySelector('{STATE}').innerText"
HANDS = "document.querySelector('.hm-hands').clientHeight"
SWING, BOOM, STICK = "swing.swing_command", "boom_stick.boom_command", "boom_stick.stick_command"
KEYS = {"KeyA": (SWING, 1), "KeyD": (SWING, -1), "KeyW": (STICK, -1), "KeyS": (STICK, 1)}
KEYS |= {"ArrowUp": (BOOM, -1), "ArrowDown": (BOOM, 1), "KeyI": (BOOM, -1), "KeyK": (BOOM, 1)}


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    """A server with a stand-in for the machine."""
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        port = found.getsockname()[1]
    script = Path(__file__).with_name("standin_page.py")
    child = subprocess.Popen([sys.executable, script, str(port)], cwd=Path(__file__).parents[2])
    try:
        assert until(lambda: child.poll() is not None or answers(f"http://127.0.0.1:{port}"))
        assert child.poll() is None, "the server did not start; its reason stands above"
        yield f"http://127.0.0.1:{port}"
    finally:
        child.terminate()
        child.wait(LONG)


@pytest.fixture(scope="module")
def only(chromium: Any, address: str) -> Iterator[Any]:
    """The page of all tests, in which nothing is held between them."""
    opened = open_page(chromium, address)
    yield opened
    opened.close()


@pytest.fixture
def page(only: Any, address: str) -> Iterator[Any]:
    """The page drives, by the keyboard alone."""
    only.evaluate("() => { if (window.pad) pad.connected = false; scrollTo(0, 0); }")
    only.locator(".hm-stage").focus()
    take(only, address)
    yield only
    for name in ("Space", "ShiftLeft", "ShiftRight", "ArrowDown", *KEYS):
        only.keyboard.up(name)


def answers(url: str) -> bool:
    try:
        return httpx.get(f"{url}/last", timeout=LONG).status_code == 200
    except httpx.TransportError:
        return False


def open_page(browser: Any, address: str, **settings: Any) -> Any:
    """A page that has heard from the server: only then it knows whether somebody drives."""
    opened = browser.new_page(viewport={"width": 900, "height": 600}, **settings)
    opened.set_default_timeout(1e3 * LONG)
    opened.goto(address)
    opened.evaluate(
        "document.body.insertAdjacentHTML('beforeend', '<input aria-label=field><p style=height:3000px>')"
    )
    opened.locator(STATE).wait_for()
    opened.wait_for_function(f"!['connecting', 'no connection'].includes({TOLD})")
    return opened


def take(page: Any, address: str) -> None:
    """The controls, by the keyboard; nothing is held, so the next hold counts."""

    def drives() -> bool:
        if state(address)["role"] == "free":  # once more, if they were lost by a halt meanwhile
            page.get_by_role("button", name="Take controls").focus()
            page.keyboard.press("Enter")
            page.wait_for_function(STAGE)
        return until(lambda: page.evaluate(TOLD) == HOLD, 3.0)

    assert until(drives), f"the page does not drive: {page.evaluate(TOLD)}, {state(address)}"


@dataclass(frozen=True)
class Hands:
    """What holds a dead-man and moves a stick, and lets go of both."""

    press: Callable[[], object]
    release: Callable[[], object]


def keys(page: Any, *names: str) -> Hands:
    """These keys of the keyboard."""
    board = page.keyboard
    return Hands(lambda: [board.down(name) for name in names], lambda: [board.up(name) for name in names])


def hold(page: Any, address: str, hands: Hands, done: Callable[[], bool]) -> None:
    """Hold until it is done. A page that was slow for a moment has lost its dead-man, as it should: then the
    hands let go and hold again, as a driver's would."""

    def held() -> bool:
        hands.press()
        if until(done, 3.0):
            return True
        hands.release()
        take(page, address)
        page.evaluate("scrollTo(0, 0)")  # a page that did not drive has taken Space for its own
        return False

    assert until(held), f"it was not done: {state(address)}"


def state(address: str) -> dict[str, Any]:
    found: dict[str, Any] = httpx.get(f"{address}/last", timeout=LONG).json()
    return found | {"role": "driving" if found["driver"] else "free"}


def command(address: str) -> dict[str, float]:
    """What the machine was told last; empty is rest."""
    last = state(address)["command"]
    return last[0] if last else {}


def full(address: str, name: str, sign: int) -> bool:
    """This function, and only this one, at its stop: 4 V of swing, 6 V of the others."""
    found, volts = command(address), 4 if name == SWING else 6
    alone = sum(map(abs, found.values())) < volts + 0.001  # deflections are sent with three digits
    return bool(found) and found[name] == pytest.approx(volts * sign) and alone


def swings(address: str) -> bool:
    """The machine was told to swing to the left."""
    return command(address).get(SWING, 0) > 0


@pytest.mark.parametrize("dead_man", ["Space", "ShiftLeft", "ShiftRight"])
def test_keys(page: Any, address: str, dead_man: str) -> None:
    """With the dead-man each key moves its function; none scrolls the page; without it nothing moves."""
    for key, (name, sign) in KEYS.items() if dead_man == "Space" else [("KeyA", (SWING, 1))]:
        hold(page, address, keys(page, dead_man, key), lambda name=name, sign=sign: full(address, name, sign))
        page.keyboard.up(dead_man)
        assert until(lambda: command(address) == {})
        page.keyboard.up(key)
    assert page.evaluate("scrollY") == 0


LET_GO = {
    "blur": "window.dispatchEvent(new Event('blur'))",
    "hidden": "document.dispatchEvent(new Event('visibilitychange'))",
    "menu": "document.dispatchEvent(new Event('contextmenu'))",
    "field": "document.querySelector('[aria-label=field]').focus()",
    "pressed twice": "window.dispatchEvent(new KeyboardEvent('keydown', { code: 'KeyA' }))",
}


@pytest.mark.parametrize("way", LET_GO)
def test_let_go(page: Any, address: str, way: str) -> None:
    """Whatever may swallow the release of a key counts as its release; it takes a new press to move again."""
    hold(page, address, keys(page, "Space", "KeyA"), lambda: swings(address))
    page.evaluate(LET_GO[way])
    assert until(lambda: command(address) == {})
    stays_at_rest(address)


def stays_at_rest(address: str) -> None:
    """While ten further messages come, unless the page was away for so long that it drives no more."""
    before = state(address)["heard"]
    assert until(lambda: state(address)["heard"] >= before + 10 or state(address)["role"] == "free")
    assert command(address) == {}


def hang(page: Any, milliseconds: int) -> None:
    """The page is busy from now on; this returns at once."""
    busy = "() => { const end = Date.now() + time; while (Date.now() < end); }"
    page.evaluate(f"(time) => {{ setTimeout({busy}); }}", milliseconds)


def test_frozen_page(page: Any, address: str) -> None:
    """A page that hangs lets go of the dead-man; then it is silent, and others can drive."""
    hold(page, address, keys(page, "Space", "KeyA"), lambda: swings(address))
    hang(page, 10000)  # it is silent after 1 s, and gone after 6 s more
    assert until(lambda: command(address) == {})
    assert state(address)["rested"], "a page that is slow for a moment keeps the controls"
    assert until(lambda: state(address)["role"] == "free")
    # where the browser stands still, too, its connections may end before the silence is noticed
    gone = ("the driver was silent", "the driver's page was closed", "the connection to the driver was lost")
    assert state(address)["why"] in gone


def test_silent_server(page: Any, address: str) -> None:
    """A page that hears nothing for long connects again, and shows what there is when the server goes on."""
    server = state(address)["pid"]
    try:
        with page.expect_websocket():
            os.kill(server, signal.SIGSTOP)
    finally:
        os.kill(server, signal.SIGCONT)
    assert until(lambda: state(address)["role"] == "free")
    page.get_by_text("the connection was lost: take the controls again").wait_for()


def test_stopped_server(page: Any, address: str) -> None:
    """Without a word of the server the lamp is off, the foot says so, the toolbar waits; the sticks stay."""
    hold(page, address, keys(page, "Space", "KeyA"), lambda: swings(address))
    page.locator(".hm-lamp.hm-live").wait_for()
    server, height = state(address)["pid"], page.evaluate(HANDS)
    try:
        os.kill(server, signal.SIGSTOP)
        page.locator(".hm-foot").get_by_text("no connection: trying again").wait_for()
        page.locator(".hm-banner").get_by_text("no connection: trying again").wait_for()
        page.locator(".hm-lamp:not(.hm-live)").wait_for()
        assert page.get_by_role("button", name="Pause").is_disabled()
        page.wait_for_function("!document.querySelector('.harvester-machine').machine.source.opened")
        assert page.get_by_role("button", name="SAE").is_visible()
        assert page.evaluate(HANDS) == height
    finally:
        os.kill(server, signal.SIGCONT)
    page.locator(".hm-pause:not(:disabled)").wait_for()
    page.locator(".hm-foot").get_by_text("running").wait_for()


def test_slow_page(page: Any, address: str) -> None:
    """After a long picture the page says what to do, draws cheaper ones, and goes on after a new hold."""
    hold(page, address, keys(page, "Space", "KeyA"), lambda: swings(address))
    hang(page, 600)
    assert until(lambda: command(address) == {})
    page.get_by_text(AGAIN).wait_for()
    assert page.evaluate("document.querySelector('.harvester-machine').machine.slowed") is True
    stays_at_rest(address)  # the dead-man is held
    page.keyboard.up("Space")
    page.get_by_text(HOLD).wait_for()
    hold(page, address, keys(page, "Space", "KeyA"), lambda: swings(address))


def test_busy_page(page: Any, address: str) -> None:
    """Messages do not wait for the page: many come while it does nothing but compute."""
    hold(page, address, keys(page, "Space", "KeyA"), lambda: swings(address))
    hang(page, 5000)
    assert until(lambda: command(address) == {})  # it hangs: its own timers have stopped
    before = state(address)["heard"]
    assert until(lambda: state(address)["heard"] > before + 3)


def test_keys_without_controls(page: Any) -> None:
    """A key of the sticks on a page that does not drive says which button is missing."""
    page.get_by_role("button", name="Release controls").click()
    page.locator(".hm-stage").focus()
    told = page.get_by_text('press "Take controls" first')

    def says() -> bool:
        page.keyboard.press("KeyD")
        return until(told.is_visible, 1.0)

    assert until(says)  # the word goes after 2.5 s, which a halt may take


def test_typing(page: Any, address: str) -> None:
    """Letters in a field are letters, and move nothing; Escape goes back to the sticks."""
    field = page.get_by_label("field")
    field.click()
    page.keyboard.down("Shift")
    page.keyboard.type("wasd ")
    page.keyboard.up("Shift")
    assert field.input_value().lower() == "wasd "
    assert command(address) == {}
    page.keyboard.press("Escape")
    assert page.evaluate(STAGE)


def test_skip_to_the_controls(chromium: Any, address: str) -> None:
    """By keyboard the first link leads to the sticks, and the next Tab to the button that takes them."""
    opened = open_page(chromium, address)
    opened.keyboard.press("Tab")
    assert opened.evaluate("document.activeElement.textContent") == "Skip to the controls"
    opened.keyboard.press("Enter")
    opened.keyboard.press("Tab")
    assert "hm-take" in opened.evaluate("document.activeElement.className")
    opened.close()


AXES = [("[0] = -1", SWING, 1), ("[1] = -1", STICK, -1), ("[3] = 1", BOOM, 1)]


@pytest.mark.parametrize(("axis", "name", "sign"), AXES)
def test_gamepad(page: Any, address: str, axis: str, name: str, sign: int) -> None:
    """Both sticks of a standard gamepad, with a bumper held; unplugged or of another mapping it is rest."""
    page.evaluate(PAD)
    page.evaluate(f"pad.axes{axis}")
    stays_at_rest(address)  # no bumper is held
    bumper = Hands(*(partial(page.evaluate, f"pad.buttons[5].pressed = {on}") for on in ("true", "false")))
    for what, off, on in (("connected", "false", "true"), ("mapping", "''", "'standard'")):
        hold(page, address, bumper, lambda: full(address, name, sign))
        page.evaluate(f"pad.{what} = {off}")
        assert until(lambda: command(address) == {})
        bumper.release()
        page.evaluate(f"pad.{what} = {on}")


def test_gamepad_that_drifts(page: Any, address: str) -> None:
    """A stick of a gamepad whose bumper is not held does not count when the keyboard's dead-man is."""
    page.evaluate(PAD)
    page.evaluate("pad.axes[0] = 1")
    hold(page, address, keys(page, "Space", "ArrowDown"), lambda: full(address, BOOM, 1))


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
    assert until(lambda: command(address) == {})


def test_words_for_fingers(chromium: Any, address: str) -> None:
    """Where there is no mouse, the page speaks of the sticks on the screen, not of keys."""
    opened = open_page(chromium, address, has_touch=True, is_mobile=True)
    for told, shown in ((HOLD, "drag a stick"), (AGAIN, "let go, then drag a stick")):
        opened.evaluate(f"document.querySelector('.harvester-machine').machine.describe = () => '{told}'")
        opened.locator(STATE).get_by_text(shown, exact=True).wait_for()
    opened.close()


def test_second_page(page: Any, chromium: Any, address: str) -> None:
    """A second page sees who drives and asks; closing the first is rest, and the second can take over."""
    page.get_by_role("button", name="Release controls").click()
    assert until(lambda: state(address)["role"] == "free")
    first = open_page(chromium, address)  # in a window of its own: it keeps its focus
    take(first, address)
    hold(first, address, keys(first, "Space", "KeyA"), lambda: swings(address))
    page.get_by_role("button", name="Request controls").click()
    assert until(lambda: state(address)["asked"] != "")
    first.close()
    assert until(lambda: command(address) == {})
    page.get_by_text("the controls are free").wait_for()
    page.get_by_role("button", name="Take controls").click()
    assert until(lambda: state(address)["role"] == "driving")
