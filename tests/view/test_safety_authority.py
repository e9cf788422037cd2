"""Who drives, who may take the controls, and when the machine rests: with a clock that the test moves."""

from __future__ import annotations

import json

import pytest
from view.standin import CONTROLLER, LEVERS, MODES, StandIn

from orchestrator.base.errors import Problem
from orchestrator.view.driving.authority import AGAIN, HOLD, MOST, ControlAuthority, OperatorStation


class Desk:
    """An authority, its machine, and pages that send."""

    def __init__(self) -> None:
        self.now = 100.0
        self.machine = StandIn()
        self.authority = ControlAuthority(
            self.machine, lambda: MODES, timeout=0.25, silence_limit=1.0, clock=lambda: self.now
        )
        self.numbers: dict[str, int] = {}

    def page(self) -> OperatorStation:
        station = self.authority.join()
        self.authority.connect(station)
        return station

    def driver(self) -> OperatorStation:
        """A page that drives to the left."""
        station = self.page()
        assert self.authority.take(station)
        self.say(station, dead_man=False)
        self.say(station)
        assert self.machine.moving
        return station

    def say(
        self,
        station: OperatorStation,
        dead_man: object = True,
        n: int | None = None,
        sticks: object = (-1, 0, 0, 0),
    ) -> bool:
        """A message 30 ms after the last one."""
        self.now += 0.03
        number = self.numbers[station.key] = self.numbers.get(station.key, -1) + 1 if n is None else n
        raw = json.dumps({"n": number, "sticks": list(sticks), "dead_man": dead_man})
        return self.authority.hear(station, station.connection, raw)

    def wait(self, seconds: float) -> None:
        """The watchdog looks every 50 ms."""
        for _ in range(round(seconds / 0.05)):
            self.now += 0.05
            self.authority.check()


@pytest.fixture
def desk() -> Desk:
    return Desk()


def test_driver_moves(desk: Desk) -> None:
    """With the controls and the dead-man, the stick moves the machine."""
    desk.driver()
    assert desk.machine.commands[-1][LEVERS[0]] > 0
    assert desk.authority.status().live


def test_watcher_does_not_move(desk: Desk) -> None:
    """Messages of a page without the controls move nothing, before and while another one drives."""
    watcher = desk.page()
    desk.say(watcher, dead_man=False)
    desk.say(watcher)
    assert not desk.machine.commands
    desk.driver()
    count = len(desk.machine.commands)
    desk.say(watcher)
    assert len(desk.machine.commands) == count
    assert desk.machine.moving


def test_dead_man(desk: Desk) -> None:
    """The dead-man released is rest at once, with the stick still out."""
    station = desk.driver()
    desk.say(station, dead_man=False)
    assert not desk.machine.moving
    desk.say(station)
    assert desk.machine.moving


def test_held_before_taking(desk: Desk) -> None:
    """A dead-man that was held already when the controls were taken does not count until it was released."""
    station = desk.page()
    desk.say(station)
    desk.authority.take(station)
    for _ in range(5):
        desk.say(station)
    assert not desk.machine.moving


@pytest.mark.parametrize("raw", ["{", b"\xff\x00", "x" * 10**6, '{"n":9,"sticks":[2,0,0,0],"dead_man":true}'])
def test_malformed(desk: Desk, raw: str | bytes) -> None:
    """A wrong message of the driver is rest, is counted, and needs the dead-man afresh."""
    station = desk.driver()
    assert not desk.authority.hear(station, station.connection, raw)
    assert not desk.machine.moving
    assert station.counts["refused"] == 1
    desk.say(station)
    assert not desk.machine.moving
    desk.say(station, dead_man=False)
    desk.say(station)
    assert desk.machine.moving


def test_malformed_of_a_watcher(desk: Desk) -> None:
    """What a watcher sends wrong does not disturb the driver."""
    watcher = desk.page()
    desk.driver()
    desk.authority.hear(watcher, watcher.connection, "{")
    assert desk.machine.moving


def test_old_messages(desk: Desk) -> None:
    """Repeated and overtaken messages count for nothing, and do not keep the machine moving."""
    station = desk.driver()
    count = len(desk.machine.commands)
    for n in (0, 1, 1):
        assert not desk.say(station, n=n, sticks=(1, 0, 0, 0))
    assert len(desk.machine.commands) == count
    for _ in range(10):
        desk.say(station, n=1)
        desk.authority.check()
    assert not desk.machine.moving


