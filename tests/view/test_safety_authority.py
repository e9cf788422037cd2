"""Who drives, who may take the controls, and when the machine rests: with a clock that the test moves."""

import json
import math

import pytest
from kit.mistakes import problem
from view.standin import CONTROLLER, DESCRIPTION, LEVERS, StandIn

from orchestrator.base.errors import Problem
from orchestrator.view.authority import AGAIN, HOLD, SLIDE, ControlAuthority, OperatorStation


class Desk:
    """An authority, its machine, and pages that send."""

    def __init__(self) -> None:
        self.now, self.machine, self.numbers = 100.0, StandIn(), dict[OperatorStation, int]()
        limits = {"timeout": 0.25, "silence_limit": 1.0, "clock": lambda: self.now}
        self.authority = ControlAuthority(self.machine, lambda: DESCRIPTION, **limits)
        self.page, self.status, self.take = self.authority.join, self.authority.status, self.authority.take

    def driver(self) -> OperatorStation:
        """A page that drives to the left."""
        station = self.page()
        assert self.take(station)
        assert self.hold_anew(station)
        return station

    def say(
        self, station: OperatorStation, dead_man: bool = True, n: int | None = None, left: float = 1
    ) -> bool:
        """A message 30 ms after the last one: does it count?"""
        self.now += 0.03
        number = self.numbers[station] = self.numbers.get(station, -1) + 1 if n is None else n
        raw = json.dumps({"n": number, "sticks": [-left, 0, 0, 0], "dead_man": dead_man})
        return self.authority.hear(station, raw)

    def hold(self, station: OperatorStation) -> bool:
        """One more message with the dead-man held: does the machine move then?"""
        self.say(station)
        return self.machine.moving

    def hold_anew(self, station: OperatorStation) -> bool:
        """The dead-man released, then held: does the machine move then?"""
        self.say(station, dead_man=False)
        assert not self.machine.moving
        return self.hold(station)

    def wait(self, seconds: float) -> None:
        """The watchdog looks every 50 ms."""
        for _ in range(round(seconds / 0.05)):
            self.now += 0.05
            self.authority.check()


@pytest.fixture
def desk() -> Desk:
    return Desk()


def test_driver_moves(desk: Desk) -> None:
    """With controls and dead-man the stick moves the machine; the dead-man released is rest at once."""
    station = desk.driver()
    assert desk.machine.commands[-1][LEVERS[0]] > 0
    assert desk.status().live
    assert desk.hold_anew(station)


def test_watcher_does_not_move(desk: Desk) -> None:
    """Messages of a page without the controls, wrong ones too, move nothing and do not disturb a driver."""
    watcher = desk.page()
    desk.hold_anew(watcher)
    assert not desk.machine.commands
    desk.driver()
    count = len(desk.machine.commands)
    desk.say(watcher)
    desk.authority.hear(watcher, "{")
    assert len(desk.machine.commands) == count
    assert desk.machine.moving


def test_held_before_taking(desk: Desk) -> None:
    """A dead-man that was held already when the controls were taken does not count until it was released."""
    station = desk.page()
    desk.say(station)
    desk.take(station)
    assert not any(desk.hold(station) for _ in range(5))


@pytest.mark.parametrize("raw", ["{", b"\xff\x00", "x" * 10**6, '{"n":9,"sticks":[2,0,0,0],"dead_man":true}'])
def test_malformed(desk: Desk, raw: str | bytes) -> None:
    """A wrong message of the driver is rest, is counted, and needs the dead-man afresh."""
    station = desk.driver()
    assert not desk.authority.hear(station, raw)
    assert not desk.machine.moving
    assert station.counts["refused"] == 1
    assert not desk.hold(station)
    assert desk.hold_anew(station)


def test_old_messages(desk: Desk) -> None:
    """Repeated and overtaken messages count for nothing, and do not keep the machine moving."""
    station = desk.driver()
    count = len(desk.machine.commands)
    assert not any(desk.say(station, n=n, left=-1) for n in (0, 1, 1))
    assert len(desk.machine.commands) == count
    for _ in range(10):
        desk.say(station, n=1)
        desk.authority.check()
    assert not desk.machine.moving


