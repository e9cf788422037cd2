"""Fixtures: small FMUs, a station around the one that integrates its input."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from kit.any_fmu.models import Workshop
from kit.needs import needs
from kit.wait import LONG

from orchestrator.realtime import deadlines
from orchestrator.realtime.machine import RealTimeMachine
from orchestrator.realtime.setup import Axis, Setup

DETAILED = {"manipulator": "pendulum_friction", "supply": "engine_pump"}
DETAILED |= dict.fromkeys(("swing", "boom_stick"), "detailed")
posix = needs("POSIX", "signals of POSIX")


def u(station: RealTimeMachine) -> float:
    """What drives the machine."""
    return float(station.latest().axes[0])


@pytest.fixture(scope="session")
def drift(fmus: Workshop) -> Setup:
    """y' = u, commands live for longer than any test."""
    return Setup(str(fmus["drift"]), (Axis("u", limit=2.0, rate=10.0),), ("drift.y", "drift.u"), timeout=LONG)


@pytest.fixture(scope="session")
def failing(fmus: Workshop, drift: Setup) -> Setup:
    """y' = u, and an error at 0.2 s."""
    broken = {"fails.when": 0.195, "fails.how": 3}
    return replace(drift, system=str(fmus["fails"]), signals=("fails.y",), set=broken)


@pytest.fixture
def opened(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., RealTimeMachine]]:
    """Opens stations, closes them at the end, and looks whether they leave anything behind."""
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    stations: list[RealTimeMachine] = []

    def start(*args: object, **options: object) -> RealTimeMachine:
        stations.append(RealTimeMachine(*args, **options))
        return stations[-1]

    yield start
    for station in stations:
        station.close()
    assert not list(tmp_path.glob("live-*"))


class Clock:
    """Time that passes when a test says so, and in sleep."""

    now = 100.0

    def monotonic(self) -> float:
        return self.now

    def sleep(self, length: float) -> None:
        assert length >= 0
        self.now += length


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    """In place of the real one, for deadlines."""
    clock = Clock()
    monkeypatch.setattr(deadlines, "time", clock)
    return clock
