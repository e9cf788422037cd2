"""The machine on a page: from disk it moves as `harvester run` moves it, and asks nobody for anything."""

import base64
import functools
import hashlib
import re
import zipfile
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from axe_playwright_python.sync_playwright import Axe
from kit import shards
from kit.driven_page import PAD, SECTION, Opened, assert_same_motion, hold
from kit.mistakes import problem

from fmus.machine.build import data
from orchestrator.data.recording import read_recording
from orchestrator.data.trace import Trace
from orchestrator.drive import page as drive_page
from orchestrator.drive.page import Replayed, find_fmu, fragment, write_page
from orchestrator.engine.options import RunOptions
from orchestrator.results.validate_system import Experiment, validate_system

SCHEMES = ("light", "dark")


@pytest.fixture(scope="module")
def file(fmu_dir: Path, tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """Writes pages once: the machine alone, next to a run in a report, or replaying the work cycle next to a
    run that lags by 1 s."""
    folder = tmp_path_factory.mktemp("pages")

    def report() -> Path:
        default = data("reference/work_cycle.csv"), data("reference/work_cycle.layout.toml")
        experiment = Experiment(fmu_dir / "harvester.ssp", default, options=RunOptions(stop=1.0))
        validate_system(experiment, folder)
        return folder / "report.html"

    def replay() -> Path:
        cycle = read_recording(data("reference/work_cycle.csv")).without_gaps()
        late = {name: np.interp(cycle.time - 1, cycle.time, v) for name, v in cycle.signals.items()}
        section = fragment(fmu_dir / "harvester.ssp", Replayed(Trace(cycle.time, late), cycle))
        head = '<!doctype html><html lang="en" style="color-scheme: light dark"><title>replay</title>'
        page = folder / "replay.html"
        page.write_text(f"{head}<main><h1>Replay</h1>{section}</main>", encoding="utf-8")
        return page

    def drive() -> Path:
        return write_page(folder / "drive.html", fmu_dir / "harvester.ssp", "Drive")

    return functools.cache(lambda name: {"report": report, "replay": replay, "drive": drive}[name]())


@pytest.fixture
def opened(chromium: Any, file: Callable[[str], Path]) -> Iterator[Any]:
    """Opens pages: name and settings of the browser -> `Opened`."""
    pages: list[Opened] = []

    def make(name: str, **settings: Any) -> Opened:
        pages.append(Opened(chromium, file(name), **settings))
        return pages[-1]

    yield make
    for page in pages:
        page.context.close()


# of all browser tests, this one is in `make test`
@pytest.mark.parametrize("name", ["drive", pytest.param("report", marks=shards.browser)])
def test_same_motion_as_run(opened: Any, name: str, fmi3_dir: Path, tmp_path: Path) -> None:
    """Driven by hand for 6 s, the machine is where `harvester run` has it with the saved commands."""
    assert_same_motion(opened(name), fmi3_dir / "harvester.fmu", tmp_path)


@shards.browser
@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("name", ["drive", "replay"])
def test_accessible(opened: Any, name: str, scheme: str) -> None:
    """axe-core finds no violation, while it moves and while it is paused, in light and dark."""
    axe = Axe()
    page = opened(name, color_scheme=scheme)
    page.page.evaluate(f"() => {SECTION}.run(false)")
    for moving in (False, True):
        page.page.evaluate(f"(on) => {SECTION}.run(on)", moving)
        found = axe.run(page.page).response["violations"]
        assert [(v["id"], [n["target"] for n in v["nodes"]]) for v in found] == []


@shards.browser
def test_keyboard_alone(opened: Any) -> None:
    """Tab reaches the machine, keys drive it, Escape leaves it; Tab reaches every control."""
    page = opened("drive", reduced_motion="reduce")
    page.page.keyboard.press("Tab")
    assert page.page.evaluate("() => document.activeElement.className") == "skip"
    page.page.keyboard.press("Tab")
    assert "hm-stage" in page.page.evaluate("() => document.activeElement.className")
    page.page.keyboard.down("d")
    page.until("s.sources.drive.simulation.now[0] < -1")
    page.page.keyboard.up("d")
    page.page.keyboard.press("Escape")
    assert page.page.evaluate("() => document.activeElement.tagName") == "BODY"
    reached = set()
    for _ in range(32):
        page.page.keyboard.press("Tab")
        reached.add(page.page.evaluate("() => document.activeElement.textContent.trim().split('\\n')[0]"))
    wanted = {"Demonstration", "Drive", "Start again", "Save the drive", "Training task"}
    assert reached >= wanted | {"SAE", "Keys", "top"}


@shards.browser
def test_keys_after_a_click(opened: Any) -> None:
    """After a click with the mouse the keys belong to the sticks; after Enter they stay at the button."""
    page = opened("drive")
    at_sticks = "document.activeElement.classList.contains('hm-stage')"
    for name in ("Pause", "Go on", "SAE", "tip"):
        page.page.get_by_role("button", name=name, exact=True).click()
        assert page.page.evaluate(at_sticks), name
    page.page.keyboard.down("d")
    page.until("s.sources.drive.simulation.now[0] < -1")
    page.page.keyboard.up("d")
    for name in ("ISO", "Pause"):
        page.page.get_by_role("button", name=name, exact=True).press("Enter")
        assert not page.page.evaluate(at_sticks), name
    pose = page.page.locator(".hm-pose")
    pose.select_option("reach")
    assert not page.page.evaluate(at_sticks), "by keyboard"
    pose.dispatch_event("pointerdown")
    pose.select_option("raised")
    assert page.page.evaluate(at_sticks)


@shards.browser
def test_gamepad(opened: Any) -> None:
    """A gamepad of another mapping is named; the dead-man of a usual one starts a page that waits."""
    page = opened("drive", reduced_motion="reduce")
    page.page.evaluate(PAD)
    page.page.evaluate("pad.mapping = ''")
    page.page.get_by_text("stub: no standard mapping, not used").wait_for()
    page.page.evaluate("pad.mapping = 'standard'")
    page.page.get_by_text("stub", exact=True).wait_for()
    assert not page.ask("running")
    page.page.evaluate("pad.buttons[5].pressed = true")
    page.until("s.running")
    page.page.evaluate("pad.axes[0] = 1")
    page.until("s.sources.drive.simulation.now[0] < -1")
    page.page.get_by_role("button", name="Pause").click()
    page.page.wait_for_timeout(300)
    assert not page.ask("running"), "the dead-man was not released"


@shards.browser
def test_waits(opened: Any) -> None:
    """It starts by itself, but not where less motion is preferred, and pauses while the tab is hidden."""
    still = opened("drive", reduced_motion="reduce")
    still.page.wait_for_timeout(500)
    assert not still.ask("running")
    assert still.ask("sources.drive.simulation.frames") == 0
    page = opened("drive")
    page.until("s.running && s.sources.drive.simulation.frames > 3")
    hide = "(v) => { Object.defineProperty(document, 'visibilityState', { value: v, configurable: true });"
    hide += " document.dispatchEvent(new Event('visibilitychange')); }"
    page.page.evaluate(hide, "hidden")
    assert not page.ask("running")
    page.page.evaluate(hide, "visible")
    page.until("s.running")


@shards.browser
def test_parameters_and_poses(opened: Any) -> None:
    """A pose, a heavier head and a lower pressure act: the machine starts there, and the pressures follow."""
    page = opened("drive")
    page.page.locator(".hm-pose").select_option("raised")
    halt(page, 2)
    assert page.ask("source.values.boom_angle") == pytest.approx(0.95, abs=0.01)  # of fmus.machine.poses
    light = page.ask("source.values.boom_head_pressure")
    page.page.locator(".hm-speed").select_option("5")
    page.page.get_by_label("Head mass").fill("800")
    page.page.get_by_label("Supply pressure").fill("100")
    page.page.get_by_role("button", name="Continue").click()
    halt(page, 12)
    assert page.ask("source.values.supply_pressure") == pytest.approx(10e6)
    # 450 kg more at 3 m: 13 kN.m over a lever of some 0.4 m and 113 cm2 are some 30 bar after oscillating
    assert page.ask("source.values.boom_head_pressure") > light + 1e6
    page.page.get_by_role("button", name="Save the drive").click()
    said = page.page.locator(".hm-said").inner_text()
    assert said == "head_mass was changed during the drive, and a scenario has no parameters: start again"


@shards.browser
def test_payload(opened: Any) -> None:
    """Whoever takes over the demonstration has its payload, and no score of it. The task holds its load until
    it is hidden, and leaves the slider free."""
    page = opened("drive")
    payload = "s.sources.drive.input('payload_mass')"
    page.page.locator(".hm-speed").select_option("5")
    page.page.get_by_role("button", name="Training task").click()
    page.page.get_by_role("button", name="Demonstration").click()
    page.until(f"{payload} === 200 && s.mode === 'program' && s.source.time > 4")
    assert page.ask("sources.drive.task.started") is None
    page.page.locator(".hm-stage").focus()
    hold(page, "ArrowDown", 0.5)
    page.until(f"s.mode === 'drive' && {payload} === 200")
    page.page.get_by_label("Payload").fill("300")
    page.until(f"s.source.time > {page.ask('source.time') + 0.5} && {payload} === 300")
    page.page.evaluate(f"() => {{ {SECTION}.sources.drive.task.done = [1]; }}")
    page.until(f"{payload} === 200")
    page.page.get_by_role("button", name="Training task").click()
    page.until(f"{payload} === 0")


def halt(page: Opened, time: float) -> None:
    """Pause a driven machine after this simulated time [s]."""
    page.until(f"s.mode === 'drive' && s.source.time > {time}")
    page.page.evaluate(f"() => {SECTION}.run(false)")


@shards.browser
def test_follows_the_switch_of_a_site(opened: Any) -> None:
    """A page that is switched to dark changes colours and ground, whatever the browser prefers."""
    page = opened("drive", color_scheme="light", reduced_motion="reduce")
    assert page.ask("scene.scheme") == "light"
    page.page.evaluate("() => { document.body.dataset.theme = 'dark'; }")
    page.until("s.scene.scheme === 'dark'")


@shards.browser
def test_fits_a_phone(opened: Any) -> None:
    """As narrow as in a report on a phone, nothing of the section is cut off at its side."""
    page = opened("report", reduced_motion="reduce")
    page.page.set_viewport_size({"width": 360, "height": 740})
    page.page.wait_for_function("document.querySelector('.hm-scene').clientWidth < 360")
    beyond = page.page.evaluate("""() => { const root = document.querySelector('.harvester-machine');
      const beyond = (one) => one.getBoundingClientRect().right - root.getBoundingClientRect().right;
      const text = (one) => `${one.tagName} ${one.getAttribute('class')} ${beyond(one)}`;
      const all = [...root.querySelectorAll('.hm-hands *, .hm-panel *, .hm-bar *')];
      return all.filter((one) => one.checkVisibility() && beyond(one) > 1).map(text); }""")
    assert beyond == []


@shards.browser
def test_replay_then_drive(opened: Any) -> None:
    """The run is replayed next to the reference; a key takes over from where the machine is."""
    page = opened("replay")
    assert page.ask("mode") == "replay"
    last = page.ask("source.last")
    page.page.locator(".hm-seek").fill(f"{10 / last:.3f}")
    now = page.ask("source.time")
    assert now == pytest.approx(10.0, abs=1e-3 * last)
    cycle = read_recording(data("reference/work_cycle.csv")).without_gaps().at([now - 1, now])
    # pictures between samples of 20 ms, five digits
    assert page.ask("source.values.boom_angle") == pytest.approx(cycle["manipulator.boom_angle"][0], abs=1e-3)
    ghost = page.ask("source.reference.boom_angle")
    assert ghost == pytest.approx(cycle["manipulator.boom_angle"][1], abs=1e-3)
    assert page.ask("scene.ghost.root.visible")
    before = page.ask("source.values.swing_angle")
    page.page.locator(".hm-stage").focus()
    page.page.keyboard.down("a")
    page.until("s.mode === 'drive' && s.sources.drive.simulation.frames > 100")
    assert not page.ask("scene.ghost.root.visible")
    assert 0.05 < page.ask("source.values.swing_angle") - before < 1.5
    assert page.complaints == []


@shards.browser
def test_a_failure_is_said(opened: Any) -> None:
    """A call that the FMU refuses stops the machine with the FMU's own words."""
    page = opened("drive")
    for first, then in (
        ("sources.drive.simulation.axes[0].limit = null", "choose('drive')"),
        ("source.commanded = () => ({ swing_command: NaN })", "run(true)"),
    ):
        page.page.evaluate(f"() => {{ {SECTION}.{first}; {SECTION}.{then}; }}")
    page.page.wait_for_selector(".hm-said:not(:empty)")
    assert re.search("swing_command cannot be set to -?nan", page.page.locator(".hm-said").inner_text())


@shards.browser
def test_replay_after_a_failure(opened: Any) -> None:
    """After a failure of the FMU the run is still replayed."""
    page = opened("replay")
    page.page.get_by_role("button", name="Drive", exact=True).click()
    page.page.evaluate(f"() => {SECTION}.fail(new Error('it broke'))")
    page.page.get_by_role("button", name="Replay the run").click()
    begun = page.ask("source.time")
    page.until(f"s.mode === 'replay' && s.running && s.source.time > {begun}")
    assert page.page.locator(".hm-said").inner_text() == ""


@shards.browser
def test_driven_without_webgl(opened: Any) -> None:
    """In a browser without WebGL one line says so; gauges and charts work; a click where the picture would be
    takes the keys."""
    page = opened("drive", webgl=False)
    page.page.get_by_text("no picture: this browser offers no WebGL").wait_for()
    page.page.wait_for_function("parseFloat(document.querySelector('.hm-gauge output').textContent) > 15")
    assert page.page.locator(".hm-chart").count() > 2
    page.page.locator(".hm-stage").click(position={"x": 400, "y": 20})
    page.page.keyboard.down("d")
    page.until("s.mode === 'drive' && s.sources.drive.simulation.now[0] < -1")
    assert page.complaints == []


def part(page: str, name: str) -> str:
    """A part of a section, unpacked."""
    packed = re.search(f'data-part="{name}">([^<]*)<', page)
    assert packed
    return zlib.decompress(base64.b64decode(packed[1])).decode()


def test_which_fmu(fmu_dir: Path, fmi3_dir: Path, tmp_path: Path) -> None:
    """That of FMI 3.0 next to the SSP or FMU; a system without one is refused with what is missing."""
    for system in (fmu_dir / "harvester.ssp", fmu_dir / "harvester.fmu", fmi3_dir / "harvester.fmu"):
        assert find_fmu(system) == fmi3_dir / "harvester.fmu"
    lonely = tmp_path / "harvester.ssp"
    lonely.write_bytes((fmu_dir / "harvester.ssp").read_bytes())
    assert find_fmu(lonely) is None
    assert fragment(lonely) == ""
    told = r"expected harvester\.fmu of FMI 3\.0 with a WebAssembly module"
    problem(lambda: write_page(tmp_path / "machine.html", lonely, ""), told)
    cycle = read_recording(data("reference/work_cycle.csv")).without_gaps()
    alone = fragment(lonely, Replayed(cycle))
    assert 'data-part="module"' not in alone, "without the module it only replays"
    assert '"replay":' in part(alone, "data")
    assert fragment(lonely, Replayed(cycle.select(["swing.swing_command"]))) == ""


def test_module_needs_nothing(fmi3_dir: Path) -> None:
    """The module has no section of imports (WebAssembly 1.0, section 5.5.5): nothing to provide."""
    with zipfile.ZipFile(fmi3_dir / "harvester.fmu") as archive:
        module = archive.read("binaries/wasm32-wasip1/harvester.wasm")
    assert module[:8] == b"\0asm\1\0\0\0"
    at, sections = 8, []
    while at < len(module):
        sections.append(module[at])
        size, shift, at = 0, 0, at + 1
        while True:  # LEB128
            byte, at = module[at], at + 1
            size |= (byte & 0x7F) << shift
            shift += 7
            if byte < 0x80:
                break
        at += size
    assert 2 not in sections


def test_library_is_as_built() -> None:
    """three.js is what its folder makes of the pinned version: the hash in entry.js is its own."""
    folder = Path(drive_page.__file__).with_name("three")
    digest = hashlib.sha256((folder / "three.min.js").read_bytes()).hexdigest()
    assert digest in (folder / "entry.js").read_text(encoding="utf-8")
    assert '"three": "0.180.0"' in (folder / "package.json").read_text(encoding="utf-8")