def test_patience_and_absence(desk: Desk) -> None:
    """Silence is rest after `timeout`, and after `silence_limit` the controls are free; a driver who holds
    the dead-man in vain is told to let go of it, then to hold it."""
    station = desk.driver()
    desk.wait(0.2)
    assert desk.machine.moving
    desk.wait(0.1)
    assert not desk.machine.moving
    assert desk.status(station).role == "driving"
    assert not desk.hold(station), "the dead-man must be seen released after a silence"
    assert desk.status(station).why == f"no message from this page for a moment: {AGAIN}"
    desk.say(station, dead_man=False)
    assert desk.status(station).why == HOLD
    desk.wait(1.05)
    assert desk.status(station).role == "free"


@pytest.mark.parametrize("halt", ["paused", "failed", "starting", "hanging"])
@pytest.mark.parametrize("told", [False, True], ids=["by itself", "made to go on"])
def test_machine_that_halts(desk: Desk, halt: str, told: bool) -> None:
    """It does not move when it goes on, by itself or when it is made to: its driver keeps the controls, but
    the dead-man has to be released first."""
    station = desk.driver()
    if halt == "hanging":
        desk.machine.latest = lambda: frozen
        frozen = StandIn.latest(desk.machine)
    else:
        desk.machine.state = halt
    for _ in range(20):
        desk.say(station)
    assert not desk.machine.moving
    assert not desk.status().live
    why = "the machine does not move" if halt == "hanging" else f"the machine is {halt}"
    assert desk.status().why == why
    if told:
        desk.authority.halt()
    desk.machine.state = "running"
    vars(desk.machine).pop("latest", None)
    assert not desk.hold(station)
    assert desk.status(station).role == "driving"
    assert desk.status(station).why == (AGAIN if told else f"{why}: {AGAIN}")
    assert desk.hold_anew(station)


@pytest.mark.parametrize("halt", [0.4, 3.0])
def test_server_that_halts(desk: Desk, halt: float) -> None:
    """What a page said while the server hung comes late and in a bunch: it moves nothing."""
    station = desk.driver()
    desk.now += halt
    assert not any(desk.hold(station) for _ in range(25))


def test_a_visitor_does_not_read_about_somebody_else(desk: Desk) -> None:
    """Why a driver lost the controls is shown on the driver's page; on others nobody drives."""
    driver, visitor = desk.driver(), desk.page()
    desk.wait(1.1)
    assert desk.status(driver).why == "the driver was silent"
    assert desk.status(visitor).why == "nobody drives"


def test_second_page(desk: Desk) -> None:
    """One drives; the second sees it, may ask, and drives only when the first has let go."""
    first, second = desk.driver(), desk.page()
    assert not desk.take(second)
    assert (desk.status(second).role, desk.status(second).driver) == ("watching", first.name)
    assert desk.status(first).asked == second.name
    desk.authority.release(second)
    assert desk.machine.moving
    desk.authority.release(first)
    assert not desk.machine.moving
    assert desk.take(second)
    assert desk.status(second).asked == ""


def test_inputs_that_are_set(desk: Desk) -> None:
    """A slider's value is within its ends and stays while its page drives, moving or not; it goes with the
    controls or a silence."""
    desk.machine.axes = (*LEVERS, "manipulator.payload_mass")
    watcher, station = desk.page(), desk.driver()
    problem(lambda: desk.authority.set(watcher, "payload_mass", 1.0), "only the driver")
    wrong = [(n, 1.0) for n in ("swing_command", "x", None)] + [("payload_mass", v) for v in ("1", math.nan)]
    for name, value in wrong:
        problem(lambda name=name, value=value: desk.authority.set(station, name, value), "expected")
    for value, kept in ((1e9, 500.0), (-1.0, 0.0)):
        desk.authority.set(station, "payload_mass", value)
        desk.say(station, dead_man=False)
        assert desk.machine.commands[-1] == {"manipulator.payload_mass": kept}
    desk.authority.set(station, "payload_mass", 100)
    kept = {"manipulator.payload_mass": 100.0}
    assert desk.hold(station)
    assert desk.machine.commands[-1].items() >= kept.items()
    desk.say(station, dead_man=False)
    assert desk.machine.commands[-1] == kept, "the sticks rest, the input stays"
    desk.wait(0.3)
    assert desk.machine.commands[-1] == {}, "after a silence nothing is kept"
    desk.say(station, dead_man=False)
    desk.authority.set(station, "payload_mass", 100)
    desk.say(station, dead_man=False)
    assert desk.machine.commands[-1] == kept
    desk.machine.still = {"manipulator.payload_mass": 100.0}
    desk.authority.release(station)
    assert desk.machine.commands[-1] == {}
    assert desk.hold(desk.driver()), "what another driver has set, and the machine keeps, is no fault"
    assert "manipulator.payload_mass" not in desk.machine.commands[-1]


