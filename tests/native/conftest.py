"""The machine's FMUs, unpacked, the driver for each version of FMI, and a model that does not behave."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import casadi as ca
import pytest
from native.bench import Fmu, driver, unpack, zig

from fmus.contract import Quantity, Subsystem
from fmus.export.build import build
from fmus.machine.one_block import HARVESTER
from fmus.machine.parts import ALL
from fmus.parameters import Values

NAMES = (*ALL, HARVESTER.name)


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
def drivers(tmp_path_factory: pytest.TempPathFactory) -> Mapping[int, Path]:
    """The drivers for this machine by version of FMI."""
    folder = tmp_path_factory.mktemp("drivers")
    return {version: driver(version, folder, zig()) for version in (2, 3)}


# ---- a model that does not behave -------------------------------------------------------------------


def number(**more: Any) -> Any:
    return Annotated[Any, Quantity("1", "of a wild model", **more)]


@dataclass(frozen=True)
class Parameters:
    rate: number(tunable=True)
    gain: number(minimum=0.0, maximum=10.0)


@dataclass(frozen=True)
class States:
    level: number(minimum=-1e6)
    root: number()
    settled: number()
    position: number()
    velocity: number()


@dataclass(frozen=True)
class Inputs:
    target: number(rate="speed")
    speed: number(rate="push")
    push: number(maximum=100.0)


@dataclass(frozen=True)
class Outputs:
    level: number(warn_above=5.0)
    quotient: number(warn_above=50.0)
    logarithm: number()
    power: number()


def _dynamics(x: States, u: Inputs, p: Parameters) -> States:
    return States(
        level=p.rate * (u.target - x.level),
        root=u.target / x.level - ca.sqrt(x.root),
        settled=ca.exp(u.push) - x.settled,
        position=x.velocity,  # van der Pol's oscillator never comes to rest
        velocity=(1 - x.position**2) * x.velocity - x.position,
    )


def _observe(x: States, u: Inputs, p: Parameters) -> Outputs:
    return Outputs(
        level=x.level,
        quotient=p.gain / (x.level - u.target),
        logarithm=ca.log(x.root),
        power=x.settled**7 * u.speed,
    )


WILD = Subsystem(
    name="wild",
    text="Quotients, roots and logarithms of anything",
    parameters=Parameters,
    states=States,
    inputs=Inputs,
    outputs=Outputs,
    dynamics=_dynamics,
    observe=_observe,
    values=Path(__file__).parent / "none" / "parameters.toml",
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
