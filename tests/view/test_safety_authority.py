"""Who drives, and when the machine rests: with a clock that the test moves."""

from __future__ import annotations

import pytest
from view.desk import Desk
from view.standin import LEVERS, StandIn

from orchestrator.view.driving.authority import AGAIN, HOLD


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
