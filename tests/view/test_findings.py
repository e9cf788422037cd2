"""Findings of a diagnosis: what a system has of them, what a page is told, and since when each is a fault."""

import math
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from view import garage
from view.standin import StandIn, session

from orchestrator.base.signals import bare_name
from orchestrator.drive.findings import Finding, FindingTable, findings
from orchestrator.realtime.stepping import FrameStepper
from orchestrator.ssp.load import load
from orchestrator.ssp.system import Connection, Port
from orchestrator.view.choice import MachineChoice, plan
from orchestrator.view.live import Broadcast


@pytest.fixture(scope="module")
def workshop(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A system with a diagnosis."""
    return garage.system(tmp_path_factory.mktemp("workshop"))


def test_findings_of_a_system(workshop: Path) -> None:
    """Three outputs are a finding, in a mechanic's words and units; two an estimate, next to findings."""
    (leak, heat, switch, *estimates), resets = findings(load(workshop))
    assert resets == ("garage.reset",)
    assert (leak.text, leak.repair) == ("Opening of hose one at 60 \N{DEGREE SIGN}C", "hose one (left)")
    assert (leak.unit, leak.scale) == ("mm\N{SUPERSCRIPT TWO}", pytest.approx((1e6, 0, math.inf)))
    assert (heat.unit, heat.scale[:2]) == ("\N{DEGREE SIGN}C", pytest.approx((1.0, -273.15)))
    assert (switch.text, switch.unit) == ("The <b>switch</b> does not close", "")
    assert [one.signals[0] for one in (leak, heat, switch)] == ["garage.leak", "garage.heat", "garage.switch"]
    (load_,) = estimates
    assert (load_.signals, load_.repair, load_.unit) == (("garage.load", "garage.load_deviation"), "", "kg")
    assert load_.scale == (1.0, 0.0, 1000.0), "ten times the nominal value"


def test_a_reset_that_is_connected(workshop: Path) -> None:
    """The system forgets then, and not the page."""
    loaded = load(workshop)
    other = Connection(Port("garage", "switch"), Port("garage", "reset"))
    assert findings(replace(loaded, connections=(other,))) == (findings(loaded)[0], ())


def test_what_is_watched(workshop: Path, tmp_path: Path) -> None:
    """Each of their signals once, and the input of the diagnosis that forgets, once, also with a slider."""
    found = plan(MachineChoice(workshop))
    assert [axis.name for axis in found.setup.axes] == ["garage.reset"], "not that of the scale"
    assert set(found.setup.signals) == {name for one in found.findings for name in one.signals}
    assert "garage.speed_state" not in found.setup.signals, "a state of what has no deviation"
    slid = plan(MachineChoice(garage.system(tmp_path, {})))
    assert len(slid.findings) == len(found.findings)
    assert [axis.name for axis in slid.setup.axes].count("reset") == 1
    assert "garage.reset" not in [axis.name for axis in slid.setup.axes]
    assert len(set(slid.setup.signals)) == len(slid.setup.signals), "some are gauges, too"


def test_a_system_without_a_diagnosis(fmu_dir: Path) -> None:
    """It has no findings, and nothing more is recorded of it."""
    found = plan(MachineChoice(fmu_dir / "harvester.ssp"))
    assert found.findings == ()
    assert not [axis.name for axis in found.setup.axes if axis.name.endswith("reset")]


def test_forgotten(workshop: Path) -> None:
    """The axis that forgets is at its value in the next frame, so a short word is enough."""
    with closing(FrameStepper(plan(MachineChoice(workshop)).setup)) as live:
        live.advance(np.array([1.0]))
        assert live.axes == pytest.approx([1.0])


def three(name: str) -> tuple[str, ...]:
    return name, f"{name}_deviation", f"{name}_state"


HOLE = Finding(three("a.hole"), "", "hose", "mm2", (1e6, 0.0, math.inf))
HEAT = Finding(three("a.heat"), "", "cooler", "", (1.0, -273.15, math.inf))
LOAD = Finding(three("a.load")[:2], "", "", "kg", (1.0, 0.0, 1000.0))
SIGNALS = ("a.other", *HOLE.signals, *LOAD.signals, *HEAT.signals)


class Frames:
    """A table of findings, from frames: times, states of the hole, deviations of the load."""

    def __init__(self) -> None:
        self.machine = StandIn(signals=SIGNALS)
        self.table = FindingTable((HOLE, LOAD, HEAT), SIGNALS, self.since)

    def since(self, number: int) -> tuple[np.ndarray, ...]:
        self.asked = number
        return self.machine.since(number)

    def rows(self, *more: tuple[float, float, float]) -> np.ndarray:
        """After further frames."""
        values = [(t, [9.0, 3e-6, 1e-6, state, 50.0, off, 300.0, 2.0, -1.0]) for t, state, off in more]
        self.machine.frames += values
        self.table.look()
        return self.table.rows


def test_since_when() -> None:
    """Since its first frame without an interruption, also of an earlier look; a restart is one."""
    frames = Frames()
    assert len(frames.rows()) == 0
    hole, _, heat = frames.rows((0.1, 1, 5), (0.2, 0, 5), (0.3, 1, 5), (0.4, 1, 5))
    assert hole == pytest.approx([3.0, 1.0, 1.0, 0.3])
    assert heat == pytest.approx([26.85, 2.0, -1.0, math.nan], nan_ok=True)
    assert frames.rows((0.5, 1, 5))[0, 3] == 0.3
    assert frames.rows()[0, 3] == 0.3, "no frame while the machine is paused"
    assert frames.asked == len(frames.machine.frames) - 1, "no frame is read twice"
    assert math.isnan(frames.rows((0.6, -1, 5))[0, 3])
    assert frames.rows((0.7, 1, 5), (0.01, 1, 5))[0, 3] == 0.01


def test_an_estimate_that_is_not_known() -> None:
    """It has a size while its deviation is not far beyond what is usual; state and time it has none."""
    frames = Frames()
    known = frames.rows((0.1, 0, 999.0))[1]
    assert known == pytest.approx([50.0, 999.0, math.nan, math.nan], nan_ok=True)
    unknown = frames.rows((0.2, 0, 1001.0))[1]
    assert unknown == pytest.approx([math.nan, 1001.0, math.nan, math.nan], nan_ok=True)


def test_what_a_page_is_told(workshop: Path) -> None:
    """Texts once, values five times a second and not with each picture; a new start begins anew."""
    found = plan(MachineChoice(workshop))
    row = [3e-6, 2e-7, 1.0, 353.15, 2.0, 0.0, 1.0, 0.0, -1.0, 200.0, 30.0]
    machine = StandIn(("garage.reset",), found.setup.signals, frames=[(0.5, row), (0.51, row)])
    shown = session(machine, found)
    told = Broadcast(shown)
    repairs = ["hose one (left)", "cooler", "<i>switch</i>", ""]
    assert [one["repair"] for one in told.hello["findings"]] == repairs
    assert (told.hello["names"], told.hello["forget"]) == (["reset"], "reset")
    leak, heat, switch, load_ = told.info["findings"]
    assert leak == [3.0, 0.2, 1.0, 0.5]
    assert heat == [80.0, 2.0, 0.0, None]
    assert (switch, load_) == ([1.0, 0.0, -1.0, None], [200.0, 30.0, None, None])
    machine.frames += [(0.52, [0.0] * len(row))]
    for _ in range(4):
        told.look()
    assert told.info["findings"][0] == leak, "with the next info"
    told.look()
    assert told.info["findings"][0] == [0.0, 0.0, 0.0, None]
    machine.frames[:] = [(0.0, row)]
    shown.starts = 1
    told.look()
    assert told.info["findings"][0] == [3.0, 0.2, 1.0, 0.0]


def test_a_finding_that_is_a_gauge(tmp_path: Path) -> None:
    """It comes with each picture, too; the others do not."""
    found = plan(MachineChoice(garage.system(tmp_path, {})))
    description = replace(found.description, gauges=found.description.gauges[:1], charts=())
    shown = {line.name for group in description.gauges for line in group.lines}
    machine = StandIn(tuple(axis.name for axis in found.setup.axes), found.setup.signals)
    told = Broadcast(session(machine, replace(found, description=description)))
    assert shown
    assert set(told.hello["names"]) - {axis.name for axis in found.setup.axes} >= shown
    all_ = {bare_name(name) for one in found.findings for name in one.signals}
    assert set(told.hello["names"]) & all_ == shown & all_
