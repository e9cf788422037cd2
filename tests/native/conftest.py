"""The machine's FMUs, unpacked, the driver for each version of FMI, and a model that does not behave."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import casadi as ca
import pytest
from kit.toy import toy
from native.bench import Fmu, driver, unpack

from fmus.contract import Quantity
from fmus.export.build import build
from fmus.machine.one_block import HARVESTER
from fmus.machine.parts import FERIC
from fmus.parameters import Values

NAMES = (*FERIC.components, HARVESTER.name)


@pytest.fixture(scope="session")
def machines(
    fmu_dir: Path, fmi3_dir: Path, tmp_path_factory: pytest.TempPathFactory
) -> Mapping[tuple[int, str], Fmu]:
    """All FMUs by version of FMI and name."""
    return {
        (version, name): unpack(folder / f"{name}.fmu", tmp_path_factory.mktemp(name))
        for version, folder in ((2, fmu_dir), (3, fmi3_dir))
        for name in NAMES
    }


@pytest.fixture(scope="session")
def drivers() -> Mapping[int, Path]:
    """The drivers for this machine by version of FMI."""
    return {version: driver(version) for version in (2, 3)}


def q(**more: Any) -> Quantity:
    return Quantity("1", "of a wild model", **more)


WILD = toy(
    "wild",
    p={"rate": q(tunable=True), "gain": q(minimum=0.0, maximum=10.0)},
    x={"level": q(minimum=-1e6), **dict.fromkeys(("root", "settled", "position", "velocity"), q())},
    u={"target": q(rate="speed"), "speed": q(rate="push"), "push": q(maximum=100.0)},
    y={"level": q(warn_above=5.0), "quotient": q(warn_above=50.0), "logarithm": q(), "power": q()},
    f=lambda x, u, p: {
        "level": p.rate * (u.target - x.level),
        "root": u.target / x.level - ca.sqrt(x.root),
        "settled": ca.exp(u.push) - x.settled,
        "position": x.velocity,  # van der Pol's oscillator never comes to rest
        "velocity": (1 - x.position**2) * x.velocity - x.position,
    },
    g=lambda x, u, p: {
        "level": x.level,
        "quotient": p.gain / (x.level - u.target),
        "logarithm": ca.log(x.root),
        "power": x.settled**7 * u.speed,
    },
    initial=lambda _, u, p: {"settled": p.gain / u.target},
    require=lambda x, *_: {"the level is below 1000": 1000 - x.level},
    next_event=lambda x, u, _: ca.exp(x.position * u.target) / u.speed,
)


@pytest.fixture(scope="session")
def wild(tmp_path_factory: pytest.TempPathFactory) -> Mapping[int, Path]:
    """wild.fmu by version of FMI."""
    numbers = Values(
        {"rate": 2.0, "gain": 3.0},
        {"target": 2.0, "speed": 0.0, "push": 0.0},
        {"level": 1.0, "root": 1.0, "settled": 0.0, "position": 2.0, "velocity": 0.0},
    )
    folder = tmp_path_factory.mktemp("wild")
    return {v: build(WILD, folder / str(v), values=numbers, fmi=v) for v in (2, 3)}
