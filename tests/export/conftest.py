"""Small subsystems unknown to the exporter, built once per test process, and a handle on their FMUs."""

# ruff: noqa: ARG005  (dynamics and observe take x, u, p, whatever a toy uses)

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import casadi as ca
import fmpy
import pytest
from fmpy import fmi2
from kit.toy import toy

from fmus.contract import Quantity, Subsystem
from fmus.export.build import build
from fmus.parameters import Values


def q(unit: str = "1", nominal: float = 1.0, **more: Any) -> Quantity:
    return Quantity(unit, "of a toy", nominal, **more)


def smooth_root(value: ca.SX, width: float) -> ca.SX:
    return value / ca.sqrt(ca.sqrt(value**2 + width**2))


DECAY = toy(
    "decay",
    p={"rate": q("1/s", tunable=True), "gain": q(minimum=0.0, maximum=10.0)},
    x={"level": q(minimum=-1e6)},
    u={"target": q(minimum=-100.0, maximum=100.0)},
    y={"level": q(), "mixed": q(warn_above=5.0)},
    f=lambda x, u, p: {"level": p.rate * (u.target - x.level)},
    g=lambda x, u, p: {"level": x.level, "mixed": p.gain * x.level + u.target},
)
PATH = toy(
    "path",
    p={},
    x={"integral": q("m.s")},
    u={
        "position": q("m", rate="velocity"),
        "velocity": q("m/s", rate="acceleration"),
        "acceleration": q("m/s2"),
    },
    y={"integral": q("m.s"), "where": q("m")},
    f=lambda x, u, p: {"integral": u.position},
    g=lambda x, u, p: {"integral": x.integral, "where": u.position},
)
VANDERPOL = toy(
    "vanderpol",
    p={"mu": q(), "force_gain": q()},
    x={"x": q(), "v": q()},
    u={"force": q()},
    y={"x": q(), "v": q(), "power": q()},
    f=lambda x, u, p: {"x": x.v, "v": p.mu * (1 - x.x**2) * x.v - x.x + p.force_gain * u.force},
    g=lambda x, u, p: {"x": x.x, "v": x.v, "power": u.force * x.v},
)
# a chamber behind a hose with inertia, between a supply and a leak: stiff, badly scaled, calculated start
CHAMBER = toy(
    "chamber",
    p={
        "volume": q("m3", 1e-3, minimum=1e-9),
        "modulus": q("Pa", 1e9),
        "inertance": q("kg/m4", 1e6),
        "conductance": q("m3/(s.Pa)", 1e-12),
        "burst": q("Pa", 1e7),
    },
    x={"pressure": q("Pa", 1e7), "flow": q("m3/s", 1e-4), "heat": q("J", 100.0)},
    u={"opening": q("1", minimum=0.0, maximum=1.0), "supply": q("Pa", 1e7)},
    y={
        "pressure": q("Pa", 1e7, warn_above=1.9e7),
        "force": q("N", 1e4, warn_above=1.5e4),
        "pressure_rate": q("Pa/s", 1e8),
    },
    f=lambda x, u, p: {
        "pressure": p.modulus / p.volume * (x.flow - p.conductance * x.pressure),
        "flow": (u.supply - x.pressure - 1e12 * x.flow * ca.fabs(x.flow)) / p.inertance
        - 1e4 * (1 - u.opening) * x.flow,
        "heat": p.conductance * x.pressure**2,
    },
    g=lambda x, u, p: {
        "pressure": x.pressure,
        "force": 1e-3 * x.pressure + smooth_root(u.supply - x.pressure, 1e4),
        "pressure_rate": p.modulus / p.volume * (x.flow - p.conductance * x.pressure),
    },
    initial=lambda _, u, p: {"pressure": u.supply / 2, "flow": p.conductance * u.supply / 2},
    require=lambda x, u, p: {"the pressure stays below 100 % of burst": p.burst - x.pressure},
)
GAIN = toy(
    "gain",
    p={"factor": q()},
    x={},
    u={"left": q(), "right": q()},
    y={"product": q()},
    f=lambda x, u, p: {},
    g=lambda x, u, p: {"product": p.factor * u.left * u.right},
)
BLOWUP = toy(
    "blowup",
    p={},
    x={"size": q(), "fuel": q()},
    u={},
    y={"size": q()},
    f=lambda x, u, p: {"size": x.size**2, "fuel": -ca.sqrt(x.fuel) - 1},
    g=lambda x, u, p: {"size": x.size},
)
NUMBERS = {
    "decay": Values({"rate": 2.0, "gain": 3.0}, {"target": 0.0}, {"level": 1.0}),
    "path": Values({}, {"position": 0.0, "velocity": 0.0, "acceleration": 0.0}, {"integral": 0.0}),
    "vanderpol": Values({"mu": 5.0, "force_gain": 1.0}, {"force": 0.0}, {"x": 2.0, "v": 0.0}),
    "chamber": Values(
        {"volume": 1e-4, "modulus": 1.6e9, "inertance": 1e6, "conductance": 1e-11, "burst": 3e7},
        {"opening": 1.0, "supply": 2e7},
        {"pressure": 0.0, "flow": 0.0, "heat": 0.0},
    ),
    "gain": Values({"factor": 2.0}, {"left": 1.0, "right": 1.0}, {}),
    "blowup": Values({}, {}, {"size": 1.0, "fuel": 100.0}),
}
TOYS = {sub.name: sub for sub in (DECAY, PATH, VANDERPOL, CHAMBER, GAIN, BLOWUP)}


