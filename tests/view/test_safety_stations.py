"""Who has the controls, and what becomes of them: with a clock that the test moves."""

from __future__ import annotations

import pytest
from view.desk import Desk
from view.standin import CONTROLLER, LEVERS

from orchestrator.base.errors import Problem
from orchestrator.view.driving.authority import MOST


@pytest.fixture
def desk() -> Desk:
    return Desk()


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
