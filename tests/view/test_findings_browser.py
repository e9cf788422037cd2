"""Parts of the page in a real browser: the panel of a diagnosis; a system without a drawing."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from kit import shards
from kit.wait import LONG, until
from view import garage

from orchestrator.ssp.load import assemble
from orchestrator.ssp.write import write_ssp
from orchestrator.view.choice import MachineChoice
from orchestrator.view.server import Server
from orchestrator.view.session import Session

pytestmark = shards.browser
MINUS, SQUARE, SIGN = "\N{MINUS SIGN}", "mm\N{SUPERSCRIPT TWO}", "\N{PLUS-MINUS SIGN}"
FAULTS = {"garage.leak_now": "3e-6", "garage.leak_judged": "1@0.5s", "garage.blur": "30"}
FAULTS |= {"garage.switch_now": "1", "garage.switch_judged": "1@1s"}
FAULTS |= {"garage.heat_now": "353.15", "garage.heat_judged": "-1"}


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """A machine that has a leak and a switch that does not close, and starts paused."""
    session = Session(MachineChoice(garage.system(tmp_path_factory.mktemp("workshop")), fault=FAULTS))
    session.machine.pause()
    session.machine.restart()  # paused, as before
    server = Server(session)
    server.start()
    yield server
    server.stop()
    session.close()


@pytest.fixture(scope="module")
def page(chromium: Any, served: Server) -> Iterator[Any]:
    """Its page, before and after the faults."""
    opened = chromium.new_page()
    opened.complaints = []
    opened.on("console", lambda m: opened.complaints.append(m.text) if m.type == "error" else None)
    opened.on("pageerror", lambda error: opened.complaints.append(str(error)))
    opened.set_default_timeout(1e3 * LONG)
    opened.goto(served.url)
    opened.wait_for_function("() => document.querySelector('.hm-findings summary')?.textContent")
    assert opened.get_by_text("Nothing found.").is_visible()
    assert opened.locator(".hm-findings [aria-live=polite]").inner_text() == ""
    opened.get_by_role("button", name="Go on").click()
    assert until(lambda: opened.locator(".hm-findings li").count() == 2)
    yield opened
    opened.close()


def value(page: Any, expression: str, argument: object = None) -> Any:
    """An expression of the module m and of a."""
    script = f"async (a) => {{ const m = await import('drive/findings.js'); return {expression}; }}"
    return page.evaluate(script, argument)


def test_faults(page: Any) -> None:
    """The most certain first: what, how much, since when, the repair; names are no HTML; a voice says so."""
    switch, leak = (one.split("\n") for one in page.locator(".hm-findings li").all_inner_texts())
    assert switch == ["The <b>switch</b> does not close", "since 1.0 s. Repair: <i>switch</i>"]
    assert leak[:2] == ["Opening of hose one at 60 °C", f"3.00 {SQUARE} (95 %: 2.61 to 3.39)"]
    assert leak[2:] == ["since 0.5 s. Repair: hose one (left)"]
    assert not page.get_by_text("Nothing found.").is_visible()
    assert "switch" in page.locator(".hm-findings [aria-live=polite]").inner_text()
    assert page.locator(".hm-findings > div").inner_text().split() == f"Load:200 {SIGN} 30 kg".split()
    assert page.complaints == []


def test_what_cannot_be_told(page: Any) -> None:
    """It is folded, by repair; a key opens it."""
    summary = page.locator(".hm-findings summary")
    assert summary.inner_text() == "Cannot be told now: 1"
    assert not page.get_by_text("Temperature of the oil").is_visible()
    summary.focus()
    page.keyboard.press("Enter")
    assert page.locator(".hm-findings dl").inner_text() == "cooler\nTemperature of the oil"
    page.keyboard.press("Enter")


def test_forgotten(page: Any, served: Server) -> None:
    """Who drives can have faults forgotten, for a moment."""
    button = page.get_by_role("button", name="Forget")
    assert button.is_disabled()
    page.get_by_role("button", name="Take controls").click()
    assert until(button.is_enabled)
    button.focus()
    page.keyboard.press("Enter")
    assert until(lambda: served.session.machine.latest().axes[0] == 1)
    assert until(lambda: served.session.machine.latest().axes[0] == 0)
    page.get_by_role("button", name="Release controls").click()
    assert until(button.is_disabled)


@pytest.mark.parametrize(("width", "scheme"), [(360, "light"), (360, "dark"), (1280, "dark")])
def test_it_is_readable(page: Any, width: int, scheme: str) -> None:
    """Nothing is wider than the panel, and the panel not wider than the window; the text stands out."""
    page.set_viewport_size({"width": width, "height": 800})
    page.emulate_media(color_scheme=scheme)
    panel = page.locator(".hm-findings")
    box = panel.bounding_box()
    assert box["x"] >= 0
    assert box["x"] + box["width"] <= width
    assert panel.evaluate("(one) => one.scrollWidth <= one.clientWidth")
    ink = panel.locator("li b").first.evaluate("(one) => getComputedStyle(one).color")
    levels = [float(n) for n in ink.removeprefix("rgb(").removesuffix(")").split(",")]
    assert (min(levels) > 180) == (scheme == "dark"), ink


SIZES = [
    ([50.2, 0.61, SQUARE], f"50.2 {SQUARE} (95 %: 49.0 to 51.4)"),
    ([-0.004, 0.3, "V"], f"0.00 V (95 %: {MINUS}0.59 to 0.58)"),
    ([1482.0, 300.0, "kg"], "1482 kg (95 %: 894 to 2070)"),
    ([0.0061, 0.0004, ""], "0.00610 (95 %: 0.00532 to 0.00688)"),
    ([202.4, 0, "L/min"], "202 L/min"),
    ([1, 0, ""], ""),
    ([None, None, "bar"], ""),
    # estimates
    ([203.4, 12.3, "kg", ""], f"203 {SIGN} 12 kg"),
    ([None, 3e4, "kg", ""], "not known"),
]


@pytest.mark.parametrize(("asked", "text"), SIZES)
def test_sizes(page: Any, asked: list[Any], text: str) -> None:
    """Two digits of the interval, or of an estimate's deviation, count; what has no deviation has none, and
    what is there or not no size."""
    assert value(page, "m.size(a, { repair: a[3] ?? 'hose', unit: a[2] })", asked) == text


def test_order(page: Any) -> None:
    """Without a deviation first, of these the older; then by size over deviation. The rest by repair."""
    rows = [[1, 0.5, 1, 9], [1, 0, 1, 8], [-3, 0.5, 1, 7], [1, 0, 1, 6]]
    rows += [[9, 0.1, k, None] for k in (0, -1)]
    assert value(page, "m.faults(a)", rows) == [3, 1, 2, 0]
    named = [{"text": f"t{k}", "repair": f"r{k % 2}"} for k in range(4)]
    states = [[0, 0, state, None] for state in (-1, -1, -1, 0)]
    assert value(page, "m.untold(a[0], a[1])", [named, states]) == [["r0", ["t0", "t2"]], ["r1", ["t1"]]]


# ---- The page of a system without a drawing in a real browser

WINDOWS = [(1280, 800), (360, 800)]
FAILED = """(message) => { const { machine } = document.querySelector('.harvester-machine');
  machine.source.info.message = message;
  machine.source.state = 'failed';
  machine.panels();
  const box = (name) => { const found = document.querySelector(name).getBoundingClientRect();
    return [found.left, found.top, found.right, found.bottom]; };
  return ['.hm-scene', '.hm-chip', '.hm-banner'].map(box); }"""


@pytest.fixture(scope="module")
def undrawn(chromium: Any, fmu_dir: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """Of a drive alone, which has no description of its view."""
    bench = assemble({"swing": fmu_dir / "swing.fmu"}, (), name="bench", stop=1.0, step=1e-3)
    folder = tmp_path_factory.mktemp("bench")
    session = Session(MachineChoice(write_ssp(bench, folder / "bench.ssp")))
    served = Server(session)
    served.start()
    opened = chromium.new_page()
    opened.set_default_timeout(1e3 * LONG)
    opened.goto(served.url)
    opened.wait_for_function("() => document.querySelectorAll('.hm-chart canvas').length > 3")
    yield opened
    opened.close()
    served.stop()
    session.close()


@pytest.mark.parametrize("size", WINDOWS)
def test_a_long_message_is_whole(undrawn: Any, size: tuple[int, int]) -> None:
    """The reason of a failure is inside the page, below the name of the machine."""
    undrawn.set_viewport_size({"width": size[0], "height": size[1]})
    scene, chip, banner = undrawn.evaluate(FAILED, "arm: the step failed at t = 7.2 s with status error " * 4)
    assert chip[3] <= banner[1]
    assert scene[0] <= banner[0]
    assert banner[2] <= scene[2] <= size[0]
    assert banner[3] <= scene[3]


@pytest.mark.parametrize("size", WINDOWS)
def test_numbers_have_room(undrawn: Any, size: tuple[int, int]) -> None:
    """No value runs into its unit, and no bar is beyond its track."""
    undrawn.set_viewport_size({"width": size[0], "height": size[1]})
    beside = """() => {
      const { machine } = document.querySelector('.harvester-machine');
      const values = machine.gauges.lines.map(({ gauge }) => [gauge.name, -1482.04 / gauge.factor]);
      machine.gauges.show(Object.fromEntries(values));
      const box = (one) => one.getBoundingClientRect();
      return machine.gauges.lines.map(({ output, unit, bar }) => {
        const text = document.createRange();
        text.selectNodeContents(output);
        const track = box(bar.parentElement);
        return [box(text).right - box(unit).left, track.right - box(text).left,
          box(bar).left - track.left]; }); }"""
    found = undrawn.evaluate(beside)
    assert len(found) > 4
    assert max(right for right, _, _ in found) <= 0
    assert max(left for _, left, _ in found) <= 0
    assert min(bar for _, _, bar in found) >= 0


def test_keys_of_what_there_is(undrawn: Any) -> None:
    """Neither sticks nor a picture, so no keys for them."""
    undrawn.get_by_role("button", name="Keys").click()
    told = undrawn.locator("dialog[open]").inner_text()
    undrawn.keyboard.press("Escape")
    assert "pause or go on" in told
    assert not [word for word in ("stick", "dead-man", "Wheel", "rotate") if word in told]
