"""Fills tables of docs/machine.md, draws images/energy.png: `python docs/machine.py [--combinations F]`."""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

from convergence import fill

from benchmarks.circuits import (
    CIRCUITS_HEAD,
    SLEWING_HEAD,
    boom_mode,
    circuits,
    combinations,
    slewing,
    table,
    usual,
)
from fmus.machine.build import build_machine
from fmus.machine.parts import FAMILIES
from fmus.parameters import complete
from orchestrator import load, run
from orchestrator.pages.plotting import png
from orchestrator.results.energy import draw, energy

PAGE = Path(__file__).with_suffix(".md")
# part, variant, parameter, unit for the page
NUMBERS = (
    ("supply", "ideal", "pressure_setting", "bar"),
    ("supply", "engine_pump", "engine_rated_torque", "N.m"),
    ("boom_stick", "lumped", "density", "kg/m3"),
    ("boom_stick", "lumped", "valve_area", "mm2"),
    ("boom_stick", "lumped", "valve_dead_band", "V"),
    ("boom_stick", "lumped", "boom_bore", "mm"),
    ("boom_stick", "lumped", "stick_bore", "mm"),
    ("boom_stick", "lumped", "boom_hose_bore", "mm"),
    ("swing", "lumped", "motor_displacement", "cm3/rad"),
    ("swing", "compensated", "swing_section_flow", "L/min"),
    ("manipulator", "rigid", "boom_mass", "kg"),
    ("manipulator", "rigid", "stick_mass", "kg"),
    ("manipulator", "rigid", "head_mass", "kg"),
)
FACTORS = {"bar": 1e-5, "mm": 1e3, "mm2": 1e6, "L/min": 6e4, "cm3/rad": 1e6}


def numbers() -> Iterator[list[str]]:
    """Parameter, value, source and note."""
    for part, variant, name, unit in NUMBERS:
        number = complete(FAMILIES[part][variant])["parameters"][name]
        value = f"{number.value * FACTORS.get(unit, 1.0):.4g}" + (f" {unit}" if unit != "1" else "")
        yield [f"`{part}.{name}`", value, number.source, number.note.replace("|", "\\|")]


def modes(folder: Path) -> Iterator[list[str]]:
    """Frequency and damping ratio of the boom mode, by drives and manipulator."""
    for drives in FAMILIES["boom_stick"]:
        found = (
            boom_mode(folder, usual({"boom_stick": drives, "manipulator": m}))
            for m in FAMILIES["manipulator"]
        )
        yield [drives, *(f"{frequency:.1f} Hz, {damping * 100:.1f} %" for frequency, damping in found)]


def picture(folder: Path) -> None:
    """Draw the energies of the machine as it is and of the load-sensing machine."""
    today = dict.fromkeys(("swing", "boom_stick"), "compensated") | {"supply": "load_sensing"}
    traces = {
        name: run(load(folder / "harvester.ssp"), swap=swap).trace
        for name, swap in (("lumped", {}), ("load_sensing", today))
    }
    figure = draw({name: energy(trace, name) for name, trace in traces.items()})
    (PAGE.parent / "images" / "energy.png").write_bytes(png(figure))


def main() -> None:
    """Run the circuits and fill the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--combinations", type=Path, metavar="FILE", help="CSV of all combinations, too")
    parser.add_argument("--numbers", action="store_true", help="only the table of numbers")
    asked = parser.parse_args()
    fill(PAGE, "numbers", table(("parameter", "value", "source", "note"), numbers()))
    if asked.numbers:
        return
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        build_machine(folder)
        picture(folder)
        fill(PAGE, "circuits", table(CIRCUITS_HEAD, circuits(folder)))
        fill(PAGE, "slewing", table(SLEWING_HEAD, slewing(folder)))
        fill(PAGE, "modes", table(("drives", *FAMILIES["manipulator"]), modes(folder)))
        if asked.combinations:
            fill(PAGE, "combinations", combinations(folder, asked.combinations))


if __name__ == "__main__":
    main()
