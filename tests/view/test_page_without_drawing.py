"""The page of a system without a drawing in a real browser."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from kit import shards
from kit.wait import LONG

from orchestrator.ssp.load import assemble
from orchestrator.ssp.write import write_ssp
from orchestrator.view.choice import MachineChoice
from orchestrator.view.server import Server
from orchestrator.view.session import Session

pytestmark = shards.browser
SIZES = [(1280, 800), (360, 800)]
FAILED = """(message) => { const { machine } = document.querySelector('.harvester-machine');
  machine.source.info.message = message;
  machine.source.state = 'failed';
  machine.panels();
  const box = (name) => { const found = document.querySelector(name).getBoundingClientRect();
    return [found.left, found.top, found.right, found.bottom]; };
  return ['.hm-scene', '.hm-chip', '.hm-banner'].map(box); }"""


@pytest.fixture(scope="module")
def page(chromium: Any, fmu_dir: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
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


@pytest.mark.parametrize("size", SIZES)
def test_a_long_message_is_whole(page: Any, size: tuple[int, int]) -> None:
    """The reason of a failure is inside the page, below the name of the machine."""
    page.set_viewport_size({"width": size[0], "height": size[1]})
    scene, chip, banner = page.evaluate(FAILED, "arm: the step failed at t = 7.2 s with status error " * 4)
    assert chip[3] <= banner[1]
    assert scene[0] <= banner[0]
    assert banner[2] <= scene[2] <= size[0]
    assert banner[3] <= scene[3]


@pytest.mark.parametrize("size", SIZES)
def test_numbers_have_room(page: Any, size: tuple[int, int]) -> None:
    """No value runs into its unit, and no bar is beyond its track."""
    page.set_viewport_size({"width": size[0], "height": size[1]})
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
    found = page.evaluate(beside)
    assert len(found) > 4
    assert max(right for right, _, _ in found) <= 0
    assert max(left for _, left, _ in found) <= 0
    assert min(bar for _, _, bar in found) >= 0


def test_keys_of_what_there_is(page: Any) -> None:
    """Neither sticks nor a picture, so no keys for them."""
    page.get_by_role("button", name="Keys").click()
    told = page.locator("dialog[open]").inner_text()
    page.keyboard.press("Escape")
    assert "pause or go on" in told
    assert not [word for word in ("stick", "dead-man", "Wheel", "rotate") if word in told]