def test_machine_without_sticks(desk: Desk) -> None:
    """Its inputs are set by sliders alone; sticks are a fault, and the page says what to do."""
    desk.machine.axes = ("u",)
    station = desk.page()
    desk.authority.take(station)
    assert desk.status(station).why == SLIDE
    desk.authority.set(station, "u", 2.0)
    for held in (False, True):
        desk.say(station, dead_man=held)
        assert desk.machine.commands[-1] == {"u": 2.0}
    assert not desk.status(station).live


def test_choice(desk: Desk) -> None:
    """The driver chooses pattern and mode; a change is rest; a watcher cannot; unknown ones are one line."""
    watcher, station = desk.page(), desk.driver()
    problem(lambda: desk.authority.choose(watcher, "SAE"), "only the driver chooses")
    desk.authority.choose(station, "SAE")
    assert not desk.machine.moving
    assert desk.status().pattern == "SAE"
    problem(lambda: desk.authority.choose(station, "JCB"), "^pattern: expected one of ISO, SAE, found JCB$")
    problem(lambda: desk.authority.choose(station, "SEA"), r"found SEA; did you mean SAE\?$")
    problem(lambda: desk.authority.choose(station, mode="tip"), "^mode: expected one of levers, found tip$")


def test_restart_as_another_machine(desk: Desk) -> None:
    """When the machine is started again with other inputs, the next command uses those."""
    station = desk.driver()
    desk.machine.axes = CONTROLLER
    desk.authority.choose(station, mode="tip")
    assert desk.hold_anew(station)
    assert desk.machine.commands[-1]["controller.engaged"] == 1
    desk.machine.axes = LEVERS
    desk.say(station)
    assert set(desk.machine.commands[-1]) == set(LEVERS)


@pytest.mark.parametrize(("mode", "left"), [("levers", "engaged"), ("tip", "swing_lever")])
def test_change_of_mode_waits_for_the_other_one(desk: Desk, mode: str, left: str) -> None:
    """While the controller still brakes, or a lever is on its way back, the other mode moves nothing."""
    desk.machine.axes = CONTROLLER
    station = desk.page()
    desk.take(station)
    desk.authority.choose(station, mode=mode)
    desk.machine.still = {f"controller.{left}": 1.0}
    assert not desk.hold_anew(station)
    assert desk.status(station).why == "the machine comes to rest before it changes the mode"
    desk.machine.still = {}
    assert desk.hold(station)


def test_an_input_that_rests_elsewhere(desk: Desk) -> None:
    """A pressure that no stick drives rests at its own value, and hinders no stick."""
    desk.machine.axes = (*LEVERS, "supply_pressure")
    desk.machine.still = {"supply_pressure": 20e6}
    assert desk.hold_anew(desk.driver())


@pytest.mark.parametrize("error", [Problem("machine: no such axis"), OSError("gone")])
def test_machine_that_breaks(desk: Desk, error: Exception, monkeypatch: pytest.MonkeyPatch) -> None:
    """A machine that takes no command stops nobody: the lamp goes out and says why."""
    station = desk.driver()

    def broken(_: object) -> None:
        raise error

    monkeypatch.setattr(desk.machine, "command", broken)
    assert desk.say(station)
    assert not desk.status(station).live
    assert "machine" in desk.status(station).why
    desk.authority.release(station)
