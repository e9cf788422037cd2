"""False alarms of the diagnosis, and what it finds, with operators and sensors that are drawn apart.

    python -m benchmarks.diagnosis_field [--reserved | --hours N]

Needs `harvester build --faults --fmi 2 --out build/faults`. Plants run in lanes once and are stored in
build/field; readings are made of them in NumPy, so other sensors cost only the run of the diagnosis.

- machines: four kinds of drives and supplies, heads rigid and swinging, valve areas 2.8 to 5.2e-5 m2, dead
  bands 0.3 to 1 V, hysteresis 1 to 8 %, masses 20 % off, oil of -20 to 70 degC, supplies of 160 to 210 bar;
  learned from `LEARNED` of strokes without payload on level ground, then at work on a slope of 0 to 5 degrees
- operators: `STYLES`, each for `WORK` on every machine
- sensors: zeros to 0.5 % of a span of 600 bar, resolutions of 0.1 to 1 bar and of 0.01 to 0.1 degree, 20 to
  100 Hz, delays of 5 to 20 ms
- faults: of parts and of sensors, at `BEGIN` of a recording of strokes

Seeds of machines, work and sensors are drawn apart. Half of the seeds and the styles `RESERVED` were looked
at once, when the diagnosis was done (`--reserved`). An alarm is a repair that is told in a recording.
`--hours` counts alarms on further open machines, `LONGER` of each style, without faults.
"""

from __future__ import annotations

import argparse
import math
from collections import Counter
from dataclasses import replace
from itertools import product
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from benchmarks.diagnosis_machines import AXES, JET, LITRE, PRESSURES, READINGS, VARIANTS, Columns, machine
from fmus.components.chain import gravity_on_slope
from fmus.contract import Quantity, make_group
from fmus.controller.harvester import ARM
from fmus.diagnosis import findings
from fmus.export.build import build
from fmus.machine.parts import feric
from fmus.machine.ssp import section_flows
from fmus.manipulator import MANIPULATOR
from fmus.manipulator import VARIANTS as MANIPULATORS
from fmus.parameters import Number, numbers
from orchestrator.lanes.machines import Machines
from orchestrator.results.diagnosis import Diagnosis, learned_values, over

FOLDER = Path("build/field")
PARTS = Path("build/faults")
STYLES = ("strokes", "slow", "hurried", "tremor", "ends", "one", "slewing", "rest", "loading")
RESERVED = ("hurried", "one")
LEARNED, WORK, LONGER, BROKEN, BEGIN = 180.0, 60.0, 180.0, 50.0, 15.0  # s
EVERY, STEP, LANES = 10, 1e-3, 8  # steps between two points; s; machines at once
OPEN = tuple(s for s in STYLES if s not in RESERVED)
SEEDS, KEPT = range(100, 100 + LANES), range(500, 500 + LANES)  # of machines of each kind; the reserved ones
COMMANDS = tuple(f"{a}_command" for a in AXES)
ROUNDS = 4  # recordings with a fault, another one in each machine
PART_FAULTS: tuple[tuple[str, float, str], ...] = (  # input, size, repair
    ("boom_head_leak", 40e-6, "boom hose"),
    ("stick_rod_leak", 40e-6, "stick hose"),
    ("swing_leak_a", 50e-6, "swing hose"),
    ("stick_head_leak", 3 * LITRE / JET, "stick hose"),
    ("boom_seal_leakage", 3 * LITRE / 1e7, "boom seals"),
    ("boom_driver_loss", 1.0, "boom valve"),
    ("stick_driver_loss", 0.4, "stick valve"),
    ("swing_spool_stuck", 1.0, "swing valve"),
)
SENSOR_FAULTS: tuple[tuple[str, str, float, str], ...] = (  # reading, what it does, size [Pa, rad], repair
    ("supply_pressure", "off", -40e5, "supply pressure sensor"),
    ("boom_head_pressure", "off", 30e5, "pressure sensors"),
    ("swing_pressure_a", "off", 20e5, "swing pressure a sensor"),
    ("tank_pressure", "off", 5e5, "tank pressure sensor"),
    ("boom_angle", "off", np.radians(10), "boom angle sensor"),
    ("stick_head_pressure", "stuck", 0.0, "stick head pressure sensor"),
    ("swing_angle", "stuck", 0.0, "swing angle sensor"),
    ("boom_rod_pressure", "lost", -150e5, "boom rod pressure sensor"),
)
REPAIRS = {n: f.repair for n, f in findings(ARM, MANIPULATOR).items()}


