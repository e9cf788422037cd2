"""How near a run of the work cycle comes to the reference: for scripts of other tools, NumPy is enough."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[2]
SYSTEM = ROOT / "build" / "harvester.ssp"
REFERENCE = ROOT / "data" / "reference" / "work_cycle.csv"
JOINTS = ("swing", "boom", "stick")
SIGNALS = (
    *(f"manipulator.{joint}_{kind}" for kind in ("speed", "angle") for joint in JOINTS),
    *(f"swing.swing_pressure_{port}" for port in ("a", "b")),
    *(f"boom_stick.{rod}_{side}_pressure" for rod in ("boom", "stick") for side in ("head", "rod")),
)


def report(time: np.ndarray, found: Mapping[str, np.ndarray]) -> str:
    """Worst root mean square error over range of each kind of signal, at the samples of the reference."""
    with REFERENCE.open(encoding="utf-8") as file:
        names = file.readline().strip().split(",")
        rows = np.loadtxt(file, delimiter=",")
    rows = rows[(rows[:, 0] >= time[0] - 1e-9) & (rows[:, 0] <= time[-1] + 1e-9)]
    errors = {}
    for name, values in found.items():
        true = rows[:, names.index(name)]
        error = np.interp(rows[:, 0], time, values) - true
        errors[name] = 100 * np.sqrt(np.mean(error**2)) / np.ptp(true)
    worst = {
        kind: max(value for name, value in errors.items() if kind in name)
        for kind in ("speed", "angle", "pressure")
    }
    told = ", ".join(f"{kind} {value:.2g} %" for kind, value in worst.items())
    return f"error over range after {time[-1]:g} s: {told}"
