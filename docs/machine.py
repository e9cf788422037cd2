"""Fills tables of docs/machine.md, draws images/energy.png: `python docs/machine.py [--combinations F]`."""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path

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
from fmus.machine.build import harvester
from fmus.machine.parts import FAMILIES
from fmus.parameters import complete
from orchestrator import linearize, load, run
from orchestrator.pages.plotting import draw, png
from orchestrator.results.energy import energy, figure

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


def spool_delay(system: Path, given: Mapping[str, float]) -> str:
    """Time from a step of the boom's command to half of the speed that follows."""
    levers = {"time": [0.0, 0.5, 0.501, 1.5], "boom_command": [0.0, 0.0, 4.0, 4.0]}
    options = {"swap": {"boom_stick": "detailed"}, "parameters": ["reach"], "set": given, "stop": 1.5}
    trace = run(system, levers, record_step=1e-3, record=["manipulator.boom_velocity"], **options).trace
    speed, late = trace["manipulator.boom_velocity"], trace.time > 1.0
    reached = (trace.time > 0.5) & (speed > 0.5 * speed[late].mean())
    return f"{1e3 * (trace.time[reached][0] - 0.5):.0f} ms"


def swing_mode(system: Path, given: Mapping[str, float]) -> str:
    """Frequency and damping ratio of the swing on its closed valve, arm out."""
    modes = linearize(system, parameters=["reach"], steady=True, set=given).modes
    (swing,) = (m for m in modes if m.name == "hydraulic oscillation of swing")
    return f"{swing.frequency:.1f} Hz, {100 * swing.damping:.1f} %"


def lowering(system: Path, given: Mapping[str, float]) -> str:
    """Supply pressure and power of the boom section while an empty boom is lowered at full command."""
    today = dict.fromkeys(("swing", "boom_stick"), "compensated") | {"supply": "load_sensing"}
    levers = {"time": [0.0, 0.5, 0.8, 2.2], "boom_command": [0.0, 0.0, -10.0, -10.0]}
    names = "supply.supply_pressure", "boom_stick.boom_meter_in_flow"
    options = {"swap": today, "parameters": ["folded"], "set": given, "stop": 2.2}
    trace = run(system, levers, record=[*names], record_step=5e-3, **options).trace
    pressure, flow = (trace[name][trace.time > 1.5] for name in names)
    return f"{pressure.mean() / 1e5:.0f} bar, {(pressure * flow).mean() / 1e3:.0f} kW"


# what is changed, its old values, the measure, what the measure is
OLD_RODS = {"boom_stick.boom_rod_section_flow": 0.0027, "boom_stick.boom_head_return_area": 1.2e-4}
STEEP = {"boom_stick.boom_head_pilot_ratio": 3.0}
SIZES = (
    (
        "spools",
        {"boom_stick.spool_frequency": 30.0},
        spool_delay,
        "`detailed`: time to half of the speed after a step",
    ),
    (
        "volume at each side of the motor",
        {"swing.motor_volume": 1.215e-3},
        swing_mode,
        "frequency and damping of the swing mode",
    ),
    ("flow to the boom's rod side, return edge", OLD_RODS, lowering, "lowering the empty boom"),
    ("pilot ratio at the boom's head side", STEEP, lowering, "lowering the empty boom"),
)


def sizes(folder: Path) -> Iterator[list[str]]:
    """Each measure with the values of `--set` and with the defaults."""
    system = folder / "harvester.ssp"
    for what, given, measure, text in SIZES:
        options = " ".join(f"`--set {name}={value:g}`" for name, value in given.items())
        yield [what, options, text, measure(system, given), measure(system, {})]


def picture(folder: Path) -> None:
    """Draw the energies of the machine as it is and of the load-sensing machine."""
    today = dict.fromkeys(("swing", "boom_stick"), "compensated") | {"supply": "load_sensing"}
    traces = {
        name: run(load(folder / "harvester.ssp"), swap=swap).trace
        for name, swap in (("lumped", {}), ("load_sensing", today))
    }
    drawn = draw(figure({name: energy(trace, name) for name, trace in traces.items()}))
    (PAGE.parent / "images" / "energy.png").write_bytes(png(drawn))


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
        harvester().write(folder)
        picture(folder)
        fill(PAGE, "circuits", table(CIRCUITS_HEAD, circuits(folder)))
        fill(PAGE, "slewing", table(SLEWING_HEAD, slewing(folder)))
        fill(PAGE, "sizes", table(("size", "other value", "measure", "with it", "default"), sizes(folder)))
        fill(PAGE, "modes", table(("drives", *FAMILIES["manipulator"]), modes(folder)))
        if asked.combinations:
            fill(PAGE, "combinations", combinations(folder, asked.combinations))


if __name__ == "__main__":
    main()
