"""What a browser and the server behind it say about driving."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import httpx
import pytest
from view.standin import comes

from orchestrator.view.safety.pilot import HOLD

LONG = 60.0  # s; only bounds a failure, on a computer that does much else
SWING, BOOM, STICK = "swing.swing_command", "boom_stick.boom_command", "boom_stick.stick_command"


def answers(url: str) -> bool:
    try:
        return httpx.get(f"{url}/last").status_code == 200
    except httpx.TransportError:
        return False


def open_page(browser: Any, address: str) -> Any:
    opened = browser.new_page(viewport={"width": 900, "height": 600})
    opened.goto(address)
    opened.wait_for_function("document.querySelector('.harvester-sticks .state')?.innerText !== 'connecting'")
    return opened


def take(page: Any, address: str) -> None:
    """The controls, by the keyboard; nothing is held, so the next hold counts."""
    if state(address)["role"] == "free":
        page.get_by_role("button", name="Take controls").focus()
        page.keyboard.press("Enter")
        page.wait_for_function("document.activeElement.className === 'harvester-sticks'")
    page.wait_for_function(f"document.querySelector('.harvester-sticks .state').innerText === '{HOLD}'")


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
        hands.press()


def state(address: str) -> dict[str, Any]:
    found: dict[str, Any] = httpx.get(f"{address}/last").json()
    return found | {"role": "driving" if found["driver"] else "free"}


def heard(address: str) -> int:
    """How many messages of all pages counted."""
    found: int = httpx.get(f"{address}/last").json()["heard"]
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
