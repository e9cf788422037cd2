"""Recordings of machines, healthy and with one fault each, for `benchmarks.diagnosis`.

This file knows nothing of the diagnosis. The machines are not those that the diagnosis knows: other drives,
friction and a head that swings, masses 10 % off, payloads up to 800 kg, valves of other size and dead band,
with hysteresis of 2 to 6 %, pressures with zeros 0.3 bar off, buses of 5 to 20 ms, oil that starts between
-10 and 60 degC, a supply of 150 to 210 bar. The base of the crane is rigid; no variant has an elastic one.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orchestrator import run

SYSTEM = "build/faults/harvester_sensors.ssp"
STEP, LEVER_STEP = 0.01, 0.02  # s, of the recordings, of the levers
LEARNED, HEALTHY = 180.0, 600.0  # s: length of the recordings
LONG = 7200.0  # s, of the work in which wear is to be told
BEGIN = 40.0  # s, of a fault
FURTHER = 100  # first part of further healthy recordings
LEARNING = 1  # shift of the work from which a machine is learned
AXES = ("swing", "boom", "stick")
SIDES = {"swing": ("leak_a", "leak_b"), "boom": ("head_leak", "rod_leak"), "stick": ("head_leak", "rod_leak")}
OF_CYLINDERS = tuple(f"{a}_{c}_pressure" for a in ("boom", "stick") for c in ("head", "rod"))
PRESSURES = ("swing_pressure_a", "swing_pressure_b", *OF_CYLINDERS)
ANGLES = tuple(f"{a}_angle" for a in AXES)
SPEEDS = tuple(f"{a}_speed" for a in AXES)
READINGS = (*PRESSURES, *ANGLES, *SPEEDS, "supply_pressure", "tank_pressure")
LITRE = 1 / 6e4  # L/min in m3/s
JET = 0.62 * np.sqrt(2 * 1e7 / 870)  # m/s, of a leak at 100 bar
VARIANTS: tuple[dict[str, str], ...] = (
    {"supply": "ideal"},
    {
        "swing": "detailed",
        "boom_stick": "detailed",
        "manipulator": "pendulum_friction",
        "supply": "engine_pump",
    },
    {
        "swing": "compensated",
        "boom_stick": "compensated",
        "manipulator": "pendulum_friction",
        "supply": "load_sensing",
    },
    {"manipulator": "pendulum_friction", "supply": "engine_pump"},
)
# how different a reading is if a fault has an influence on the work
SEEN = {"Pa": 2e6, "rad": 0.02, "rad/s": 0.05}
Columns = dict[str, NDArray[np.float64]]


@dataclass(frozen=True)
class Case:
    """A machine with at most one fault.

    clock    "safety", "function", "wear"; "" of a healthy machine
    repair   what a mechanic has to do
    """

    seed: int
    swap: dict[str, str]
    set: dict[str, float]
    clock: str = ""
    fault: str = ""
    size: float = 0.0
    repair: str = ""
    stop: float = HEALTHY
    part: int = 0

    def leakage(self, temperature: float) -> float:
        """Past seals [m3/(s.Pa)] at a temperature [K]."""
        return float(self.size * viscosity(333.15) / viscosity(temperature))

    @property
    def loss(self) -> float:
        """Of a leak, at 100 bar and the temperature at which the machine starts [L/min]."""
        if self.fault.endswith("seal_leakage"):
            return self.leakage(self.set["supply.oil_temperature_start"]) * 1e7 / LITRE
        return float(self.size * JET / LITRE)

    @property
    def name(self) -> str:
        """Of the recording."""
        return f"{self.seed}_{self.part}_{self.fault or 'healthy'}{'_long' if self.stop > LONG else ''}"


def viscosity(temperature: float) -> float:
    """Kinematic viscosity [mm2/s] of ISO VG 46 by Walther: 46 at 40 degC, 6.8 at 100 degC."""
    a, b = (np.log10(np.log10(v + 0.7)) for v in (46.0, 6.8))
    share = np.log10(temperature / 313.15) / np.log10(373.15 / 313.15)
    return float(10**10 ** (a + share * (b - a)) - 0.7)


def machine(seed: int) -> tuple[dict[str, str], dict[str, float]]:
    """Variants and values of a machine."""
    rng = np.random.default_rng(seed)
    swap = VARIANTS[seed % len(VARIANTS)]
    given = {
        "valve_actuation.hysteresis": rng.uniform(0.02, 0.06),
        "manipulator.boom_mass": 370 * rng.uniform(0.9, 1.1),
        "manipulator.stick_mass": 350 * rng.uniform(0.9, 1.1),
        "manipulator.head_mass": rng.uniform(300, 400),
        "supply.oil_temperature_start": 273.15 + rng.uniform(-10, 60),
        "supply.pressure_setting": rng.uniform(150e5, 210e5),
        **{f"sensors.{n}_bias": rng.uniform(-3e4, 3e4) for n in PRESSURES},
        "sensors.seed": float(seed % 1000),
        "sensors.pressure_delay": rng.uniform(5e-3, 20e-3),
    }
    given |= {"sensors.angle_lowest": -100.0, "sensors.angle_highest": 100.0}  # encoders that count turns
    given["sensors.angle_delay"] = given["sensors.turning_delay"] = given["sensors.pressure_delay"]
    for part in ("swing", "boom_stick"):
        band, area = rng.uniform(0.4, 0.8), rng.uniform(3.2e-5, 4.8e-5)
        if part not in swap:  # the openings of other drives are tables
            given[f"{part}.valve_dead_band"] = band
        if swap.get(part) != "compensated":
            given[f"{part}.valve_area"] = area
    if swap["supply"] != "ideal":
        given.pop("supply.pressure_setting")
        given["supply.ambient_temperature"] = given["supply.oil_temperature_start"] - rng.uniform(0, 20)
    return swap, given


def work(seed: int, stop: float, shift: int = 0) -> Columns:
    """Strokes to and fro with pauses, of one of three operators, and payloads; the same up to any end."""
    parts = [_part(seed, shift + 1000 * k) for k in range(int(stop / HEALTHY) + 1)]
    columns = {n: np.concatenate([part[n] for part in parts]) for n in parts[0] if n != "time"}
    columns["time"] = LEVER_STEP * np.arange(len(columns["payload_mass"]))
    return {n: c[columns["time"] <= stop + 0.01] for n, c in columns.items()}


def _part(seed: int, shift: int) -> Columns:
    """Ten minutes of it."""
    rng, stop = np.random.default_rng((seed, shift, 7)), HEALTHY
    time = LEVER_STEP * np.arange(round(stop / LEVER_STEP))
    columns = {"time": time}
    longest, strongest, pause = ((1.6, 4.0, 5.0), (2.5, 6.0, 2.5), (1.2, 9.5, 1.5))[seed % 3]
    for axis in AXES:
        command, begin, sign = np.zeros_like(time), rng.uniform(0.5, 2), 1.0
        while begin < stop - 1:
            length, rise = rng.uniform(0.5, longest), rng.uniform(0.1, 0.6)
            shape = np.clip(np.minimum((time - begin) / rise, (begin + length - time) / rise), 0, 1)
            command += sign * rng.uniform(1.5, strongest) * shape
            begin, sign = begin + length + rng.uniform(0.3, pause), -sign
        columns[f"{axis}_lever"] = command
    payload, at = np.zeros_like(time), rng.uniform(15, 30)
    while at < stop and shift != LEARNING:  # a machine is learned without payload
        held = rng.uniform(8, 30)
        payload[(time >= at) & (time < at + held)] = rng.uniform(100, 800)
        at += held + rng.uniform(5, 30)
    columns["payload_mass"] = payload
    return columns


def cases(seed: int) -> list[Case]:
    """A machine while it is learned, healthy, and with each kind of fault."""
    swap, given = machine(seed)
    rng = np.random.default_rng(seed + 3_000_000)
    found = [Case(seed, swap, given, stop=LEARNED), Case(seed, swap, given, part=1)]

    def add(clock: str, fault: str, size: float, repair: str, after: float) -> None:
        found.append(Case(seed, swap, given, clock, fault, size, repair, BEGIN + after, len(found)))

    def axis() -> str:
        return str(rng.choice(AXES))

    a = axis()
    add("safety", f"{a}_{rng.choice(SIDES[a])}", rng.uniform(30e-6, 60e-6), f"{a} hose", 20)
    a = axis()
    add("safety", f"{a}_spool_stuck", 1.0, f"{a} valve", 20)
    a = axis()
    add("safety", f"{a}_driver_loss", 1.0, f"{a} valve", 20)
    signal = str(rng.choice(READINGS))
    add("safety", f"{signal}_lost", 1.0, f"{signal} sensor", 20)
    signal = str(rng.choice([*PRESSURES, *ANGLES, *SPEEDS]))
    add("safety", f"{signal}_stuck", 1.0, f"{signal} sensor", 20)
    a, loss = str(rng.choice(("boom", "stick"))), rng.uniform(1, 4) * LITRE
    thick = viscosity(given["supply.oil_temperature_start"]) / viscosity(333.15)
    add("function", f"{a}_seal_leakage", loss / 1e7 * thick, f"{a} seals", 60)
    a = str(rng.choice(("boom", "stick")))
    add("function", f"{a}_{rng.choice(SIDES[a])}", rng.uniform(1, 4) * LITRE / JET, f"{a} hose", 60)
    a = axis()
    add("function", f"{a}_driver_loss", rng.uniform(0.2, 0.5), f"{a} valve", 60)
    a = axis()
    add("function", f"{a}_hysteresis_added", rng.uniform(0.05, 0.15), f"{a} valve", 60)
    signal = str(rng.choice(PRESSURES[2:]))
    add("function", f"{signal}_bias", rng.choice((-1, 1)) * rng.uniform(10e5, 30e5), "pressure sensors", 60)
    add("wear", "pilot_filter_clogging", rng.uniform(1, 5), "pilot filter", 300)
    if swap["supply"] != "ideal":
        add("wear", "filter_clogging", rng.uniform(1e8, 3e8), "return filter", 300)
        add("wear", "pump_wear", rng.uniform(10, 40) * LITRE / 1e7, "pump", 300)
    if swap.get("boom_stick") in ("detailed", "compensated"):
        add("wear", "boom_stick_air", rng.uniform(0.03, 0.1), "air", 300)
    return found


def further(seed: int, count: int) -> list[Case]:
    """More recordings of a healthy machine, each with other work."""
    swap, given = machine(seed)
    return [Case(seed, swap, given, part=FURTHER + k) for k in range(count)]


def recorded(case: Case, folder: Path) -> Path:
    """The recording of a case, made if it is not there."""
    file = folder / f"{case.name}.npz"
    if file.exists():
        return file
    fault: Any = {case.fault: f"{case.size}@{BEGIN:g}s"} if case.fault else {}
    signals = [*(f"sensors.{n}_measured" for n in READINGS), *(f"controller.{a}_command" for a in AXES)]
    # all cases of a machine have the same work, but the one that it is learned from and further healthy ones
    shift = LEARNING if case.part == 0 else case.part if case.part >= FURTHER else 0
    levers = work(case.seed, case.stop, shift)
    result = run(
        SYSTEM,
        levers,
        stop=case.stop,
        swap=case.swap,
        set=case.set,
        fault=fault,
        record=[*signals, "supply.oil_temperature", "manipulator.held_mass"],
        record_step=STEP,
        step=1e-3,
        guard=0.0,  # equal steps
        yes=True,
    )
    columns: dict[str, Any] = {"time": np.asarray(result.time)}
    for n in signals:
        columns[n.partition(".")[2].removesuffix("_measured")] = np.asarray(result[n])
    columns["oil_temperature"] = np.asarray(result["supply.oil_temperature"])
    columns["held_mass"] = np.asarray(result["manipulator.held_mass"])
    np.savez(file, **columns)
    return file


def influence(case: Case, columns: Columns, healthy: Columns) -> float:
    """When [s] a fault first shows in a reading; infinite: never. Wear and the bias of a sensor: at once."""
    if case.fault.endswith("_bias") or case.clock == "wear":
        return BEGIN
    rows, first = len(columns["time"]), np.inf
    for n in READINGS:
        seen = SEEN["Pa" if "pressure" in n else "rad" if n.endswith("angle") else "rad/s"]
        off = np.abs(columns[n] - healthy[n][:rows]) > seen
        if off.any():
            first = min(first, float(columns["time"][off.argmax()]))
    return first
