"""The page in a real browser: it loads, shows the machine, is driven, and lets go when it is closed."""

import io
import shlex
import subprocess
import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import pytest
from kit import shards
from kit.mistakes import entry
from kit.wait import LONG, until
from matplotlib import image
from numpy.typing import NDArray

from orchestrator.data.trace import Trace, read_trace
from orchestrator.data.trace_writer import write_trace
from orchestrator.realtime.machine import APART
from orchestrator.view import server as serving
from orchestrator.view.authority import ControlAuthority
from orchestrator.view.choice import MachineChoice
from orchestrator.view.server import Server
from orchestrator.view.session import Session

pytestmark = shards.browser

DRAWN = "(number) => document.querySelector('.hm-stage')?.dataset.drawn > number"
FOOT = "document.querySelector('.hm-foot').innerText"
MOVED = 0.1  # rad; far more than creep of a machine that nobody drives


@pytest.fixture(scope="session")
def server(fmu_dir: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """The page of the real machine, in this process, so that a test can look at what moves."""
    results = tmp_path_factory.mktemp("results")
    times = np.linspace(0, 4, 401)
    angles = {"manipulator.boom_angle": 0.2 + 0.1 * times, "manipulator.stick_angle": -1.4 + 0 * times}
    write_trace(Trace(times, angles), results / "rising.csv")
    session = Session(MachineChoice(fmu_dir / "harvester.ssp"), [results])
    with pytest.MonkeyPatch.context() as patient:
        # a browser may halt for some seconds where much else is done: that is no driver who went away
        patient.setattr(serving, "ControlAuthority", partial(ControlAuthority, silence_limit=LONG))
        served = Server(session)
    served.start()
    yield served
    served.stop()
    session.close()


def page_of(chromium: Any, server: Server) -> Any:
    """An open page that has drawn the machine; what it complains of and asks for is kept."""
    context = chromium.new_context(viewport={"width": 1200, "height": 800}, accept_downloads=True)
    opened = context.new_page()
    opened.complaints, opened.hosts = [], set()
    opened.on("console", lambda m: opened.complaints.append(m.text) if m.type == "error" else None)
    opened.on("pageerror", lambda error: opened.complaints.append(str(error)))
    context.on("request", lambda request: opened.hosts.add(urlsplit(request.url).netloc))
    opened.set_default_timeout(1e3 * LONG)
    opened.goto(server.url)
    opened.wait_for_function(DRAWN, arg=1)
    return opened


@pytest.fixture(scope="session")
def only(chromium: Any, server: Server) -> Iterator[Any]:
    """The page of the tests that do not disturb each other."""
    opened = page_of(chromium, server)
    yield opened
    opened.context.close()


@pytest.fixture
def page(only: Any, server: Server) -> Iterator[Any]:
    """It shows the running machine, without a window, and does not drive."""
    yield only
    close_windows(only)
    only.mouse.move(0, 0)
    if server.authority.status().driver:
        only.get_by_role("button", name="Release controls").click()
    assert until(lambda: server.authority.status().driver == "")


def close_windows(page: Any) -> None:
    """By Escape, which closes an open list first."""

    def closed() -> bool:
        page.keyboard.press("Escape")
        return until(lambda: page.locator("dialog[open]").count() == 0, 1.0)

    assert until(closed)


@pytest.fixture
def own(chromium: Any, server: Server) -> Iterator[Any]:
    """A page of the test's own, which it may close."""
    opened = page_of(chromium, server)
    yield opened
    opened.context.close()
    assert until(lambda: server.authority.status().driver == "")


def picture(page: Any) -> NDArray[np.float64]:
    """What is on the screen where the machine is, shape (rows, columns, 3), 0 to 1."""
    found = image.imread(io.BytesIO(page.locator(".hm-stage canvas").screenshot()))
    return np.asarray(found[..., :3], dtype=np.float64)


def value(session: Session, name: str) -> float:
    """Of a signal of the machine now."""
    return float(session.machine.latest().values[session.columns[name] - len(session.machine.axes)])


def comes_to(server: Server, state: str) -> bool:
    """Does the machine come to this state?"""
    return until(lambda: server.session.machine.latest().state == state)


def driven(server: Server) -> bool:
    """Is any lever away from rest?"""
    machine = server.session.machine
    now = zip(machine.axes, machine.latest().axes, strict=True)
    return any(value for name, value in now if name.endswith("_command"))


def begin(server: Server) -> float:
    """Number of the frame at time zero: another one after a restart, of which the time alone is no sign."""
    frame = server.session.machine.latest()
    return frame.number - frame.t / 0.01  # s of a frame


def take(page: Any, server: Server) -> None:
    """The controls, by the button."""
    page.get_by_role("button", name="Take controls").click()
    assert until(lambda: server.authority.status().driver != "")


def drive(page: Any, server: Server) -> None:
    """Hold dead-man and a key until the machine has swung. A browser that was slow for a moment has lost its
    dead-man, as it should: then it is let go and held again, as a driver would."""
    first = value(server.session, "swing_angle")

    def done() -> bool:
        return abs(value(server.session, "swing_angle") - first) > MOVED

    def held() -> bool:
        if not server.authority.status().driver:
            take(page, server)
        page.keyboard.down("Shift")
        page.keyboard.down("a")
        if until(done, 2.0) or (until(lambda: done() or not driven(server)) and done()):
            return True
        page.keyboard.up("a")
        page.keyboard.up("Shift")
        page.wait_for_timeout(200)
        return False

    assert until(held), f"the machine did not move: {server.authority.status()}"


def test_loads(page: Any, server: Server) -> None:
    """No error in the console, nothing asked of other hosts; numbers, state, and rough edges on the page."""
    page.wait_for_function(f"() => {FOOT}.includes('running')")
    page.wait_for_function("() => document.querySelectorAll('.hm-gauge').length > 8")
    page.wait_for_function("() => parseFloat(document.querySelector('.hm-gauge output').textContent) > 15")
    assert page.complaints == []
    assert page.hosts == {f"127.0.0.1:{server.port}"}
    # this browser has no graphics card, so the canvas is opened without smoothing
    context = "document.querySelector('.hm-stage canvas').getContext('webgl2')"
    assert page.evaluate(f"{context}.getContextAttributes().antialias") is False


def test_machine_is_seen_and_moves(own: Any, server: Server) -> None:
    """The picture is not blank; a key moves the joint and the picture; closing the page stops the motion."""
    before = picture(own)
    assert before.std() > 0.05, "a blank picture has no contrast"
    drive(own, server)
    # the arm covers some per cent of the picture, and has turned by its own width; pictures come with delay
    assert until(lambda: bool((np.abs(picture(own) - before).max(axis=2) > 0.1).mean() > 0.005))
    own.close()
    assert until(lambda: not driven(server))
    assert until(lambda: abs(value(server.session, "swing_speed")) < 0.01)


def test_pause_and_restart(page: Any, server: Server) -> None:
    """Pause stops the time, play goes on, restart begins at zero."""
    before = begin(server)
    page.get_by_role("button", name="Pause").click()
    assert comes_to(server, "paused")
    page.wait_for_function(f"() => {FOOT}.includes('paused')")
    page.get_by_role("button", name="Go on").click()
    assert until(lambda: server.session.machine.latest().t > 1.0)
    page.get_by_role("button", name="Start again").click()
    assert until(lambda: begin(server) > before + APART / 2)
    assert comes_to(server, "running")
    assert server.session.machine.trace().time[0] == 0.0


def test_keys_of_the_page(page: Any, server: Server) -> None:
    """P pauses and goes on, the page says what to press, and a driver keeps the controls; in a window over
    the page keys do nothing; a restart takes the controls away."""
    for drives in (False, True):
        page.keyboard.press("p")
        assert comes_to(server, "paused")
        page.get_by_text("paused: press P to continue").wait_for()
        page.keyboard.press("p")
        assert comes_to(server, "running")
        if not drives:
            take(page, server)
    assert server.authority.status().driver
    page.get_by_role("button", name="Replay").click()
    page.get_by_role("combobox", name="File").press("p")
    assert server.session.machine.latest().state == "running"
    close_windows(page)
    page.keyboard.press("Home")
    assert until(lambda: not server.authority.status().driver)


CAMERA = """() => {
  const { camera, controls } = document.querySelector('.harvester-machine').machine.scene.stage;
  return [...controls.target, camera.position.distanceTo(controls.target)]; }"""


def test_view_with_the_tip(page: Any, server: Server) -> None:
    """The view looks at the tip, from the same distance, before and after the tip has moved."""
    page.get_by_role("button", name="tip", exact=True).first.click()

    def looked_at() -> bool:
        *target, away = page.evaluate(CAMERA)
        tip = [value(server.session, f"tip_{name}") for name in ("x", "y", "height")]
        # 5 cm: the tip creeps while the picture is under way; 7 m is the distance of the view
        return bool(np.allclose(target, tip, atol=0.05) and abs(away - 7) < 0.01)

    assert until(looked_at)
    take(page, server)
    drive(page, server)
    page.keyboard.up("a")
    page.keyboard.up("Shift")
    assert until(looked_at)


def test_connection_comes_back(own: Any, server: Server) -> None:
    """After an interruption the page goes on as before: the view follows the tip, the task counts, and nobody
    drives."""
    own.get_by_role("button", name="tip", exact=True).first.click()
    own.get_by_role("button", name="Training task").click()
    own.get_by_text("pick: ").wait_for()
    take(own, server)
    own.get_by_role("button", name="Release controls").wait_for()
    before = own.evaluate(CAMERA)
    for one in [*server._server.server_state.connections]:
        one.loop.call_soon_threadsafe(one.transport.abort)
    own.get_by_text("no connection: trying again").first.wait_for()
    assert until(lambda: server.authority.status().driver == "")
    own.get_by_text("the connection was lost: take the controls again").wait_for()
    assert np.allclose(own.evaluate(CAMERA), before, atol=0.05)  # m; the tip creeps
    drive(own, server)
    own.get_by_text("moving, ").wait_for()
    assert np.linalg.norm(np.subtract(own.evaluate(CAMERA), before)) > MOVED
    own.get_by_role("button", name="Training task").click()


def test_a_view_keeps_the_focus(page: Any, server: Server) -> None:
    """After a restart the next key is still that of the button of the view."""
    button = page.locator(".hm-looks button").first
    button.focus()
    before = begin(server)
    page.keyboard.press("Home")
    assert until(lambda: begin(server) > before + APART / 2)
    page.wait_for_function("() => document.querySelector('.harvester-machine').machine.source.time < 1")
    assert page.evaluate("document.activeElement.closest('.hm-looks') !== null")


def test_words_move_nothing(page: Any) -> None:
    """The longest word of the page to its driver leaves the picture where it is, at its size."""
    before = page.locator(".hm-stage").bounding_box()
    page.evaluate("""() => new Promise((resolve) => {
      const machine = document.querySelector('.harvester-machine').machine;
      machine.describe = () => 'too slow: release Space, then hold it again';
      setTimeout(resolve, 100); })""")
    page.get_by_text("too slow").wait_for()
    assert page.locator(".hm-stage").bounding_box() == before
    page.evaluate("() => delete document.querySelector('.harvester-machine').machine.describe")


def test_payload(page: Any, server: Server) -> None:
    """It is what the slider says, also none again; it stays in the head after its driver has gone."""
    session = server.session
    payload = [name.endswith("payload_mass") for name in session.machine.axes].index(True)

    def comes(mass: float) -> bool:
        return until(lambda: session.machine.latest().axes[payload] == mass)

    def put(mass: str) -> None:
        page.get_by_role("slider", name="Payload").fill(mass)
        assert comes(float(mass))

    take(page, server)
    put("250")
    put("0")
    put("100")
    page.get_by_role("button", name="Release controls").click()
    assert until(lambda: server.authority.status().driver == "")
    drive(page, server)
    assert session.machine.latest().axes[payload] == 100.0
    put("0")


OUTSIDE = """() => {
  const side = document.querySelector('.hm-side').getBoundingClientRect();
  return [...document.querySelectorAll('.hm-gauge, .hm-chart, .hm-plot canvas')]
    .filter((one) => one.getBoundingClientRect().bottom > side.bottom).length; }"""


@pytest.mark.parametrize(("size", "picture"), [((1280, 800), 500), ((1440, 900), 590), ((1366, 650), 347)])
def test_gauges_and_charts_are_in_sight(page: Any, size: tuple[int, int], picture: int) -> None:
    """Gauges and all charts are in sight beside a large picture; in a low window the third chart is below."""
    page.set_viewport_size({"width": size[0], "height": size[1]})
    page.wait_for_function(f"() => ({OUTSIDE})() <= {2 if size[1] < 800 else 0}")
    assert page.locator(".hm-scene").bounding_box()["height"] >= picture
    page.set_viewport_size({"width": 1200, "height": 800})


def test_dialogs_fit_a_phone(page: Any) -> None:
    """Each choice is as a whole inside the dialog."""
    page.set_viewport_size({"width": 360, "height": 800})
    page.get_by_role("button", name="Machine", exact=True).click()
    dialog = page.locator("dialog[open]")
    dialog.locator("select").first.wait_for()
    box = dialog.bounding_box()
    for one in dialog.locator("select").all():
        found = one.bounding_box()
        assert found["x"] > box["x"]
        assert found["x"] + found["width"] < box["x"] + box["width"]
    close_windows(page)
    page.set_viewport_size({"width": 1200, "height": 800})


RING = entry(__file__, "ring")


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_focus_is_seen(page: Any, scheme: str) -> None:
    """The ring around what has the focus differs from what is around it by 3:1 (WCAG 1.4.11)."""
    page.emulate_media(color_scheme=scheme)
    page.get_by_role("button", name="Keys").focus()
    page.keyboard.press("Shift+Tab")
    style, contrast = page.evaluate(RING)
    page.emulate_media(color_scheme=None)
    assert style == "solid"
    assert contrast >= 3


def test_only_what_changes_is_drawn(page: Any) -> None:
    """Sticks that rest are not written, and the processor draws the charts: without a graphics card, either
    would cost more than the picture of the machine."""
    written = page.evaluate("""() => new Promise((resolve) => {
      let written = 0;
      const watch = new MutationObserver((records) => { written += records.length; });
      for (const stick of document.querySelectorAll('.hm-stick'))
        watch.observe(stick, { attributes: true, subtree: true });
      setTimeout(() => resolve(written), 300); })""")
    assert written == 0
    own = "one.getContext('2d').getContextAttributes().willReadFrequently"
    found = page.evaluate(f"[...document.querySelectorAll('.hm-chart canvas')].map((one) => {own})")
    assert len(found) > 2
    assert all(found)
    assert page.evaluate("HTMLCanvasElement.prototype.getContext.toString()").endswith("[native code] }")


def test_less_to_draw(own: Any) -> None:
    """When the sticks came late once, trees and shadow are left out, and the machine is drawn as before."""
    own.evaluate("() => document.querySelector('.harvester-machine').machine.slow()")
    own.locator(".hm-stage[data-detail=low]").wait_for()
    drawn = int(own.evaluate("document.querySelector('.hm-stage').dataset.drawn"))
    own.wait_for_function(DRAWN, arg=drawn + 1)
    assert picture(own).std() > 0.05, "a blank picture has no contrast"


def test_asking_hides_nothing(own: Any, server: Server) -> None:
    """On a second page the button is as wide as before, and the answer stands above sticks and keys."""
    wide = own.get_by_role("button", name="Take controls").bounding_box()["width"]
    take(own, server)
    second = own.context.new_page()
    second.set_default_timeout(1e3 * LONG)
    second.goto(server.url)
    ask = second.get_by_role("button", name="Request controls")
    assert ask.bounding_box()["width"] == pytest.approx(wide, abs=0.5)  # px: rounding of the layout
    ask.click()
    told = second.get_by_role("alert").get_by_text("requested; the driver has to release the controls")
    told.wait_for()
    box = told.bounding_box()
    assert box["y"] + box["height"] < second.locator(".hm-hands").bounding_box()["y"]


def test_task_in_a_line(page: Any) -> None:
    """The panel is a line with the way to the target; there is no table before the first attempt is over."""
    page.get_by_role("button", name="Training task").click()
    page.get_by_text("pick: ").wait_for()
    assert page.locator(".hm-task").bounding_box()["height"] < 120, "a line or two, not a table over the boom"
    assert not page.locator(".hm-task table").is_visible()
    page.get_by_role("button", name="Training task").click()


def test_speed_is_that_of_the_machine(page: Any, server: Server) -> None:
    """What another page has chosen is shown here, too."""
    server.session.speed(0.5)
    page.wait_for_function("() => document.querySelector('.hm-speed').value === '0.5'")
    page.get_by_role("combobox", name="Speed").select_option("1")
    assert until(lambda: server.session.factor == 1.0)


def test_pose_and_fidelity(page: Any, server: Server) -> None:
    """Another pose and another variant, chosen on the page, start the machine anew as these."""
    page.get_by_role("button", name="Machine", exact=True).click()
    for label, option in (("Pose", "reach"), ("Manipulator", "pendulum")):
        page.get_by_role("combobox", name=label).select_option(option)
    page.get_by_role("button", name="Start", exact=True).click()
    assert until(lambda: server.session.plan.choice.pose == "reach")
    assert comes_to(server, "running")
    first = server.session.machine.trace()["manipulator.stick_angle"][0]
    assert first == pytest.approx(-0.65, abs=1e-6)  # it creeps afterwards; rounding of the file
    page.wait_for_function("() => document.querySelector('.hm-panel').innerText.includes('Head, sideways')")


def test_replay(own: Any, server: Server) -> None:
    """A result file is played by the page itself, then the live machine; one that is gone is one line."""
    own.get_by_role("button", name="Replay").click()
    # a click waits for two equal frames, which a computer without a graphics card may not draw in time
    own.locator("dialog").get_by_role("button", name="Replay", exact=True).press("Enter")
    own.wait_for_function("() => document.title === 'Replay: rising.csv'")
    time = "document.querySelector('.harvester-machine').machine.source.time"
    own.wait_for_function(f"() => {time} > 0.5")
    own.locator(".hm-pause").click()
    slider = own.get_by_role("slider", name="Time")
    slider.click(position={"x": 0.1 * slider.bounding_box()["width"], "y": 8})
    own.wait_for_function(f"() => {time} < 1")
    assert own.complaints == []
    own.get_by_role("button", name="Live machine").click()
    own.get_by_role("button", name="Take controls").wait_for()
    own.goto(f"{server.url}?replay=gone.csv")
    own.get_by_role("alert").get_by_text("gone.csv").wait_for()


def test_save(page: Any, tmp_path: Path) -> None:
    """The session comes as a file that can be read, with the axes and the signals; the page says how to run
    the same drive, which comes to the same angles."""
    with page.expect_download() as loaded:
        page.get_by_role("button", name="Save the drive").click()
    found = read_trace(loaded.value.path().rename(tmp_path / "session.parquet"))
    assert {"boom_command", "manipulator.boom_angle"} <= set(found.signals)
    said = page.get_by_role("alert").get_by_text("the same drive: ").inner_text()
    words = shlex.split(said.partition("the same drive: ")[2])
    out = tmp_path / "again.csv"
    words += ["--stop", str(found.time[-1]), "--out", str(out)]
    subprocess.run([sys.executable, "-m", "orchestrator", *words[1:]], check=True, capture_output=True)
    result = read_trace(out)
    for joint in ("swing", "boom", "stick"):
        name = f"manipulator.{joint}_angle"
        # frame by frame, the solvers of the FMUs begin anew
        np.testing.assert_allclose(result[name][-1], found[name][-1], atol=1e-4)


def test_help(page: Any, server: Server) -> None:
    """The map of the keys opens over the page; after it the keys belong to the sticks of a driver."""
    take(page, server)
    page.locator(".hm-state").get_by_text("hold Space").wait_for()
    page.get_by_role("button", name="Keys").click()
    page.locator("dialog").get_by_text("the machine rests without it").wait_for()
    page.locator("dialog").get_by_role("button", name="Close").click()
    page.wait_for_function("() => document.activeElement.classList.contains('hm-stage')")