def sloped(kind: str, folder: Path) -> Path:
    """A manipulator whose base is turned by `base_pitch` and `base_roll`."""
    sub = MANIPULATORS[kind]
    turned = {n: Quantity("rad", f"Turn of the base: {n}", 0.1) for n in ("base_pitch", "base_roll")}
    known = numbers(sub)
    values = {n: Number(0.0, "rad", "assumed", "level ground") for n in turned}
    own = make_group("SlopedParameters", turned, sub.parameters)
    model = replace(
        sub.model,
        parameters=own,
        gravity=lambda p: gravity_on_slope(p.gravity, p.base_pitch, p.base_roll),
    )
    made = replace(
        sub,
        **model.declared,
        name=f"manipulator_{kind}",
        values=None,
        numbers={**known, "parameters": {**known["parameters"], **values}},
    )
    return build(made, folder)


def of_machine(seed: int) -> tuple[dict[str, str], dict[str, float]]:
    """Variants and values of a machine; its work is drawn from other numbers."""
    swap, given = machine(seed)
    rng = np.random.default_rng((seed, 1))
    given = {n: v for n, v in given.items() if not n.startswith("sensors.")}
    given["valve_actuation.hysteresis"] = rng.uniform(0.01, 0.08)
    for n, mass in (("boom", 370), ("stick", 350), ("head", 350)):
        given[f"manipulator.{n}_mass"] = mass * rng.uniform(0.8, 1.2)
    given["supply.oil_temperature_start"] = 273.15 + rng.uniform(-20, 70)
    if "supply.pressure_setting" in given:
        given["supply.pressure_setting"] = rng.uniform(160e5, 210e5)
    else:
        given["supply.ambient_temperature"] = given["supply.oil_temperature_start"] - rng.uniform(0, 20)
    for part in ("swing", "boom_stick"):
        for n, low, high in (("valve_dead_band", 0.3, 1.0), ("valve_area", 2.8e-5, 5.2e-5)):
            if f"{part}.{n}" in given:
                given[f"{part}.{n}"] = rng.uniform(low, high)
    slope, way = np.radians(rng.uniform(0, 5)), rng.uniform(0, 2 * np.pi)
    given |= {"manipulator.base_pitch": slope * np.cos(way), "manipulator.base_roll": slope * np.sin(way)}
    return swap, given


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


def work(style: str, seed: int, stop: float) -> Columns:
    """Commands [V] and payload [kg] of an operator, every 10 ms."""
    rng = np.random.default_rng((seed, STYLES.index(style), 2))
    time = EVERY * STEP * np.arange(round(stop / (EVERY * STEP)))
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
    while style in ("loading", "slewing", "hurried") and at < stop:
        held = rng.uniform(6, 20)
        columns["payload_mass"][(time >= at) & (time < at + held)] = rng.uniform(100, 800)
        at += held + rng.uniform(3, 12)
    return columns


def plants(seeds: range, kind: int, healthy: bool = False) -> list[dict[str, Columns]]:
    """What happens in machines of one kind, by recording; simulated if it is not stored.

    healthy   for longer, in open styles, without faults
    """
    file = FOLDER / f"{seeds[0]}_{kind}.npz"
    if not file.exists():
        _simulate(seeds, kind, file, healthy)
    with np.load(file) as stored:
        found = [dict[str, Columns]() for _ in seeds]
        for key in stored.files:
            recording, name = key.split("/")
            for k, row in enumerate(stored[key]):
                found[k].setdefault(recording, {})[name] = row.astype(float)
    return found


def machine_seeds(seeds: range, kind: int) -> list[int]:
    """Of the machines of a kind: their variants follow from them."""
    return [4 * s + kind for s in seeds]