def test_patience_and_absence(desk: Desk) -> None:
    """Silence is rest after `timeout`, and after `silence_limit` the controls are free."""
    station = desk.driver()
    desk.wait(0.2)
    assert desk.machine.moving
    desk.wait(0.1)
    assert not desk.machine.moving
    assert desk.authority.status(station).role == "driving"
    desk.say(station)
    assert not desk.machine.moving, "the dead-man must be seen released after a silence"
    desk.wait(1.05)
    assert desk.authority.status(station).role == "free"


def test_lost_in_between(desk: Desk) -> None:
    """Some messages that get lost do not stop the machine, as long as one comes within `timeout`."""
    station = desk.driver()
    for n in range(10, 100, 7):
        desk.wait(0.15)
        desk.say(station, n=n)
        assert desk.machine.moving


def test_told_what_to_do(desk: Desk) -> None:
    """A driver who holds the dead-man in vain is told to let go of it; then to hold it."""
    station = desk.driver()
    desk.wait(0.3)
    desk.say(station)
    assert desk.authority.status(station).why == f"no message from this page for a moment: {AGAIN}"
    desk.say(station, dead_man=False)
    assert desk.authority.status(station).why == HOLD


def test_goes_on(desk: Desk) -> None:
    """When a machine that stood still is made to go on, its driver keeps the controls but holds afresh."""
    station = desk.driver()
    desk.machine.state = "paused"
    desk.say(station)
    desk.authority.halt()
    desk.machine.state = "running"
    desk.say(station)
    assert not desk.machine.moving
    assert desk.authority.status(station).role == "driving"
    assert desk.authority.status(station).why == AGAIN
    desk.say(station, dead_man=False)
    desk.say(station)
    assert desk.machine.moving


@pytest.mark.parametrize("halt", ["paused", "failed", "starting", "hanging"])
def test_machine_that_halts(desk: Desk, halt: str) -> None:
    """It does not move on by itself when it goes on: the dead-man has to be released first."""
    station = desk.driver()
    if halt == "hanging":
        desk.machine.latest = lambda: frozen
        frozen = StandIn.latest(desk.machine)
    else:
        desk.machine.state = halt
    for _ in range(20):
        desk.say(station)
    assert not desk.machine.moving
    assert not desk.authority.status().live
    told = desk.authority.status().why
    assert told == ("the machine does not move" if halt == "hanging" else f"the machine is {halt}")
    desk.machine.state = "running"
    vars(desk.machine).pop("latest", None)
    desk.say(station)
    assert not desk.machine.moving
    desk.say(station, dead_man=False)
    desk.say(station)
    assert desk.machine.moving


@pytest.mark.parametrize("halt", [0.4, 3.0])
def test_server_that_halts(desk: Desk, halt: float) -> None:
    """What a page said while the server hung comes late and in a bunch: it moves nothing."""
    station = desk.driver()
    desk.now += halt
    count = len(desk.machine.commands)
    for _ in range(25):
        desk.say(station)
    assert not any(any(command.values()) for command in desk.machine.commands[count:])
    assert not desk.machine.moving


def test_a_visitor_does_not_read_about_somebody_else(desk: Desk) -> None:
    """Why a driver lost the controls is shown on the driver's page; on others nobody drives."""
    driver, visitor = desk.driver(), desk.page()
    desk.authority.disconnect(driver, driver.connection)
    assert desk.authority.status(driver).why == "the connection to the driver was lost"
    assert desk.authority.status(visitor).why == "nobody drives"


def test_second_page(desk: Desk) -> None:
    """One drives; the second sees it, may ask, and drives only when the first has let go."""
    first = desk.driver()
    second = desk.page()
    assert not desk.authority.take(second)
    assert desk.authority.status(second).role == "watching"
    assert desk.authority.status(second).driver == first.name
    assert desk.authority.status(first).asked == second.name
    desk.authority.release(second)
    assert desk.machine.moving
    desk.authority.release(first)
    assert not desk.machine.moving
    assert desk.authority.take(second)
    assert desk.authority.status(second).asked == ""


