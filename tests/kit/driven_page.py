"""Drives the machine on a page in a browser, and compares its motion with that of `harvester run`."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from orchestrator.data.trace import read_trace
from orchestrator.engine.run import run

READY = ".harvester-machine[data-ready]"
LONG = 120.0  # s; only bounds a failure
SECTION = "document.querySelector('.harvester-machine').machine"
# values after each frame since the last start, as [time, boom, swing, stick]
NOTE = f"""() => {{ const s = {SECTION}, add = s.sources.drive.history.add; s.seen = [];
  s.sources.drive.history.add = function (t, v) {{
    if (s.seen.length && t < s.seen[s.seen.length - 1][0]) s.seen = [];
    s.seen.push([t, v.boom_angle, v.swing_angle, v.stick_angle]); add.call(this, t, v); }}; }}"""
# of a browser without WebGL, for `add_init_script`
NO_WEBGL = """{ const { getContext } = HTMLCanvasElement.prototype;
  HTMLCanvasElement.prototype.getContext = function (kind, ...more) {
    return kind.startsWith("webgl") ? null : getContext.call(this, kind, ...more); }; }"""
# a gamepad that a test moves
PAD = """() => {
  window.pad = { id: "stub", connected: true, mapping: "standard", axes: [0, 0, 0, 0],
                 buttons: Array.from({ length: 17 }, () => ({ pressed: false })) };
  navigator.getGamepads = () => [null, window.pad];
}"""
OWN = ("file", "blob", "data")  # schemes of addresses that no network sees


class Opened:
    """A page from disk. requests: schemes of the addresses asked for; complaints: errors in the console."""

    def __init__(self, chromium: Any, file: Path, webgl: bool = True, **settings: Any) -> None:
        self.context = chromium.new_context(viewport={"width": 1100, "height": 900}, **settings)
        self.page = self.context.new_page()
        self.page.set_default_timeout(1e3 * LONG)
        self.requests, self.complaints = set[str](), list[str]()
        self.context.on("request", lambda request: self.requests.add(request.url.partition(":")[0]))
        self.page.on("console", lambda m: self.complaints.append(m.text) if m.type == "error" else None)
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        if not webgl:
            self.page.add_init_script(NO_WEBGL)
        self.page.goto(file.as_uri())
        self.page.wait_for_selector(READY)

    def ask(self, expression: str) -> Any:
        """What an expression of the section has as its value."""
        return self.page.evaluate(f"() => {SECTION}.{expression}")

    def until(self, condition: str) -> None:
        """Wait until a condition on the section s holds."""
        self.page.wait_for_function(f"() => {{ const s = {SECTION}; return {condition}; }}")


def drive(page: Opened) -> None:
    """Swing, boom and stick by keys, payload and pressure by sliders, for 6 s of simulated time or more.

    Five times as fast as real time: a frame is the same.
    """
    page.page.locator(".hm-speed").select_option("5")
    page.page.get_by_role("button", name="Drive", exact=True).click()
    page.page.locator(".hm-pose").select_option("reach")
    page.page.get_by_label("Head mass").fill("500")
    page.page.get_by_role("button", name="Start again").click()
    page.page.get_by_label("Payload").fill("200")
    page.page.locator(".hm-stage").focus()
    keyboard = page.page.keyboard
    keyboard.down("a")
    hold(page, "ArrowDown", 1.0)
    hold(page, "KeyW", 1.0)
    page.page.get_by_label("Supply pressure").fill("150")
    page.page.locator(".hm-stage").focus()
    hold(page, "s", 1.5)
    page.until("s.source.time > 6")
    page.page.locator(".hm-stage").focus()
    keyboard.press("p")


def hold(page: Opened, key: str, duration: float) -> None:
    """Hold a key for this simulated time [s], however long that takes on a busy computer."""
    page.page.keyboard.down(key)
    page.until(f"s.source.time > {page.ask('source.time') + duration}")
    page.page.keyboard.up(key)


def assert_same_motion(page: Opened, fmu: Path, folder: Path) -> None:
    """Driven by hand, the machine is where `harvester run` has it with what the page saves and says.

    Nothing is asked of the network.
    """
    page.page.evaluate(NOTE)
    drive(page)
    seen = page.ask("seen")
    with page.page.expect_download() as download:
        page.page.get_by_role("button", name="Save the drive").click()
    download.value.save_as(folder / "drive.csv")
    scenario = read_trace(folder / "drive.csv")
    assert np.ptp(scenario["boom_command"]) > 1, "the key did nothing"
    assert np.ptp(scenario["supply_pressure"]) == pytest.approx(20.684e6 - 15e6)
    command = page.page.locator(".hm-said").inner_text().removeprefix("the same drive: ")
    sets = re.findall(r" --set (\S+)=(\S+)", command)
    assert {"harvester.head_mass", "harvester.initial_boom_angle"} <= {name for name, _ in sets}, command
    result = run(fmu, scenario, stop=float(scenario.time[-1]), step=1e-3, set=dict(sets))
    time, *angles = np.array(seen).T
    at = int(np.argmin(np.abs(time - 5.0)))
    assert time[at] == pytest.approx(5.0, abs=0.02)
    for name, values in zip(("boom_angle", "swing_angle", "stick_angle"), angles, strict=True):
        same = result.trace.at(time)[f"harvester.{name}"]
        assert np.ptp(values) > 0.05, f"{name} did not move"
        # the bar of the page; the same C code with another libm differs by some 1e-15
        assert values[at] == pytest.approx(same[at], abs=1e-9)
        np.testing.assert_allclose(values, same, atol=1e-9)
    assert page.complaints == []
    assert page.requests <= set(OWN), "a request left the page"
