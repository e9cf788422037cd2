"""The hydraulic circuits on the work cycle, for the tables of docs/machine.md (`python docs/machine.py`).

Energy is that which flows out of the supply line, the integral of pressure times flow. The pressure is the
highest one in any chamber or line of the drives. Ringing is the rms speed of the boom joint in the pauses of
the work cycle, when all levers have been in neutral for at least 0.6 s. The boom mode is that of the machine
linearised in such a pause.
"""

from __future__ import annotations

import csv
import itertools
from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from fmus.contract import quantities
from fmus.machine.parts import FAMILIES
from fmus.operator_input.work_cycle import WORK_CYCLE
from orchestrator import Problem, Trace, linearize, load, run
from orchestrator.base.files import VARIANTS

STEP = 1e-3  # s
SETTLED = 0.6  # s after the last stroke
PAUSE = 9.9  # s, 1.7 s after the last stroke
BOOM = frozenset({"boom_speed", "boom_angle"})  # main states of the mode of the boom on its oil
CIRCUITS: tuple[Mapping[str, str], ...] = (
    {},
    {"supply": "engine_pump"},
    {"supply": "load_sensing"},
    {"swing": "detailed", "boom_stick": "detailed", "supply": "engine_pump"},
    {"swing": "compensated", "boom_stick": "compensated"},
    {"swing": "compensated", "boom_stick": "compensated", "supply": "engine_pump"},
    {"swing": "compensated", "boom_stick": "compensated", "supply": "load_sensing"},
)
PRESSURES = {
    part: sorted(
        {
            name
            for sub in FAMILIES[part].values()
            for name, q in quantities(sub.outputs).items()
            if q.unit == "Pa" and "load" not in name and "rate" not in name and "modulus" not in name
        }
    )
    for part in ("swing", "boom_stick")
}


def usual(chosen: Mapping[str, str]) -> dict[str, str]:
    """All parts with their variants."""
    return {part: chosen.get(part, next(iter(variants))) for part, variants in FAMILIES.items()}


def swaps(folder: Path, chosen: Mapping[str, str]) -> dict[str, Path]:
    """Files of the variants that are not the usual ones."""
    return {
        part: folder / VARIANTS / f"{part}_{variant}.fmu"
        for part, variant in chosen.items()
        if variant != next(iter(FAMILIES[part]))
    }


def pauses(sampled: np.ndarray) -> np.ndarray:
    """Samples at which all levers have been in neutral for SETTLED."""
    rest = np.ones(sampled.size, bool)
    for move in WORK_CYCLE:
        end = move.start + move.rise + move.hold + move.fall
        rest &= (sampled < move.start) | (sampled > end + SETTLED)
    return rest & (sampled > WORK_CYCLE[0].start)


def measure(folder: Path, chosen: Mapping[str, str]) -> dict[str, Any]:
    """One work cycle with these variants."""
    try:
        trace = run(load(folder / "harvester.ssp"), swap=swaps(folder, chosen), step=STEP).trace
    except Problem as problem:
        return {"failure": str(problem).splitlines()[0]}
    t = trace.time
    pressure = {
        part: max(float(trace[f"{part}.{n}"].max()) for n in names if f"{part}.{n}" in trace.signals)
        for part, names in PRESSURES.items()
    }
    power = trace["supply.supply_pressure"] * trace["supply.supply_flow"]
    travel = sum(
        float(np.abs(np.diff(trace[f"manipulator.{axis}_position"])).sum()) for axis in ("boom", "stick")
    )
    ringing = trace["manipulator.boom_speed"][pauses(t)]
    return {
        "energy": float(np.trapezoid(power, t)),
        "engine": float(np.trapezoid(trace["supply.engine_power"], t)),
        "travel": travel,
        "turn": float(np.abs(np.diff(trace["manipulator.swing_angle"])).sum()),
        "boom_stick_pressure": pressure["boom_stick"],
        "swing_pressure": pressure["swing"],
        "ringing": float(np.sqrt(np.mean(ringing**2))),
    }


def boom_mode(folder: Path, chosen: Mapping[str, str]) -> tuple[float, float]:
    """Frequency [Hz] and damping ratio of the least damped mode in which the boom takes part, up to PAUSE.

    Means of four instants of a period: where air makes the oil stiffer with pressure, a boom that still rings
    has another damping in each.
    """

    def at(time: float) -> tuple[float, float]:
        model = linearize(folder / "harvester.ssp", swap=swaps(folder, chosen), time=time, step=STEP)
        modes = [m for m in model.modes if 1 < m.frequency < 7 and not BOOM.isdisjoint(m.main_states)]
        least = min(modes, key=lambda m: m.damping)
        return float(least.frequency), float(least.damping)

    found = [at(PAUSE)]
    period = 1 / found[0][0]
    found += [at(round(PAUSE - k * period / 4, 3)) for k in (1, 2, 3)]
    return float(np.mean([f for f, _ in found])), float(np.mean([d for _, d in found]))