@dataclass
class Handle:
    """An instance of an FMU, variables by name, messages as (category, text)."""

    fmu: Any
    refs: Mapping[str, int]
    messages: list[tuple[str, str]]
    status: int = 0

    def get(self, *names: str) -> Any:
        values = self.fmu.getReal([self.refs[n] for n in names])
        return values[0] if len(names) == 1 else values

    def set(self, **values: float) -> None:
        self.fmu.setReal([self.refs[n] for n in values], list(values.values()))

    def slopes(self, order: int = 1, **values: float) -> None:
        self.fmu.setRealInputDerivatives(
            [self.refs[n] for n in values], [order] * len(values), list(values.values())
        )

    def output_slope(self, *names: str) -> list[float]:
        return list(self.fmu.getRealOutputDerivatives([self.refs[n] for n in names], [1] * len(names)))

    def start(self, time: float = 0.0, tolerance: float | None = None, stop: float | None = None) -> Handle:
        self.fmu.setupExperiment(startTime=time, tolerance=tolerance, stopTime=stop)
        self.fmu.enterInitializationMode()
        self.fmu.exitInitializationMode()
        return self

    def run(self, n: int, step: float, start: float = 0.0) -> Handle:
        for k in range(n):
            self.fmu.doStep(start + k * step, step)
        return self

    def errors(self) -> list[str]:
        return [text for category, text in self.messages if category == "logStatusError"]


@pytest.fixture(scope="session")
def toy_dir(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with an FMU of every toy."""
    folder = tmp_path_factory.mktemp("toys")
    for name, sub in TOYS.items():
        build(sub, folder, step=0.01, stop=1.0, values=NUMBERS[name])
    return folder


@pytest.fixture(scope="session")
def unpacked(toy_dir: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Toy -> folder with its unpacked FMU."""
    folders = {name: tmp_path_factory.mktemp(name) for name in TOYS}
    for name, folder in folders.items():
        fmpy.extract(str(toy_dir / f"{name}.fmu"), str(folder))
    return folders


@pytest.fixture
def open_fmu(unpacked: dict[str, Path]) -> Iterator[Callable[..., Handle]]:
    """open_fmu("decay") instantiates a toy's FMU for co-simulation, or for model exchange."""
    opened: list[Handle] = []

    def opener(
        name: str, model_exchange: bool = False, logging: bool = False, guid: str | None = None
    ) -> Handle:
        description = fmpy.read_model_description(str(unpacked[name]), validate=False)
        kind = fmi2.FMU2Model if model_exchange else fmi2.FMU2Slave
        fmu = kind(
            guid=guid or description.guid,
            unzipDirectory=str(unpacked[name]),
            modelIdentifier=name,
            instanceName="toy",
        )
        messages: list[tuple[str, str]] = []
        fmu.instantiate(callbacks=_callbacks(messages), loggingOn=logging)
        handle = Handle(fmu, {v.name: v.valueReference for v in description.modelVariables}, messages)
        opened.append(handle)
        return handle

    yield opener
    for handle in opened:
        handle.fmu.freeInstance()


def _callbacks(messages: list[tuple[str, str]]) -> Any:
    def logger(_env: Any, _name: bytes, _status: int, category: bytes, text: bytes) -> None:
        messages.append((category.decode(), text.decode().replace("%%", "%")))

    callbacks = fmi2.fmi2CallbackFunctions()
    callbacks.logger = fmi2.fmi2CallbackLoggerTYPE(logger)
    return callbacks


@pytest.fixture(scope="session")
def toys() -> Mapping[str, tuple[Subsystem, Values]]:
    """Toy -> its subsystem and numbers."""
    return {name: (sub, NUMBERS[name]) for name, sub in TOYS.items()}


@pytest.fixture(scope="session")
def make_toy() -> Callable[..., Subsystem]:
    """The function that makes a subsystem of dictionaries."""
    return toy