@pytest.mark.parametrize("way", ["leave", "disconnect", "silence"])
def test_gone(desk: Desk, way: str) -> None:
    """However a driver goes, the machine rests and the next one can take the controls."""
    first, second = desk.driver(), desk.page()
    if way == "leave":
        desk.authority.leave(first)
    elif way == "disconnect":
        desk.authority.disconnect(first, first.connection)
    else:
        desk.wait(1.1)
    assert not desk.machine.moving
    assert desk.authority.take(second)


def test_new_connection(desk: Desk) -> None:
    """A page that connects again rests, counts from zero, and its old connection has no say any more."""
    station = desk.driver()
    old = station.connection
    desk.authority.connect(station)
    assert not desk.machine.moving
    desk.authority.disconnect(station, old)
    assert desk.authority.status(station).role == "driving"
    assert not desk.authority.hear(station, old, '{"n":99,"sticks":[0,0,0,0],"dead_man":false}')
    desk.numbers[station.key] = -1
    desk.say(station, dead_man=False)
    desk.say(station)
    assert desk.machine.moving


def test_flood(desk: Desk) -> None:
    """More messages than a browser sends are counted and not looked at."""
    station = desk.driver()
    heard = [desk.authority.hear(station, station.connection, "{") for _ in range(500)]
    assert not any(heard)
    assert station.counts["flood"] > 400
    assert not desk.machine.moving


def test_choice(desk: Desk) -> None:
    """The driver chooses pattern and mode; a change is rest; a watcher cannot; unknown ones are one line."""
    watcher, station = desk.page(), desk.driver()
    with pytest.raises(Problem, match="only the driver chooses"):
        desk.authority.choose(watcher, "SAE")
    desk.authority.choose(station, "SAE")
    assert not desk.machine.moving
    assert desk.authority.status().pattern == "SAE"
    for wrong in ({"pattern_name": "X"}, {"mode": "tip"}):
        with pytest.raises(Problem, match="expected"):
            desk.authority.choose(station, **wrong)


def test_restart_as_another_machine(desk: Desk) -> None:
    """When the machine is started again with other inputs, the next command uses those."""
    station = desk.driver()
    desk.machine.axes = CONTROLLER
    desk.authority.choose(station, mode="tip")
    desk.say(station, dead_man=False)
    desk.say(station)
    assert desk.machine.commands[-1]["controller.engaged"] == 1
    desk.machine.axes = LEVERS
    desk.say(station)
    assert set(desk.machine.commands[-1]) == set(LEVERS)


@pytest.mark.parametrize(
    ("mode", "left"), [("levers", "controller.engaged"), ("tip", "controller.swing_lever")]
)
def test_change_of_mode_waits_for_the_other_one(desk: Desk, mode: str, left: str) -> None:
    """While the controller still brakes, or a lever is on its way back, the other mode moves nothing."""
    desk.machine.axes = CONTROLLER
    station = desk.page()
    desk.authority.take(station)
    desk.authority.choose(station, mode=mode)
    desk.machine.still = {left: 1.0}
    desk.say(station, dead_man=False)
    desk.say(station)
    assert not desk.machine.moving
    assert desk.authority.status(station).why == "the machine comes to rest before it changes the mode"
    desk.machine.still = {}
    desk.say(station)
    assert desk.machine.moving


def test_replay(desk: Desk) -> None:
    """What cannot be driven gives nobody the controls."""
    desk.machine.drives = False
    station = desk.page()
    assert not desk.authority.take(station)
    assert desk.authority.status(station).why == "a replay cannot be driven"


@pytest.mark.parametrize("error", [Problem("machine: no such axis"), OSError("gone")])
def test_machine_that_breaks(desk: Desk, error: Exception, monkeypatch: pytest.MonkeyPatch) -> None:
    """A machine that takes no command stops nobody: the lamp goes out and says why."""
    station = desk.driver()

    def broken(_: object) -> None:
        raise error

    monkeypatch.setattr(desk.machine, "command", broken)
    assert desk.say(station)
    assert not desk.authority.status(station).live
    assert "machine" in desk.authority.status(station).why
    desk.authority.release(station)


def test_many_pages(desk: Desk) -> None:
    """Pages that were opened and never connected do not pile up; who drives keeps its place."""
    driver = desk.driver()
    first = desk.authority.join()
    for _ in range(2 * MOST):
        last = desk.authority.join()
    assert desk.authority.station(first.key) is None
    assert desk.authority.station(last.key) is last
    assert desk.authority.station(driver.key) is driver