def circuits(folder: Path) -> Iterator[list[str]]:
    """Rows of the first table."""
    for chosen in CIRCUITS:
        m, (frequency, damping) = measure(folder, usual(chosen)), boom_mode(folder, usual(chosen))
        names = usual(chosen)
        yield [
            names["boom_stick"],
            names["supply"],
            f"{m['energy'] / 1e3:.0f}",
            f"{m['engine'] / 1e3:.0f}",
            f"{m['travel']:.2f}",
            f"{m['turn']:.2f}",
            f"{m['boom_stick_pressure'] / 1e5:.0f}",
            f"{m['swing_pressure'] / 1e5:.0f}",
            f"{frequency:.1f}",
            f"{damping * 100:.1f}",
            f"{m['ringing'] * 1e3:.2f}",
        ]


CIRCUITS_HEAD = (
    *("drives", "supply", "from the supply line [kJ]", "from the engine [kJ]"),
    *("travel of both pistons [m]", "turn [rad]", "highest pressure, boom and stick [bar]"),
    *("highest pressure, swing [bar]", "boom mode [Hz]", "damping [%]", "ringing [mrad/s]"),
)


SLEWING_HEAD = ("swing", "supply", "speed at full command [rpm]")


def slewing(folder: Path) -> Iterator[list[str]]:
    """Steady speed at full command, arm reaching out, by variant of the swing."""
    for variant in FAMILIES["swing"]:
        chosen = usual({"swing": variant, "supply": "load_sensing" if variant == "compensated" else "ideal"})
        t = np.arange(0, 8.001, 0.01)
        system = load(folder / "harvester.ssp")
        command = np.interp(t, [0, 0.5], [0, 10.0])
        result = run(
            system,
            Trace(t, {"swing_command": command}),
            parameters=["reach"],
            swap=swaps(folder, chosen),
            step=STEP,
            stop=8.0,
        )
        speed = result.trace["manipulator.swing_speed"][result.trace.time > 7.0].mean()
        yield [variant, chosen["supply"], f"{speed * 30 / np.pi:.1f}"]


def _combination(arguments: tuple[Path, dict[str, str]]) -> dict[str, Any]:
    folder, chosen = arguments
    return {**chosen, **measure(folder, chosen)}


def combinations(folder: Path, out: Path) -> str:
    """Run every combination of all variants, write one row each, and return a summary as a table."""
    chosen = [
        dict(zip(FAMILIES, variants, strict=True)) for variants in itertools.product(*FAMILIES.values())
    ]
    with ProcessPoolExecutor(2) as pool:
        rows = list(pool.map(_combination, [(folder, c) for c in chosen]))
    for row in rows:
        key = {part: row[part] for part in ("boom_stick", "manipulator")}
        row["frequency"], row["damping"] = _cached_mode(folder, tuple(key.items()))
    names = list(dict.fromkeys(name for row in rows for name in row))
    with out.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, names)
        writer.writeheader()
        writer.writerows(rows)
    good = [row for row in rows if "failure" not in row]
    for row in rows:
        if "failure" in row:
            print(", ".join(row[part] for part in FAMILIES), row["failure"], sep=": ")
    return table(
        (f"{len(good)} of {len(rows)} combinations run", "least", "median", "largest"),
        (
            [text, *(f"{np.quantile([row[name] * scale for row in good], q):.3g}" for q in (0, 0.5, 1))]
            for name, scale, text in SUMMARY
        ),
    )


@cache
def _cached_mode(folder: Path, chosen: tuple[tuple[str, str], ...]) -> tuple[float, float]:
    return boom_mode(folder, usual(dict(chosen)))


SUMMARY = (
    ("energy", 1e-3, "energy from the supply line [kJ]"),
    ("boom_stick_pressure", 1e-5, "highest pressure, boom and stick [bar]"),
    ("swing_pressure", 1e-5, "highest pressure, swing [bar]"),
    ("frequency", 1, "frequency of the boom mode [Hz]"),
    ("damping", 100, "its damping ratio [%]"),
    ("ringing", 1e3, "ringing [mrad/s]"),
)


def table(head: Iterable[str], rows: Iterable[list[str]]) -> str:
    """A table of the documentation."""
    lines = [list(head), ["---"] * len(list(head)), *rows]
    return "\n".join("|" + "|".join(cell or " " for cell in line) + "|" for line in lines)
