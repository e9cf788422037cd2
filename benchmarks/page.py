"""How fast is the page on which one drives? Frame times in software rendering, time from a key to motion.

    python -m benchmarks.page [--seconds 10] [--only view]

Opens the page of `harvester page` from disk, and that of `harvester view`, in a headless Chromium of
1280 x 800. Drives the swing with the key A, and prints

    first     from opening the page to its first picture of the machine [s]
    frame     time of a frame of the page while the machine moves: median and 95 % [ms]
    drawn     pictures of the machine per second
    key       from a key to a picture in which a lever of the machine has moved, median [ms]
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from benchmarks.live import SYSTEM, browser
from orchestrator.drive.page import write_page
from orchestrator.view.choice import MachineChoice
from orchestrator.view.server import Server
from orchestrator.view.session import Session

PAGE = "document.querySelector('.harvester-machine').machine"
READY = "() => document.querySelector('.hm-stage')?.dataset.drawn > 0"
FRAMES = """async (seconds) => {
  const drawn = () => Number(document.querySelector('.hm-stage').dataset.drawn);
  const [begin, before, times] = [performance.now(), drawn(), []];
  for (let last = begin; performance.now() - begin < 1000 * seconds;) {
    const now = await new Promise(requestAnimationFrame);
    times.push(now - last); last = now;
  }
  return [times, (drawn() - before) / seconds]; }"""
# from the event of the key to the picture of a frame in which the command of the swing is not zero
KEY = f"""() => new Promise((done) => {{ const page = {PAGE}; let begin = null;
  window.addEventListener('keydown', (e) => {{ if (e.code === 'KeyA') begin ??= performance.now(); }}, true);
  const look = () => {{
    const moved = Math.abs(page.source.input('swing_command')) > 0.01;
    if (begin !== null && moved) done(performance.now() - begin); else requestAnimationFrame(look);
  }}; look(); }})"""


def drive(page: Any, shared: bool) -> None:
    """Be ready to drive: in control, the dead-man held."""
    if shared:
        page.get_by_role("button", name="Take controls").click()
        page.wait_for_timeout(300)
        page.keyboard.down("Space")
    else:
        page.get_by_role("button", name="Drive", exact=True).click()
    page.locator(".hm-stage").focus()
    page.wait_for_timeout(300)


def key(page: Any) -> float:
    """Time from a key to a moving lever [ms]; the lever rests before and after."""
    page.evaluate(f"() => {{ window.told = ({KEY})(); }}")
    page.keyboard.down("a")
    took = float(page.evaluate("() => window.told"))
    page.keyboard.up("a")
    page.wait_for_function(f"() => Math.abs({PAGE}.source.input('swing_command')) < 1e-6")
    return took


def measure(name: str, url: str, seconds: float) -> None:
    """Print the line of one page."""
    with browser("about:blank", wait="") as page:
        begin = time.monotonic()
        page.goto(url)
        page.wait_for_function(READY)
        first = time.monotonic() - begin
        drive(page, name == "view")
        keys = [key(page) for _ in range(5)]
        page.keyboard.down("a")
        times, drawn = page.evaluate(FRAMES, seconds)
        page.keyboard.up("a")
    high = statistics.quantiles(times, n=20)[-1]
    print(
        f"{name:<6}{first:>8.2f}{statistics.median(times):>9.1f}{high:>9.1f}{drawn:>8.1f}{statistics.median(keys):>9.0f}"
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--only", choices=("file", "view"))
    given = parser.parse_args()
    print(f"{'':<6}{'first':>8}{'frame':>9}{'95 %':>9}{'drawn':>8}{'key':>9}")
    print(f"{'':<6}{'s':>8}{'ms':>9}{'ms':>9}{'1/s':>8}{'ms':>9}")
    with ExitStack() as stack:
        pages: dict[str, Callable[[], str]] = {"file": lambda: _file(stack), "view": lambda: _view(stack)}
        for name, address in pages.items():
            if given.only in (None, name):
                measure(name, address(), given.seconds)


def _file(stack: ExitStack) -> str:
    folder = stack.enter_context(tempfile.TemporaryDirectory())
    return write_page(Path(folder) / "page.html", SYSTEM, "Drive").as_uri()


def _view(stack: ExitStack) -> str:
    session = Session(MachineChoice(SYSTEM))
    stack.callback(session.close)
    server = Server(session)
    server.start()
    stack.callback(server.stop)
    return server.url


if __name__ == "__main__":
    main()
