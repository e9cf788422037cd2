"""Machines, operators, sensors and faults of `benchmarks.diagnosis`; knows nothing of the diagnosis.

Plants run in lanes once and are stored in build/field; readings are made of them in NumPy, so other sensors
cost no plant. Machines, work and sensors are drawn from seeds apart.

- machines: `VARIANTS` of drives and supplies, heads rigid and swinging, valve areas 2.8 to 5.2e-5 m2, dead
  bands 0.3 to 1 V, hysteresis 1 to 8 %, masses 20 % off, oil of -20 to 70 degC, supplies of 160 to 210 bar;
  learned from `LEARNED` of strokes without payload on level ground, then at work on a slope of 0 to 5 degrees
- operators: `STYLES`, each for `WORK` on every machine
- sensors: zeros to 0.5 % of a span of 600 bar, resolutions of 0.1 to 1 bar and of 0.01 to 0.1 degree, 20 to
  100 Hz, delays of 5 to 20 ms
- faults: `cases`, one in a recording, from `BEGIN` on; all recordings of a machine are of the same work with
  payloads, up to their ends, in one of the styles `BUSY`, and one of them has no fault
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fmus.components.chain import gravity_on_slope
from fmus.components.oil import REFERENCE, kinematic_viscosity
from fmus.contract import Quantity, make_group
from fmus.export.build import build
from fmus.manipulator import VARIANTS as MANIPULATORS
from fmus.parameters import Number, numbers
from orchestrator.lanes.machines import Machines

FOLDER, PARTS = Path("build/field"), Path("build/faults")
LEARNED, WORK, LONGER = 180.0, 60.0, 180.0  # s
BEGIN, BROKEN, WORN, LONG = 15.0, 90.0, 315.0, 1815.0  # s: of a fault; ends of recordings
EVERY, STEP, LANES = 10, 1e-3, 8  # steps between two points; s; machines at once
PERIOD = EVERY * STEP
SEEDS, KEPT = range(100, 100 + LANES), range(500, 500 + LANES)  # of machines of each kind; the reserved ones
AXES = ("swing", "boom", "stick")
COMMANDS = tuple(f"{a}_command" for a in AXES)
SIDES = {"swing": ("leak_a", "leak_b"), "boom": ("head_leak", "rod_leak"), "stick": ("head_leak", "rod_leak")}
OF_CYLINDERS = tuple(f"{a}_{c}_pressure" for a in ("boom", "stick") for c in ("head", "rod"))
PRESSURES = ("swing_pressure_a", "swing_pressure_b", *OF_CYLINDERS)
ANGLES, SPEEDS = tuple(f"{a}_angle" for a in AXES), tuple(f"{a}_speed" for a in AXES)
READINGS = (*PRESSURES, *ANGLES, *SPEEDS, "supply_pressure", "tank_pressure")
LITRE = 1 / 6e4  # L/min in m3/s
JET = 0.62 * np.sqrt(2 * 1e7 / 870)  # m/s, of a leak at 100 bar
DRIVES = ("swing", "boom_stick")
HANGING, PUMP = {"manipulator": "pendulum_friction"}, {"supply": "engine_pump"}
VARIANTS: tuple[dict[str, str], ...] = (
    {"supply": "ideal"},
    dict.fromkeys(DRIVES, "detailed") | HANGING | PUMP,
    dict.fromkeys(DRIVES, "compensated") | HANGING | {"supply": "load_sensing"},
    HANGING | PUMP,
)
BAND = 0.6  # V, dead band of the valves whose opening is a table
# how different a reading is if a fault has an influence on the work; reading of a sensor without connection
SEEN = {"Pa": 2e6, "rad": 0.02, "rad/s": 0.05}
LOST = {"Pa": -150e5, "rad": -20.0, "rad/s": -20.0}
Column = NDArray[np.float64]
Columns = dict[str, Column]


class Case(NamedTuple):
    """A fault of a machine."""

    clock: str  # "safety", "function", "wear"
    fault: str  # input of the plant, or the reading that is wrong
    size: float  # SI; of a reading that is lost: what it reads
    repair: str  # what a mechanic has to do
    part: str = ""  # function whose work shows it; "": any
    does: str = ""  # what a reading does: "off", "stuck", "lost"; "": it is a fault of the plant


def unit(reading: str) -> str:
    """Of a reading."""
    return "Pa" if "pressure" in reading else "rad" if reading.endswith("angle") else "rad/s"


def machine_seeds(seeds: range, kind: int) -> list[int]:
    """Of the machines of a kind: their variants follow from them."""
    return [len(VARIANTS) * s + kind for s in seeds]


def of_machine(seed: int) -> tuple[dict[str, str], dict[str, float]]:
    """Variants and values of a machine; its work is drawn from other numbers."""
    swap, rng = VARIANTS[seed % len(VARIANTS)], np.random.default_rng((seed, 1))
    given = {"valve_actuation.hysteresis": rng.uniform(0.01, 0.08)}
    for n, mass in (("boom", 370), ("stick", 350), ("head", 350)):
        given[f"manipulator.{n}_mass"] = mass * rng.uniform(0.8, 1.2)
    start = given["supply.oil_temperature_start"] = 273.15 + rng.uniform(-20, 70)
    if swap["supply"] == "ideal":
        given["supply.pressure_setting"] = rng.uniform(160e5, 210e5)
    else:
        given["supply.ambient_temperature"] = start - rng.uniform(0, 20)
    for part in DRIVES:
        if part not in swap:  # the openings of other drives are tables
            given[f"{part}.valve_dead_band"] = rng.uniform(0.3, 1.0)
        if swap.get(part) != "compensated":
            given[f"{part}.valve_area"] = rng.uniform(2.8e-5, 5.2e-5)
    slope, way = np.radians(rng.uniform(0, 5)), rng.uniform(0, 2 * np.pi)
    given |= {"manipulator.base_pitch": slope * np.cos(way), "manipulator.base_roll": slope * np.sin(way)}
    return swap, given


def cases(seed: int) -> list[Case]:
    """Faults of a machine, each of another function, side and size; those of the plant first."""
    swap, given = of_machine(seed)
    rng, found = np.random.default_rng((seed, 5)), list[Case]()

    def one(names: Sequence[str]) -> str:
        return str(rng.choice(names))

    def add(clock: str, part: str, fault: str, size: float, repair: str) -> None:
        found.append(Case(clock, f"{part}_{fault}".strip("_"), float(size), f"{part} {repair}".strip(), part))

    def reading(clock: str, names: Sequence[str], does: str, size: float = 0.0) -> None:
        n, way = one(names), 1 if does == "lost" else int(rng.choice((-1, 1)))
        way = 1 if n == "tank_pressure" else way  # it cannot be less by so much: it ends at -1 bar
        size = LOST[unit(n)] if does == "lost" else float(way * size)
        any_of = does == "off" and n in OF_CYLINDERS
        repair = "pressure sensors" if any_of else f"{n.replace('_', ' ')} sensor"
        part = "" if n.startswith(("supply", "tank")) else n.split("_")[0]
        found.append(Case(clock, n, size, repair, part, does))

    a = one(AXES)
    add("safety", a, one(SIDES[a]), rng.uniform(30e-6, 60e-6), "hose")
    add("safety", one(AXES), "spool_stuck", 1.0, "valve")
    add("safety", one(AXES), "driver_loss", 1.0, "valve")
    thick = float(kinematic_viscosity(given["supply.oil_temperature_start"]) / kinematic_viscosity(REFERENCE))
    add("function", one(AXES[1:]), "seal_leakage", rng.uniform(1, 4) * LITRE / 1e7 * thick, "seals")
    a = one(AXES[1:])
    add("function", a, one(SIDES[a]), rng.uniform(1, 4) * LITRE / JET, "hose")
    add("function", one(AXES), "driver_loss", rng.uniform(0.2, 0.5), "valve")
    add("function", one(AXES), "hysteresis_added", rng.uniform(0.05, 0.15), "valve")
    add("wear", "", "pilot_filter_clogging", rng.uniform(1, 5), "pilot filter")
    if swap["supply"] != "ideal":
        add("wear", "", "filter_clogging", rng.uniform(1e8, 3e8), "return filter")
        add("wear", "", "pump_wear", rng.uniform(10, 40) * LITRE / 1e7, "pump")
    if "boom_stick" in swap:
        add("wear", "", "boom_stick_air", rng.uniform(0.03, 0.1), "air")
    reading("safety", READINGS, "lost")
    reading("safety", (*PRESSURES, *ANGLES, *SPEEDS), "stuck")
    reading("function", PRESSURES, "off", rng.uniform(10e5, 30e5))
    reading("function", ("supply_pressure",), "off", rng.uniform(20e5, 60e5))
    reading("function", ("tank_pressure",), "off", rng.uniform(4e5, 8e5))
    reading("function", ANGLES, "off", np.radians(rng.uniform(5, 15)))
    return found


# style: longest stroke [s], least and largest command [V], ramp [s], longest pause [s]
MANNERS = {
    "strokes": (1.6, 1.5, 5.0, 0.4, 3.0),
    "slow": (6.0, 1.2, 2.5, 1.5, 4.0),
    "hurried": (1.0, 6.0, 10.0, 0.08, 0.5),
    "tremor": (2.0, 1.5, 6.0, 0.3, 3.0),
    "ends": (5.0, 4.0, 9.0, 0.3, 2.0),
    "one": (2.0, 1.5, 7.0, 0.3, 2.5),
    "slewing": (3.5, 2.0, 9.0, 0.3, 2.0),
    "rest": (1.5, 1.5, 5.0, 0.4, 30.0),
    "loading": (2.2, 2.0, 8.0, 0.3, 2.0),
}
STYLES = tuple(MANNERS)
OPEN = tuple(s for s in STYLES if s not in ("hurried", "one"))  # the others were kept back
BUSY = tuple(s for s in OPEN if s != "rest")  # 75 s hold 16 s of work or more of each function


def work(style: str, seed: int, stop: float, loads: bool = False) -> Columns:
    """Commands [V] and payload [kg] of an operator at each point; `loads` also where the style has none."""
    rng = np.random.default_rng((seed, STYLES.index(style), 2))
    time = PERIOD * np.arange(round(stop / PERIOD))
    longest, least, most, ramp, pause = MANNERS[style]
    used = {"one": [str(rng.choice(AXES))], "slewing": ["swing"]}.get(style, list(AXES))
    columns = {"time": time, "payload_mass": np.zeros_like(time)}
    for a in AXES:
        lever, at, sign = np.zeros_like(time), rng.uniform(0.5, 3), float(rng.choice((-1, 1)))
        slow = style == "slewing" and a not in used
        while at < stop and (a in used or slow):
            length, rise = rng.uniform(0.3 * longest, longest), ramp * rng.uniform(0.7, 1.5)
            shape = np.clip(np.minimum((time - at) / rise, (at + length - time) / rise), 0, 1)
            stroke = sign * rng.uniform(least, most) * (0.4 if slow else 1.0) * shape
            if style == "tremor":
                frequency, size = rng.uniform(3, 6), rng.uniform(0.3, 1.2)
                stroke += size * shape * np.sin(2 * np.pi * frequency * time)
            lever += stroke
            at, sign = at + length + rng.uniform(0.1 * pause, pause) * (4 if slow else 1), -sign
        columns[f"{a}_command"] = np.clip(lever, -10, 10)
    at = rng.uniform(5, 15)
    while (loads or style in ("loading", "slewing", "hurried")) and at < stop:
        held = rng.uniform(6, 20)
        columns["payload_mass"][(time >= at) & (time < at + held)] = rng.uniform(100, 800)
        at += held + rng.uniform(3, 12)
    return columns


def sloped(kind: str, folder: Path) -> Path:
    """A manipulator whose base is turned by `base_pitch` and `base_roll`."""
    sub = MANIPULATORS[kind]
    turned = {n: Quantity("rad", f"Turn of the base: {n}", 0.1) for n in ("base_pitch", "base_roll")}
    known = numbers(sub)
    values = {n: Number(0.0, "rad", "assumed", "level ground") for n in turned}
    model = replace(
        sub.model,
        parameters=make_group("SlopedParameters", turned, sub.parameters),
        gravity=lambda p: gravity_on_slope(p.gravity, p.base_pitch, p.base_roll),
    )
    own = {**known, "parameters": {**known["parameters"], **values}}
    return build(replace(sub, **model.declared, name=f"manipulator_{kind}", values=None, numbers=own), folder)


def plants(seeds: range, kind: int, what: str) -> Path:
    """File of what happens in machines of one kind; simulated if it is not stored.

    what   "work": each style; "further": the open ones for longer; "faults"; "long": wear for longer
    """
    name = f"{seeds[0]}_{kind}" if what in ("work", "further") else f"{seeds[0]}_{kind}_{what}"
    file = FOLDER / f"{name}.npz"
    if not file.exists():
        _simulate(seeds, kind, what, file)
    return file


def recordings(file: Path, lane: int) -> dict[str, Columns]:
    """What happens in one machine, by recording; without those in which it could not be simulated."""
    found = dict[str, Columns]()
    with np.load(file) as stored:
        for key in stored.files:
            recording, name = key.split("/")
            found.setdefault(recording, {})[name] = stored[key][lane].astype(float)
    return {n: columns for n, columns in found.items() if np.isfinite(columns["boom_angle"]).all()}


def _runs(own: list[int], what: str) -> list[tuple[str, list[Columns], list[Case | None]]]:
    """Recordings: name, work and fault of each machine."""
    none: list[Case | None] = [None] * len(own)
    if what in ("work", "further"):
        styles, stop = (STYLES, WORK) if what == "work" else (OPEN, LONGER)
        learned = [work("strokes", s + 100_000, LEARNED) for s in own]
        return [("learned", learned, none)] + [(n, [work(n, s, stop) for s in own], none) for n in styles]
    whole = [work(BUSY[s // len(VARIANTS) % len(BUSY)], s + 200_000, LONG, loads=True) for s in own]
    of_all = zip(*([c for c in cases(s) if not c.does] for s in own), strict=True)
    runs = [(str(k), [*some], WORN if some[0].clock == "wear" else BROKEN) for k, some in enumerate(of_all)]
    runs = [*runs, ("healthy", none, BROKEN)] if what == "faults" else [r for r in runs if r[2] == WORN]
    ends = [round((LONG if what == "long" else stop) / PERIOD) for *_, stop in runs]
    short = ([{n: c[:k] for n, c in w.items()} for w in whole] for k in ends)
    return [(name, works, some) for (name, some, _), works in zip(runs, short, strict=True)]


def _simulate(seeds: range, kind: int, what: str, file: Path) -> None:
    own = machine_seeds(seeds, kind)
    given, swap = [of_machine(s)[1] for s in own], dict[str, Any](VARIANTS[kind])
    swap["manipulator"] = sloped(swap.get("manipulator", "rigid"), FOLDER / "sloped")
    place = dict.fromkeys((*ANGLES, *SPEEDS), "manipulator") | dict.fromkeys(OF_CYLINDERS, "boom_stick")
    place |= dict.fromkeys(PRESSURES[:2], "swing") | dict.fromkeys(READINGS[-2:], "supply")
    place |= {"oil_temperature": "supply", "held_mass": "manipulator"}
    signals = [f"{place[n]}.{n}" for n in (*READINGS, "oil_temperature", "held_mass")]
    runs = _runs(own, what)
    faults = sorted({c.fault for _, _, some in runs for c in some if c})
    commands = [*(f"valve_actuation.{n}" for n in COMMANDS), "payload_mass", *faults]
    machines = Machines(PARTS / "harvester_actuation.ssp", LANES, commands, signals, swap=swap, step=STEP)
    values = {n: np.array([g[n] for g in given]) for n in given[0]}
    level = values | {n: 0 * v for n, v in values.items() if n.startswith("manipulator.base_")}
    stored = dict[str, Any]()
    for recording, works, some in runs:
        tables = np.stack([np.stack([w[n] for n in (*COMMANDS, "payload_mass")], 1) for w in works])
        broken = np.array([[c.size if c and c.fault == n else 0.0 for n in faults] for c in some])
        rows = [machines.start(level if recording == "learned" else values)]
        for i in range(tables.shape[1] - 1):
            now = broken * (i >= round(BEGIN / PERIOD))
            rows.append(machines.advance(np.hstack([tables[:, i], now]), EVERY))
        table = np.stack(rows, 2)  # lanes, signals, points
        for k, n in enumerate(signals):
            stored[f"{recording}/{n.partition('.')[2]}"] = table[:, k].astype(np.float32)
        for k, n in enumerate(COMMANDS):
            stored[f"{recording}/{n}"] = tables[:, :, k].astype(np.float32)
        print(f"  kind {kind}, {recording}: {np.isfinite(table).all(axis=(1, 2)).sum()} machines", flush=True)
    machines.close()
    FOLDER.mkdir(parents=True, exist_ok=True)
    np.savez(part := file.with_suffix(".part.npz"), **stored)
    part.rename(file)  # whole, or not there


def failed(values: Column, time: Any, case: Case) -> Column:
    """What a sensor with a fault reads."""
    late = time >= BEGIN
    now = {"off": values + case.size, "stuck": values[late.argmax()], "lost": case.size}[case.does]
    return np.where(late, now, values)


def sensed(truth: Columns, seed: int, case: Case | None = None, part: int = 0) -> Columns:
    """Readings of the sensors of a machine; `part`: other noise."""
    rng = np.random.default_rng((seed, 3))
    rate, delay = float(rng.choice((100, 50, 50, 20))), rng.uniform(5e-3, 20e-3)
    bar, degree = float(rng.choice((0.1, 0.5, 1.0))) * 1e5, np.radians(rng.choice((0.01, 0.05, 0.1)))
    zeros = {n: rng.uniform(-3e5, 3e5) for n in (*PRESSURES, "supply_pressure", "tank_pressure")}
    noise = np.random.default_rng((seed, 4, part) if part else (seed, 4))
    clock = PERIOD * np.arange(len(truth["boom_angle"]))
    time = np.arange(0, clock[-1], 1 / rate)
    found = {"time": time}
    for n, values in truth.items():
        if n in ("held_mass", "time"):
            continue
        now = np.interp(time - (0 if n.endswith("command") else delay), clock, values)
        if n in zeros:
            now = now + zeros[n] + noise.normal(0, 1e4, len(now))
        elif n.endswith("speed"):
            now = now + noise.normal(0, 2e-3, len(now))
        wrong = case.does if case and case.fault == n else ""
        if case and wrong in ("off", "stuck"):
            now = failed(now, time, case)
        if n in zeros:
            now = np.clip(now, -1e5, 6e7)  # the range of a sensor that is connected
        if case and wrong == "lost":
            now = failed(now, time, case)
        step = bar if n in zeros else degree if n.endswith("angle") else 1e-4
        found[n] = now if n == "oil_temperature" else step * np.round(now / step)
    return found


def influence(case: Case, truth: Columns, healthy: Columns) -> float:
    """When [s] a fault first shows in a reading; infinite: never. Wear and readings that are off: at once."""
    if case.clock == "wear" or case.does == "off":
        return BEGIN
    clock, first = PERIOD * np.arange(len(truth["boom_angle"])), np.inf
    for n in READINGS:
        now = failed(truth[n], clock, case) if case.does and case.fault == n else truth[n]
        off = np.abs(now - healthy[n][: len(clock)]) > SEEN[unit(n)]
        if off.any():
            first = min(first, float(clock[off.argmax()]))
    return first


def work_until(case: Case, truth: Columns, given: dict[str, float]) -> Column:
    """Work [s] until each point: with the lever of its function, or of any, beyond its dead band."""
    parts = {a: DRIVES[a != "swing"] for a in ([case.part] if case.part else AXES)}
    bands = {f"{a}_command": given.get(f"{part}.valve_dead_band", BAND) for a, part in parts.items()}
    moves = np.any([np.abs(truth[n]) > band for n, band in bands.items()], axis=0)
    return np.asarray(PERIOD * np.cumsum(moves))
