"""Errors of the tip with the hysteresis of the valves, for docs/control.md: `python docs/control.py`.

Reads build/harvester_control.ssp. Sensors, sampling and noise are those of tests/kit/sensors.py. A row is a
set of start values; more rows are more entries of ROWS.
"""

import sys
from collections.abc import Mapping
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from kit.sensors import opener

from fmus.machine.build import data
from fmus.machine.parts import MACHINES
from orchestrator import read_trace, run

SYSTEM = Path("build/harvester_control.ssp")
TIP = [f"manipulator.tip_{n}" for n in ("x", "y", "height")]
COMPENSATED = {"swing": "compensated", "boom_stick": "compensated", "supply": "load_sensing"}
KINDS = {**MACHINES, "compensated": COMPENSATED}


def hysteresis(valve: float, assumed: float) -> dict[str, float]:
    """Start values: hysteresis of the valves, and that which the controller assumes at the start."""
    return {"valve_actuation.hysteresis": valve, "controller.hysteresis": assumed}


def oil(celsius: float) -> dict[str, float]:
    """Start values: oil at this temperature, and valves of 4 %, which the controller knows."""
    return hysteresis(0.04, 0.04) | {"supply.oil_temperature_start": celsius + 273.15}


ROWS: Mapping[str, dict[str, float]] = {
    "none": hysteresis(0, 0),
    **{f"{100 * h:g} %, not compensated": hysteresis(h, 0) for h in (0.02, 0.04, 0.08)},
    **{f"{100 * h:g} %, known": hysteresis(h, h) for h in (0.02, 0.04, 0.08)},
    **{f"{100 * h:g} %, 4 % assumed": hysteresis(h, 0.04) for h in (0.0, 0.02, 0.08)},
    **{f"4 %, known, {celsius:g} °C": oil(celsius) for celsius in (-10, 20)},
}


def error(kind: str, path: str, given: Mapping[str, float]) -> np.ndarray:
    """Distance of the tip from the commanded point [m], every 10 ms."""
    commanded = read_trace(data(f"scenarios/{path}.csv"))
    sets = [path, "compensated"] if kind == "compensated" else [path]
    options = {"swap": KINDS[kind], "parameters": sets, "set": dict(given)}
    trace = run(SYSTEM, commanded, record=TIP, record_step=0.01, step=1e-3, master="gauss-seidel",
                open=opener, **options).trace  # fmt: skip
    radius, angle, height = (
        np.interp(trace.time, commanded.time, commanded[f"path_{n}"]) for n in ("radius", "angle", "height")
    )
    wanted = radius * np.cos(angle), radius * np.sin(angle), height
    return np.linalg.norm([trace[n] - w for n, w in zip(TIP, wanted, strict=True)], axis=0)


def main() -> None:
    """Print the table: largest error and RMS [mm]."""
    columns = [(kind, path) for kind in KINDS for path in ("line", "square")]
    print("|hysteresis|" + "|".join(f"{kind}, {path}" for kind, path in columns) + "|")
    print("|---|" + "---|" * len(columns))
    for name, given in ROWS.items():
        errors = [1e3 * error(kind, path, given) for kind, path in columns]
        cells = (f"{e.max():.1f}, {np.sqrt((e**2).mean()):.1f}" for e in errors)
        print(f"|{name}|" + "|".join(cells) + "|", flush=True)


if __name__ == "__main__":
    main()
