"""What a browser and the server behind it say about driving."""

from __future__ import annotations

from typing import Any

import httpx
import pytest

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
