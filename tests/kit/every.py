"""Every variant of every part as FMUs, driven by the inputs of the machine at work."""

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path

import numpy as np

from fmus.contract import Subsystem, quantities
from fmus.controller import CONTROLLER
from fmus.export.model_description import COMMUNICATION_STEP, data_file
from fmus.machine.parts import FAMILIES
from fmus.operator_input import OPERATOR
from fmus.valve_actuation import ACTUATION
from kit.fmu import Fmu, driving

EVERY: dict[str, Subsystem] = {
    f"{part}_{variant}": sub for part, variants in FAMILIES.items() for variant, sub in variants.items()
} | {sub.name: sub for sub in (OPERATOR, ACTUATION, CONTROLLER)}

# machines that hold every variant of every part at least once
MACHINES: tuple[dict[str, str], ...] = (
    {},
    {"swing": "quasistatic", "boom_stick": "quasistatic", "manipulator": "friction", "supply": "ideal"},
    {"swing": "detailed", "manipulator": "pendulum", "supply": "engine_pump"},
    {"boom_stick": "detailed", "manipulator": "pendulum_friction"},
    {"supply": "load_sensing"},
    {"swing": "compensated", "boom_stick": "compensated", "supply": "load_sensing"},
)


def work(sub: Subsystem) -> dict[str, np.ndarray]:
    """Inputs over time, a value every 10 ms, as the machine at work gives them to this part."""
    known = _read(data_file(sub, "input.csv"))
    return {name: samples for name, samples in known.items() if name in quantities(sub.inputs)}


@cache
def _read(path: Path) -> dict[str, np.ndarray]:
    """The columns of a file; none without it."""
    if not path.is_file():
        return {}
    table = np.genfromtxt(path, delimiter=",", names=True)
    return {name: table[name] for name in table.dtype.names}


def row(sub: Subsystem, k: int) -> dict[str, float]:
    """The inputs at one instant."""
    return {name: float(samples[k]) for name, samples in work(sub).items()}


@contextmanager
def at_work(path, sub: Subsystem, until: float, kind: str = "cs") -> Iterator[Fmu]:
    """The FMU after `until` seconds of work."""
    with driving(path, kind, **row(sub, 0)) as fmu:
        for k in range(round(until / COMMUNICATION_STEP)):
            fmu.set(**row(sub, k))
            fmu.step(COMMUNICATION_STEP)
        yield fmu


def outputs(sub: Subsystem) -> list[str]:
    """Names of all outputs."""
    return list(quantities(sub.outputs))


def native(name: str, folder: Path) -> Path:
    """The native FMU in a folder that `harvester build` filled."""
    alone = (OPERATOR.name, ACTUATION.name, CONTROLLER.name)
    return folder / ("" if name in alone else "variants") / f"{name}.fmu"