def _simulate(seeds: range, kind: int, file: Path, healthy: bool) -> None:
    own = machine_seeds(seeds, kind)
    given = [of_machine(s) for s in own]
    swap: dict[str, Any] = dict(given[0][0])
    swap["manipulator"] = sloped(swap.get("manipulator", "rigid"), FOLDER)
    names = [n for n in READINGS if not n.startswith(("supply", "tank"))]
    place = {n: "manipulator" if n.endswith(("angle", "speed")) else "boom_stick" for n in names}
    place |= {n: "swing" for n in names if n.startswith("swing_pressure")}
    signals = [f"{place[n]}.{n}" for n in names]
    signals += [f"supply.{n}" for n in ("supply_pressure", "tank_pressure", "oil_temperature")]
    signals += ["manipulator.held_mass"]
    faults = [n for n, *_ in PART_FAULTS]
    commands = [*(f"valve_actuation.{n}" for n in COMMANDS), "payload_mass", *faults]
    machines = Machines(PARTS / "harvester_actuation.ssp", LANES, commands, signals, swap=swap, step=STEP)
    values = {n: np.array([g[n] for _, g in given]) for n in given[0][1]}
    level = values | {n: 0 * v for n, v in values.items() if n.startswith("manipulator.base_")}
    stored = dict[str, Any]()
    styles, length, rounds = (OPEN, LONGER, 0) if healthy else (STYLES, WORK, ROUNDS)
    runs = [("learned", "strokes", LEARNED, 1, None)] + [(s, s, length, 0, None) for s in styles]
    runs += [(f"broken{j}", "strokes", BROKEN, 0, j) for j in range(rounds)]
    for recording, style, stop, shift, fault in runs:
        works = [work(style, s + 100_000 * shift, stop) for s in own]
        tables = np.stack([np.stack([w[n] for n in (*COMMANDS, "payload_mass")], 1) for w in works])
        broken = np.zeros((LANES, len(faults)))
        rows = [machines.start(level if recording == "learned" else values)]
        for i in range(tables.shape[1] - 1):
            if fault is not None and i == round(BEGIN / (EVERY * STEP)):
                for lane in range(LANES):
                    which = (2 * fault + lane) % len(faults)
                    broken[lane, which] = PART_FAULTS[which][1]
            rows.append(machines.advance(np.hstack([tables[:, i], broken]), EVERY))
        table = np.stack(rows, 2)  # lanes, signals, points
        for k, n in enumerate(signals):
            stored[f"{recording}/{n.partition('.')[2]}"] = table[:, k].astype(np.float32)
        for k, n in enumerate(COMMANDS):
            stored[f"{recording}/{n}"] = tables[:, :, k].astype(np.float32)
        print(f"  kind {kind}, {recording}: {np.isfinite(table).all(axis=(1, 2)).sum()} machines", flush=True)
    machines.close()
    FOLDER.mkdir(parents=True, exist_ok=True)
    np.savez(file, **stored)


def sensed(truth: Columns, seed: int, fault: tuple[str, str, float, str] | None = None) -> Columns:
    """Readings of the sensors of a machine; a fault of one begins at `BEGIN`."""
    rng = np.random.default_rng((seed, 3))
    rate, delay = float(rng.choice((100, 50, 50, 20))), rng.uniform(5e-3, 20e-3)
    bar, degree = float(rng.choice((0.1, 0.5, 1.0))) * 1e5, np.radians(rng.choice((0.01, 0.05, 0.1)))
    zeros = {n: rng.uniform(-3e5, 3e5) for n in (*PRESSURES, "supply_pressure", "tank_pressure")}
    noise = np.random.default_rng((seed, 4))
    rows = len(truth["boom_angle"])
    clock = EVERY * STEP * np.arange(rows)
    time = np.arange(0, clock[-1], 1 / rate)
    found = {"time": time}
    for n, values in truth.items():
        if n in ("held_mass", "time"):
            continue
        now = np.interp(time - (0 if n.endswith("command") else delay), clock, values)
        if n.endswith("pressure") or n in PRESSURES:
            now = now + zeros.get(n, 0.0) + noise.normal(0, 1e4, len(now))
        elif n.endswith("speed"):
            now = now + noise.normal(0, 2e-3, len(now))
        late = time >= BEGIN
        if fault and fault[0] == n:
            if fault[1] == "off":
                now = now + fault[2] * late
            else:
                now = np.where(late, now[late.argmax()] if fault[1] == "stuck" else fault[2], now)
        elif n.endswith("pressure") or n in PRESSURES:
            now = np.clip(now, -1e5, 6e7)
        step = bar if "pressure" in n else degree if n.endswith("angle") else 1e-4
        found[n] = now if n == "oil_temperature" else step * np.round(now / step)
    return found


def told(fmu: Path, columns: Columns, swap: dict[str, str], healthy: dict[str, float]) -> Diagnosis:
    """What the FMU tells."""
    own = dict[str, float]()
    if swap.get("boom_stick") == "compensated":
        known = feric(faults=True)
        own = section_flows(known, known.diagnosis)
    signals = {n: v for n, v in columns.items() if n != "time"}
    return over(fmu, columns["time"], signals, set=own | healthy)


def repairs(found: Diagnosis) -> dict[str, tuple[float, str]]:
    """Told repairs: since when [s], and by which finding."""
    first = dict[str, tuple[float, str]]()
    for f in found.findings:
        if f.broken:
            first[f.repair] = min(first.get(f.repair, (np.inf, "")), (f.since, f.name))
    return first


