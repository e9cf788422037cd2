"""What a browser and the server behind it say about driving."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import httpx
import pytest
from view.standin import LONG, comes

from orchestrator.view.driving.authority import HOLD

STATE = ".harvester-sticks .state"
TOLD = f"document.querySelector('{STATE}').innerText"
SWING, BOOM, STICK = "swing.swing_command", "boom_stick.boom_command", "boom_stick.stick_command"


def answers(url: str) -> bool:
    try:
        return httpx.get(f"{url}/last", timeout=LONG).status_code == 200
    except httpx.TransportError:
        return False


def open_page(browser: Any, address: str) -> Any:
    """A page that has heard from the server: only then it knows whether somebody drives."""
    opened = browser.new_page(viewport={"width": 900, "height": 600})
    opened.set_default_timeout(1e3 * LONG)
    opened.goto(address)
    opened.locator(STATE).wait_for()
    opened.wait_for_function(f"!['connecting', 'no connection'].includes({TOLD})")
    return opened


def take(page: Any, address: str) -> None:
    """The controls, by the keyboard; nothing is held, so the next hold counts."""
    end = time.monotonic() + LONG
    while True:
        if state(address)["role"] == "free":  # once more, if they were lost by a halt meanwhile
            page.get_by_role("button", name="Take controls").focus()
            page.keyboard.press("Enter")
            page.wait_for_function("document.activeElement.className === 'harvester-sticks'")
        if comes(lambda: page.evaluate(TOLD) == HOLD, 3.0):
            return
        assert time.monotonic() < end, f"the page does not drive: {page.evaluate(TOLD)}, {state(address)}"


@dataclass(frozen=True)
class Hands:
    """What holds a dead-man and moves a stick, and lets go of both."""

    press: Callable[[], object]
    release: Callable[[], object]


def keys(page: Any, *names: str) -> Hands:
    """These keys of the keyboard."""
    board = page.keyboard
    return Hands(lambda: [board.down(name) for name in names], lambda: [board.up(name) for name in names])


def hold(page: Any, address: str, hands: Hands, until: Callable[[], bool]) -> None:
    """Hold until something comes to hold. A page that was slow for a moment has lost its dead-man, as it
    should: then the hands let go and hold again, as a driver's would."""
    end = time.monotonic() + LONG
    hands.press()
    while not comes(until, 3.0):
        assert time.monotonic() < end, f"it did not come to hold: {state(address)}"
        hands.release()
        take(page, address)
        page.evaluate("scrollTo(0, 0)")  # a page that did not drive has taken Space for its own
        hands.press()


def state(address: str) -> dict[str, Any]:
    found: dict[str, Any] = httpx.get(f"{address}/last", timeout=LONG).json()
    return found | {"role": "driving" if found["driver"] else "free"}


def heard(address: str) -> int:
    """How many messages of all pages counted."""
    found: int = state(address)["heard"]
    return found


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
