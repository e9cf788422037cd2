"""Small subsystems unknown to the exporter, and their FMUs, built once for all test processes."""

# ruff: noqa: ARG005  (dynamics and observe take x, u, p, whatever a toy uses)

from collections.abc import Callable, Iterator, Mapping
from itertools import product
from pathlib import Path
from typing import Any

import casadi as ca
import fmpy
import pytest
from kit.fmu import Fmu
from kit.toy import toy

from fmus.contract import Quantity, Subsystem
from fmus.export.build import build
from fmus.parameters import Values


def stateless(name: str, u: dict[str, Any], y: dict[str, Any], observe: Any, p: Any = None) -> Subsystem:
    """A subsystem of inputs u, outputs y and parameters p alone, with the function observe(x, u, p)."""
    return toy(name, p or {}, {}, u, y, lambda *_: {}, observe)


def q(unit: str = "1", nominal: float = 1.0, **more: Any) -> Quantity:
    return Quantity(unit, "of a toy", nominal, **more)


def smooth_root(value: ca.SX, width: float) -> ca.SX:
    return value / ca.sqrt(ca.sqrt(value**2 + width**2))


DECAY = toy(
    "decay",
    p={"rate": q("1/s", tunable=True), "gain": q(minimum=0.0, maximum=10.0)},
    x={"level": q(minimum=-1e6)},
    u={"target": q(minimum=-100.0, maximum=100.0)},
    y={"level": q(warn_below=-60.0, meaning="it is dry: fill it"), "mixed": q(warn_above=5.0)},
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
    y={"integral": q("m.s"), "where": q("m", warn_above=5e3)},
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
GAIN = stateless(
    "gain",
    {"left": q(), "right": q()},
    {"product": q()},
    lambda x, u, p: {"product": p.factor * u.left * u.right},
    {"factor": q()},
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


@pytest.fixture(scope="session")
def unpacked(once: Callable[..., Path]) -> Mapping[tuple[int, str], Path]:
    """(FMI version, toy) -> folder with its unpacked FMU; the FMU is beside it."""

    def make(folder: Path) -> None:
        for (name, sub), fmi in product(TOYS.items(), (2, 3)):
            path = build(sub, folder / str(fmi), step=0.01, stop=1.0, values=NUMBERS[name], fmi=fmi)
            fmpy.extract(str(path), str(path.with_suffix("")))

    folder = once("toys", make)
    return {(fmi, name): folder / str(fmi) / name for name in TOYS for fmi in (2, 3)}


@pytest.fixture(scope="session")
def toy_dir(unpacked: Mapping[tuple[int, str], Path]) -> Path:
    """Folder with an FMU of every toy, for FMI 2.0."""
    return unpacked[2, "decay"].parent


@pytest.fixture
def open_fmu(unpacked: Mapping[tuple[int, str], Path]) -> Iterator[Callable[..., Fmu]]:
    """open_fmu("decay", "me", fmi=3): an instance of a toy's FMU, freed at the end."""
    opened: list[Fmu] = []

    def opener(name: str, kind: str = "cs", fmi: int = 2, **options: Any) -> Fmu:
        opened.append(Fmu(unpacked[fmi, name], kind, **options))
        return opened[-1]

    yield opener
    for fmu in opened:
        fmu.close()


@pytest.fixture(scope="session")
def toys() -> Mapping[str, tuple[Subsystem, Values]]:
    """Toy -> its subsystem and numbers."""
    return {name: (sub, NUMBERS[name]) for name, sub in TOYS.items()}