def main() -> None:
    """Count alarms by style, and what is named of the faults."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--reserved", action="store_true", help="the other seeds, and the styles kept back")
    parser.add_argument("--hours", type=float, default=0.0, help="of healthy work of further open machines")
    parser.add_argument("--machines", type=int, default=LANES, help="of each kind")
    parser.add_argument("--kinds", type=int, nargs="*", default=range(len(VARIANTS)))
    parser.add_argument("--fmu", type=Path, default=PARTS / "diagnosis.fmu")
    parser.add_argument("--no-faults", action="store_true")
    parser.add_argument("--verbose", action="store_true")
    given, begin = parser.parse_args(), perf_counter()
    seeds = KEPT if given.reserved else SEEDS
    styles = STYLES if given.reserved else OPEN
    a_group = LANES * len(OPEN) * LONGER / 3600  # h
    further = range(1, 1 + math.ceil(given.hours / a_group / max(len(given.kinds), 1)))
    groups = [range(seeds[0] + LANES * k, seeds[0] + LANES * (k + 1)) for k in further] or [seeds]
    alarms, by_repair, hours = Counter[str](), Counter[str](), Counter[str]()
    named, payload = dict[str, list[tuple[str, float]]](), list[tuple[bool, bool]]()
    for kind, group in product(given.kinds, groups):
        for lane, truth in enumerate(plants(group, kind, given.hours > 0)[: given.machines]):
            seed = machine_seeds(group, kind)[lane]
            swap, _ = of_machine(seed)
            healthy = learned_values(told(given.fmu, sensed(truth["learned"], seed), swap, {}))
            for style in styles:
                if not np.isfinite(truth[style]["boom_angle"]).all():
                    continue
                found = told(given.fmu, sensed(truth[style], seed), swap, healthy)
                some = repairs(found)
                if truth[style]["oil_temperature"].max() > 348:
                    some.pop("cooler", None)
                alarms[style] += len(some)
                by_repair.update(n for _, n in some.values())
                hours[style] += EVERY * STEP * len(truth[style]["boom_angle"]) / 3600
                if given.verbose and some:
                    print(f"{kind} {seed} {style}: {some}", flush=True)
                payload += weighed(truth[style], found)
            for fault, case, size in [] if given.no_faults or given.hours else cases(truth, lane):
                columns = sensed(case, seed, size)
                some = repairs(told(given.fmu, columns, swap, healthy))
                late = {n: t for n, (t, _) in some.items() if t >= BEGIN - 0.1}
                first = min(late, key=lambda n: late[n]) if late else "nothing"
                named.setdefault(fault[0], []).append((first, late.get(fault[1], np.inf) - BEGIN))
    print(f"\nalarms without a fault, {'reserved' if given.reserved else 'open'} seeds from {seeds[0]}")
    for style in styles:
        print(f"  {style:10}{alarms[style]:5} in {hours[style]:5.2f} h")
    total = sum(hours.values())
    rate = alarms.total() / max(total, 1e-9)
    print(f"  all       {alarms.total():5} in {total:5.2f} h, {rate:.2f} in an hour")
    print("  " + ", ".join(f"{n} {k}" for n, k in by_repair.most_common(20)))
    if payload:
        within, holds = np.mean(payload, axis=0)
        print(f"payload within max(5 kg, 1 %) {within:.0%}, interval holds {holds:.0%} of {len(payload)}")
    for fault, rows in named.items():
        words = ", ".join(f"{n} {k}" for n, k in Counter(n for n, _ in rows).most_common(5))
        times = np.array([t for _, t in rows])
        print(f"  {fault:32} named {np.isfinite(times).sum():3} of {len(rows)}; first: {words}")
    print(f"{perf_counter() - begin:.0f} s")


def cases(truth: dict[str, Columns], lane: int) -> list[tuple[tuple[str, str], Columns, Any]]:
    """Faults of a machine: name and repair, what happens in it, the fault of a sensor."""
    found = list[tuple[tuple[str, str], Columns, Any]]()
    for j in range(ROUNDS):
        columns = truth[f"broken{j}"]
        if np.isfinite(columns["boom_angle"]).all():
            name, _, repair = PART_FAULTS[(2 * j + lane) % len(PART_FAULTS)]
            found.append(((name, repair), columns, None))
    rows = round(BROKEN / (EVERY * STEP))
    short = {n: v[:rows] for n, v in truth["strokes"].items()}
    found += [((f"{f[0]} {f[1]}", f[3]), short, f) for f in SENSOR_FAULTS]
    return found


def weighed(truth: Columns, found: Diagnosis) -> list[tuple[bool, bool]]:
    """5 s after each change: whether the payload is within its bar, and its interval holds."""
    mass = truth["held_mass"]
    moved = np.flatnonzero(np.abs(np.diff(mass)) > 0.5)
    later = [*moved[1:], len(mass)]
    rows = [k + 500 for k, after in zip(moved, later, strict=False) if after - k > 500]
    at = np.asarray(found.result.time)
    size, off = (np.asarray(found.result[f"payload{end}"]) for end in ("", "_deviation"))
    result = list[tuple[bool, bool]]()
    for k in (k for k in rows if k < len(mass)):
        i = min(int(np.searchsorted(at, k * EVERY * STEP)), len(at) - 1)
        error = abs(size[i] - mass[k])
        result.append((bool(error <= max(5.0, 0.01 * mass[k])), bool(error <= 1.96 * off[i])))
    return result


if __name__ == "__main__":
    main()
