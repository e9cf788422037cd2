"""The line of the state and the axes of the charts: what they say, without a browser."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from view.modes import DESCRIPTION

from orchestrator.realtime.setup import Frame, Timing
from orchestrator.scene.view_description import Chart
from orchestrator.view.panels.charts import options
from orchestrator.view.panels.gauges import RealTimeFactor, cells, tip_limit
from orchestrator.view.session import SignalIndex

PULSE = Timing()
NAMES = ("engaged", "reference_share", "stroke_use", "speed_use")


def frame(t: float = 1.0, state: str = "running", message: str = "", timing: Timing = PULSE) -> Frame:
    return Frame(1, t, np.zeros(0), np.zeros(0), state, message, timing)


def test_clock() -> None:
    """The factor is simulated over real time, and nothing is told right after a pause."""
    now = [0.0]
    clock = RealTimeFactor(lambda: now[0])
    for k in range(20):
        now[0] = 0.1 * k
        clock.look(frame(t=0.05 * k))
    assert clock.factor == pytest.approx(0.5)
    clock.look(frame(t=0.95, state="paused"))
    assert clock.factor is None


def test_cells() -> None:
    """Missed deadlines and latency are told of a live machine, the reason of a failure in any case."""
    timing = Timing(frames=1000, missed=10, latency=(4e-4, 1e-3, 2e-2), load=0.05)
    live = dict((name, text) for name, text, _ in cells(frame(timing=timing), 1.0, drives=True))
    assert live["missed"] == "10 of 1000 (1.00 %)"
    assert live["latency"] == "0.4 ms, 99 % 1.0, worst 20.0"
    replayed = cells(frame(timing=timing), 1.0, drives=False)
    assert next(text for _, text, _ in replayed) == "replaying"
    assert "missed" not in [name for name, *_ in replayed]
    assert cells(frame(state="failed", message="it broke"), None, drives=True)[-1][1:] == ("it broke", "bad")


@pytest.mark.parametrize(
    ("values", "told"),
    [
        ((1.0, 1.0, 0.5, 0.5), ""),
        ((0.0, 0.1, 9.0, 0.5), ""),  # off
        ((1.0, 0.1, 9.0, 1.2), "at the end of a stroke"),
        ((1.0, 0.7, 0.5, 1.4), "at a speed limit"),
        ((1.0, 0.5, 0.5, 0.9), "waits for the machine"),
    ],
)
def test_what_holds_the_tip(values: tuple[float, ...], told: str) -> None:
    """The limit that is used most has a cell of its own while the controller is on, else the wait has."""
    machine = SimpleNamespace(signals=NAMES, axes=())
    now = Frame(1, 1.0, np.zeros(0), np.array(values), "running", "", PULSE)
    held = tip_limit(SignalIndex(machine), now)
    assert held == told
    shown = {name: text for name, text, _ in cells(now, 1.0, drives=True, limited=held)}
    assert shown.get("tip", "") == told


def test_a_machine_without_a_controller_is_held_by_nothing() -> None:
    """Where there is no share there is no word."""
    assert tip_limit(SignalIndex(SimpleNamespace(signals=(), axes=())), frame()) == ""


@pytest.mark.parametrize("chart", DESCRIPTION.charts, ids=lambda chart: chart.title)
def test_time_axis_has_a_unit(chart: Chart) -> None:
    """Each label of the time axis says s; the unit of the other axis stands in the title."""
    assert options(chart)["title"]["text"].endswith(f"[{chart.unit}]")
    assert options(chart)["xAxis"]["axisLabel"]["formatter"] == "{value} s"
    assert "formatter" not in options(chart)["yAxis"]["axisLabel"]
