"""How well does a live machine hold real time? Also by `make bench-live`.

    python -m benchmarks.live [--seconds 60] [--browser] [--url URL] [--ordinary] [--only lumped]

Runs the lumped and the detailed machine of the build folder under random commands, and counts frames that
could be read later than one frame (10 ms) after they were due. `--browser` shows each in the page of
`harvester view`, in a headless Chromium; `--url` opens a page that is served elsewhere instead; `--ordinary`
asks for no priority, as where a user may not have one. The bar is under 0.5 % on two otherwise idle cores;
exit status 1 if a machine misses it.
"""

from __future__ import annotations

import argparse
import os
import shutil
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from fmus.machine.parts import MACHINES
from orchestrator.base.errors import Problem
from orchestrator.realtime.deadlines import PRIORITY_VARIABLE
from orchestrator.realtime.setup import Machine

SYSTEM = Path("build/harvester.ssp")
BAR = 0.005  # share of deadlines
EVERY = 1 / 30  # s between commands, as from a page
FLAGS = (  # drawing by the processor, and no word to any other host
    *("--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"),
    *("--disable-quic", "--disable-background-networking", "--disable-component-update", "--disable-sync"),
)
PICTURES = """async () => {
    let n = 0; const begin = performance.now();
    while (performance.now() - begin < 2000) { await new Promise(requestAnimationFrame); n++; }
    return 1000 * n / (performance.now() - begin);
}"""


class Watched:
    """The machine behind the server of the view, and how to start another one."""

    def __init__(self, server: bool) -> None:
        from orchestrator.view.choice import MachineChoice
        from orchestrator.view.session import Session

        self._choice = MachineChoice
        self.session = Session(MachineChoice(SYSTEM))
        self.machine = self.session.machine
        self.url, self._server = "", None
        if server:
            from orchestrator.view.server import Server

            self._server = Server(self.session)
            self._server.start()
            self.url = self._server.url

    def start(self, swap: Mapping[str, str]) -> None:
        """From the beginning with these parts; waits until it runs."""
        self.session.start(self._choice(SYSTEM, swap=swap))
        while (frame := self.machine.latest()).state != "running" or frame.timing.frames < 1:
            if frame.state == "failed":
                raise Problem(frame.message)
            time.sleep(0.01)

    def close(self) -> None:
        """End server and machine."""
        if self._server:
            self._server.stop()
        self.session.close()


@contextmanager
def browser(url: str, wait: str = "canvas") -> Iterator[Any]:
    """A headless Chromium that shows a page; nothing without an address. wait: for this element."""
    if not url:
        yield None
        return
    from playwright.sync_api import sync_playwright

    path = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if path is None:
        raise Problem(
            "expected Chromium for --browser, found none; install it, for example apt install chromium"
        )
    with sync_playwright() as play:
        chromium = play.chromium.launch(executable_path=path, args=list(FLAGS))
        page = chromium.new_page(viewport={"width": 1280, "height": 800})
        page.goto(url)
        if wait:
            page.wait_for_selector(wait)
        yield page
        chromium.close()


def drive(machine: Machine, seconds: float) -> None:
    """Random commands for so long."""
    rng, end = np.random.default_rng(1), time.monotonic() + seconds
    wanted, names = np.zeros(3), [n for n in machine.axes if n.endswith("_command")]
    while time.monotonic() < end:
        wanted = np.clip(wanted + rng.normal(0, 1, 3), -10, 10)
        machine.command(dict(zip(names, wanted.tolist(), strict=False)))
        time.sleep(EVERY)


def measure(name: str, watched: Watched, seconds: float, page: Any) -> float:
    """One machine: prints its line; the share of missed deadlines."""
    watched.start(MACHINES[name])
    drive(watched.machine, seconds)
    timing = watched.machine.latest().timing
    share = timing.missed / timing.frames
    middle, most, worst = (1e3 * x for x in timing.latency)
    drawn = f"{page.evaluate(PICTURES):>9.0f}" if page else f"{'-':>9}"
    print(
        f"{name:<10}{timing.frames:>8}{timing.missed:>8}{100 * share:>9.3f} %{middle:>9.2f}{most:>9.2f}"
        f"{worst:>9.2f}{100 * timing.load:>8.1f} %{drawn}{os.getloadavg()[0]:>8.1f}",
        flush=True,
    )
    return share


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--seconds", type=float, default=60.0, help="of each machine")
    parser.add_argument(
        "--browser", action="store_true", help="a headless Chromium shows the page of the view"
    )
    parser.add_argument("--url", default="", help="a headless Chromium shows this page")
    parser.add_argument("--only", choices=[*MACHINES], help="one machine")
    parser.add_argument("--ordinary", action="store_true", help="without priority over other processes")
    given = parser.parse_args()
    if given.ordinary:
        os.environ[PRIORITY_VARIABLE] = "ordinary"
    watched = Watched(given.browser)
    try:
        notes = getattr(watched.session.machine.machine, "notes", ("",))
        print(f"{os.cpu_count()} cores; {notes[-1]}")
        print(f"{'':<10}{'frames':>8}{'missed':>8}{'':>11}{'median':>9}{'99 %':>9}{'worst':>9}", end="")
        print(
            f"{'load':>10}{'pictures':>9}{'busy':>8}\n{'':<37}{'ms':>9}{'ms':>9}{'ms':>9}{'':>10}{'1/s':>9}"
        )
        with browser(given.url or watched.url) as page:
            names = [given.only] if given.only else [*MACHINES]
            shares = [measure(name, watched, given.seconds, page) for name in names]
    except Problem as problem:
        sys.exit(f"bench-live: {problem}")
    finally:
        watched.close()
    print("busy: processes that wanted a core, mean over the last minute")
    sys.exit(1 if max(shares) >= BAR else 0)


if __name__ == "__main__":
    main()
