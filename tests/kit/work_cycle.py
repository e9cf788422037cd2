"""The work cycle in other tools: taking them through it, and comparing what they give with the reference."""

import platform
import re
import sys
from collections.abc import Callable, Collection, Mapping
from importlib import import_module
from typing import Any

import numpy as np

from fmus.machine.build import data
from fmus.machine.parts import FERIC
from kit.needs import lacks

STEP = 1e-3  # s
JOINTS = ("swing", "boom", "stick")
PRESSURES = (
    *("swing.swing_pressure_a", "swing.swing_pressure_b"),
    *(f"boom_stick.{a}_{side}_pressure" for a in ("boom", "stick") for side in ("head", "rod")),
)
SIGNALS = (*(f"manipulator.{j}_{kind}" for kind in ("speed", "angle") for j in JOINTS), *PRESSURES)
# the manipulator first: it alone can be initialised without the others
ORDER = ("manipulator", "boom_stick", "swing", "operator_input")
FMUS = (*ORDER, "harvester")
VERSIONS = ("fmu_dir", "fmi3_dir")  # fixtures: the folders of FMI 2.0 and 3.0

RATED = FERIC.connections + FERIC.operator_wires
HELD = tuple(wire for wire in RATED if not wire[1].endswith(("_rate", "_acceleration")))

# NRMSE over range. Measured: speed 2e-4, angle 3e-6, pressure 2e-4, the error of the coupling at 1 ms (it
# is 4 times as large at 2 ms); the bars of the project's own master are 5e-3, 5e-4 and 1e-2
JACOBI = {"speed": 5e-4, "angle": 1e-5, "pressure": 5e-4}


def _columns(name: str) -> dict[str, np.ndarray]:
    """Columns of a CSV file of the project."""
    path = data(name)
    with path.open(encoding="utf-8") as file:
        names = file.readline().strip().split(",")
    return dict(zip(names, np.loadtxt(path, delimiter=",", skiprows=1).T, strict=True))


REFERENCE = _columns("reference/work_cycle.csv")


def nrmse(time: np.ndarray, found: Mapping[str, np.ndarray]) -> dict[str, float]:
    """Error of each signal over the range of the reference, at the samples of the reference."""
    window = (time[0] <= REFERENCE["time"]) & (REFERENCE["time"] <= time[-1] + 1e-9)
    errors = {}
    for name, values in found.items():
        true = REFERENCE[name][window]
        error = np.interp(REFERENCE["time"][window], time, values) - true
        errors[name] = float(np.sqrt(np.mean(error**2)) / np.ptp(true))
    return errors


def agree(time: np.ndarray, found: Mapping[str, np.ndarray], limits: Mapping[str, float]) -> None:
    """Each signal stays within the limit of its kind of the reference, as NRMSE over range."""
    for name, error in nrmse(time, found).items():
        limit = next(limit for kind, limit in limits.items() if kind in name)
        assert error < limit, f"{name}: NRMSE {error:.2e}, expected below {limit:.0e}"


def worst(time: np.ndarray, found: Mapping[str, np.ndarray], kind: str) -> float:
    """The largest error of one kind."""
    return max(nrmse(time, {n: values for n, values in found.items() if kind in n}).values())


def same(found: Mapping[str, np.ndarray], ours: Mapping[str, np.ndarray], tolerance: float) -> None:
    """Two runs at the same instants differ by less than `tolerance` of the range of the second."""
    for name, values in found.items():
        expected = ours[name][: len(values)]
        deviation = np.max(np.abs(values - expected)) / np.ptp(expected)
        assert deviation < tolerance, f"{name}: {deviation:.1e} of range, expected below {tolerance:.0e}"


def step_through(
    stop: float, step: Callable[[], Any], take: Callable[[], list[float]], size: float = STEP
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Take a tool to `stop` step by step; SIGNALS every 20 ms, where the reference has its samples."""
    rows, every = [], round(0.02 / size)
    for n in range(1, round(stop / size) + 1):
        step()
        if n % every == 0:
            rows.append([n * size, *take()])
    columns = np.array(rows).T
    return columns[0], dict(zip(SIGNALS, columns[1:], strict=True))


def check_log(text: str, known: Collection[str] = ()) -> None:
    """No line of a tool's log tells of an error; `known` lines are the tool's own."""
    bad = re.compile("error|fatal|fail|discard|warn|not provided|cannot|refuse", re.IGNORECASE)
    lines = [line for line in text.splitlines() if bad.search(line) and line.strip() not in known]
    assert not lines, "\n".join(lines)


def load(name: str) -> Any:
    """A binary package, or skip: these do not exist for every platform."""
    try:
        return import_module(name)
    except ModuleNotFoundError:
        assert (sys.platform, platform.machine()) != ("linux", "x86_64"), "the extra `test` brings it"
        lacks("Linux", f"{name} has no wheel elsewhere")
    except OSError as reason:  # ecospy needs libtbb.so.12
        lacks("libtbb12", f"{name} cannot be loaded: {reason}")
