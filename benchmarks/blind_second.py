"""A second blind bench for `harvester identify --no-joint`, written from the documents by a second author.

    python -m benchmarks.blind_second [--seed N] [--only FAULT] [--keep DIR]

It shares no equation with the project, only the nominal values in `fmus/*/parameters.toml`, which procedures
take as known. Rows "rig" damage recordings of `harvester rig`. Parameters of the 61 machines are within 30 %
of the nominal ones, zeros of sensors within their declaration. G is a conductance, w the speed of the swing:

- valve: Q = Q_o + G_l dP, K^2 dP = Q_o (Q_o + Q_t), K = C_d A a(V) sqrt(2/rho)
- hose: I dQ/dt = p_in - p_out - H(Q), C dp/dt = Q_in - Q_out, with one or three lumps; H is laminar below
  Re 2300 and Blasius above, or of one law alone
- motor: Q_a = (P_a - P_b) G_in + P_a G_ex + C dP_a/dt, Q_drain = (P_a + P_b) G_ex
- swing: J dw/dt = D (P_1 - P_2) - B w, C dP_a/dt = Q_valve - G (P_a - P_1), G (P_a - P_1) = D w + leakage,
  J about the slewing axis at fixed angles of boom and stick

The bars: 95 % intervals of runs with exit status 0 hold 90 to 98 % of the true values, and none misses by
more than half its width beyond its end. A gain of the flow meter, documented as not detectable, is apart.
Exit status 1: a bar is not met. In the table, a status of -1 is a crash of the command.
"""

from __future__ import annotations

import argparse
import io
import json
import math
import re
import shutil
import sys
import tempfile
import time
import tomllib
from collections.abc import Callable, Iterable
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.signal import lfilter

from orchestrator.__main__ import main as harvester

Array = NDArray[np.float64]
Curve = Callable[[Any], Any]
FMUS = Path(__file__).resolve().parents[1] / "fmus"
FILES = [FMUS / part / "parameters.toml" for part in ("manipulator", "boom_stick", "swing")]
TABLES = [tomllib.loads(file.read_text(encoding="utf-8"))["parameters"] for file in FILES]
NOMINAL: dict[str, float] = {name: entry["value"] for table in TABLES for name, entry in table.items()}
RHO, MU, C_D = NOMINAL["density"], NOMINAL["viscosity"], NOMINAL["valve_discharge_coefficient"]
BAR, LPM, SUPPLY = 1e5, 1e-3 / 60, 206.84e5
LENGTH, BORE, FLOW_0 = 4.0, 0.01905, 170 * LPM  # of the tested hose [m], and the flow of its C_R
FORMS = """line; line; line, meters at rest; line, 50 Hz hum; line, 50 Hz hum; line, 1/f drift;
line, 1/f drift; line, noise below the step; line, hose of three lumps; exponent 0.85; exponent 0.85;
exponent 1.2; exponent 1.2; S-shape; S-shape; two slopes; two slopes; sharp; sharp; one dead band +0.4 V"""
FAULTS = """valve: underlap; valve: underlap, no dead zone; valve: leakage x10;
valve: leakage x10, no dead zone; valve: hysteresis 0.1 V; valve: density declared 870;
valve: density drifts -3 %; valve: pressures swapped;
valve: sign of flow; valve: sign of command; valve+hose: bar declared Pa; valve: one pressure declared psi;
valve+hose+motor+swing: clock skew 0.3 %; valve+hose+motor+swing: 2 % of rows lost;
valve+hose+motor+swing: 2 % of values lost; hose: one logger skewed 0.3 %; hose: one logger 12 ms late;
hose: one logger 2 ms late; hose: Blasius law; hose: square law; hose: oil warms 30 %;
hose: oil warms 30 %, shuffled; motor: oil warms 20 %; motor: turbulent leakage; motor: ports swapped;
motor: sign of flow_a; swing: Coulomb 400 N.m; swing: quadratic friction; swing: inertia +5 %;
swing: pressures 20 ms late; swing: sign of angle; swing: boom and stick angle swapped;
swing: pressures swapped; rig: clean; rig: boom and stick angle swapped; rig: sign of boom angle;
rig: stick angle +2 deg; rig: boom area 1 % off; rig: boom area 5 % off; rig: pressures 20 ms late"""
CLEAN, FAULTY = (tuple(re.split(r";\s+", text)) for text in (FORMS, FAULTS))
CRASH = -1  # in place of an exit status
GAIN = "valve+hose: flow meter gain +2 %"
PRESSURES = "swing.swing_pressure_a", "swing.swing_pressure_b"
BOOM = "boom_stick.boom_head_pressure", "boom_stick.boom_rod_pressure"
ANGLES = "manipulator.swing_angle", "manipulator.boom_angle", "manipulator.stick_angle"
SWAPPED = {
    "valve: pressures swapped": ("pressure_in", "pressure_out"),
    "motor: ports swapped": ("pressure_a", "pressure_b"),
    "swing: pressures swapped": PRESSURES,
    "swing: boom and stick angle swapped": ANGLES[1:],
    "rig: boom and stick angle swapped": ANGLES[1:],
}
FACTORS = {  # of recorded signals
    "valve: sign of flow": {"flow": -1.0},
    "valve: sign of command": {"command": -1.0},
    "motor: sign of flow_a": {"flow_a": -1.0},
    "swing: sign of angle": {ANGLES[0]: -1.0},
    GAIN: {"flow": 1.02, "flow_in": 1.02, "flow_out": 1.02},
    "rig: sign of boom angle": {ANGLES[1]: -1.0},
    "rig: boom area 1 % off": {BOOM[0]: 1 / 1.01, BOOM[1]: 1 / 1.01},
    "rig: boom area 5 % off": {BOOM[0]: 1 / 1.05, BOOM[1]: 1 / 1.05},
}
CLOCKS = {  # delay [s] and rate of these signals; those of the whole logger are ""
    "valve+hose+motor+swing: clock skew 0.3 %": (0.0, 1.003, ("",)),
    "hose: one logger skewed 0.3 %": (0.0, 1.003, ("pressure_out", "flow_out")),
    "hose: one logger 12 ms late": (0.012, 1.0, ("pressure_out", "flow_out")),
    "hose: one logger 2 ms late": (0.002, 1.0, ("pressure_out", "flow_out")),
    "swing: pressures 20 ms late": (0.020, 1.0, PRESSURES),
}


class Sensor(NamedTuple):
    """A sensor with its converter; all numbers but the first are in its unit."""

    si: float
    unit: str
    resolution: float = 0.0
    noise: float = 0.0
    low: float = -math.inf
    high: float = math.inf
    dead_zone: float = 0.0
    zero_error: float = 0.0


def quadratic(y: Any, linear: Any, square: Any = 1.0) -> Any:
    """Q of square Q|Q| + linear Q = y."""
    return 2 * y / (linear + np.sqrt(linear**2 + 4 * square * abs(y)))


def edge_of(area: Any) -> tuple[Any, Any]:
    """K^2 and Q_t of an edge of this area."""
    transition = NOMINAL["valve_transition_reynolds"] * MU / RHO / 2 * np.sqrt(np.pi * (area + 1e-9))
    return 2 / RHO * (C_D * area) ** 2, transition


def staircase(levels: Iterable[float], dwell: float, lag: float) -> tuple[Array, Array, Array]:
    """Times, stepped levels, and what follows them with a lag."""
    step = 2.5e-3
    values: Array = np.repeat(np.array(list(levels), dtype=float), round(dwell / step))
    new = -math.expm1(-step / lag)
    following: Array = lfilter([new], [1, new - 1], values, zi=[(1 - new) * values[0]])[0]
    return step * np.arange(len(values), dtype=float), values, following


def opening(form: str, dead_band: float) -> Curve:
    """The relative opening over the magnitude of the command."""
    shapes: dict[str, Curve] = {
        "exponent 0.85": lambda z: z**0.85,
        "exponent 1.2": lambda z: z**1.2,
        "S-shape": lambda z: 0.55 * z + 0.45 * z**2 * (3 - 2 * z),
        "two slopes": lambda z: np.where(z < 0.4, 0.55 * z, 0.22 + 1.3 * (z - 0.4)),
        "sharp": lambda z: z,
    }
    width, full = NOMINAL["valve_command_rounding"], NOMINAL["valve_full_command"] - dead_band

    def ramp(v: Any) -> Any:
        z = np.clip(v - dead_band, 0, full)
        s = np.minimum(z / width, 1)
        return (width * (s**3 - s**4 / 2) + np.maximum(z - width, 0)) / (full - width / 2)

    return (lambda v: shapes[form](np.clip((v - dead_band) / full, 0, 1))) if form in shapes else ramp


class Machine:
    """A machine with at most one fault; each bench writes recordings and adds the truth."""

    def __init__(self, case: str, folder: Path, random: np.random.Generator) -> None:
        self.case, self.folder, self.random = case, folder, random
        self.form = case if case in CLEAN else "line"
        self.truth, self.zeros = dict[str, float](), dict[str, float]()
        self.curves = dict[str, Curve]()  # of the measured edges
        self.rate, low = float(random.choice([200, 250])), float(random.choice([0.0, -10.0]))
        step, noise = (400 - low) / 4096, 0.02 if "noise below" in case else random.uniform(0.06, 0.15)
        small = (0.0, 0.1) if "no dead zone" in case else (10.0, 0.0)
        gear = Sensor(LPM, "L/min", 10 / 4096, 0.005, -5, 5 - 10 / 4096, 0.0, 0.0125)
        self.sensors = {  # by the first of these that is in a signal's name
            "command": Sensor(1.0, "V"),
            "angle": Sensor(math.pi / 180, "deg", 360 / 65536),
            "pressure": Sensor(BAR, "bar", step, noise, low, 400 - step, 0.0, 1.0),
            "flow_a": gear,
            "drain_flow": gear,
            "flow": Sensor(LPM, "L/min", 600 / 4096, 0.3, -300, 300 - 600 / 4096, *small),
        }

    def near(self, nominal: float) -> float:
        """A true value within 30 % of the nominal one."""
        return nominal * self.random.uniform(0.7, 1.3)

    def sensor(self, name: str) -> Sensor:
        """The instrument of a signal."""
        return next(sensor for key, sensor in self.sensors.items() if key in name)

    def read(self, name: str, values: Array) -> Array:
        """What the logger has of a signal in SI units."""
        one, size = self.sensor(name), len(values)
        zero = self.zeros.setdefault(name, 0.9 * one.zero_error * self.random.uniform(-1, 1))
        reading = values / one.si + zero + one.noise * self.random.normal(size=size)
        if "hum" in self.form:
            phases = 2 * np.pi * (50.01 * np.arange(size) / self.rate + self.random.random())
            reading += 5 * one.noise * np.sin(phases)
        if "drift" in self.form and one.unit == "bar":
            weights = np.maximum(np.arange(size // 2 + 1), 1) ** -0.5
            drift = np.fft.irfft(np.fft.rfft(self.random.normal(size=size)) * weights, size)
            reading += 0.3 * (drift - drift.mean()) / drift.std()
        reading = np.where(abs(reading) <= one.dead_zone, 0, reading)
        reading = one.resolution * np.round(reading / one.resolution) if one.resolution else reading
        return np.clip(reading, one.low, one.high)

    def record(self, name: str, experiment: str, grid: Array, **signals: Array) -> None:
        """Sample, damage and write one recording; a double underscore in a name is a dot."""
        delay, rate, concerned = CLOCKS.get(self.case, (0.0, 1.0, ()))
        logger = np.arange(0, grid[-1] / rate, 1 / self.rate)
        columns, lines = {"t": logger}, [f"[experiment]\n{experiment}\n\n[time]\ncolumn = 't'\n"]
        for signal, values in ((key.replace("__", "."), values) for key, values in signals.items()):
            times = rate * logger - delay if signal in concerned or "" in concerned else logger
            held = values[np.searchsorted(grid, times, "right") - 1]  # no values between steps of a command
            sampled = held if signal == "command" else np.interp(times, grid, values)
            columns[signal] = self.read(signal, FACTORS.get(self.case, {}).get(signal, 1.0) * sampled)
            one = self.sensor(signal)._asdict()
            changed = "declared Pa" in self.case or ("psi" in self.case and signal == "pressure_in")
            one["unit"] = self.case.split()[-1] if changed and one["unit"] == "bar" else one["unit"]
            lines.append(f'[signals."{signal}"]\nunit = "{one["unit"]}"')
            keys = [key for key in ("noise", "resolution", "dead_zone", "zero_error") if one[key]]
            lines += [f"{key} = {one[key]:.12g}" for key in keys]
            lines += [f"span = [{one['low']:.12f}, {one['high']:.12f}]"] if one["high"] < math.inf else []
        first, second = SWAPPED.get(self.case, ("", ""))
        if first in columns:
            columns[first], columns[second] = columns[second], columns[first]
        table = np.column_stack(list(columns.values()))
        table = table[self.random.random(len(table)) > (0.02 if "rows lost" in self.case else 0)]
        if "values lost" in self.case:
            table[:, 1:][self.random.random((len(table), len(columns) - 1)) < 0.02] = np.nan
        np.savetxt(self.folder / f"{name}.csv", table, "%.10g", ",", header=",".join(columns), comments="")
        (self.folder / f"{name}.toml").write_text("\n".join(lines), encoding="utf-8")

    def rest(self) -> None:
        """All pressures without load; the small meters, too, in one form."""
        names = ["pressure_in", "pressure_out", "pressure_a", "pressure_b", *PRESSURES]
        names += ["flow_a", "drain_flow"] if "at rest" in self.form else []
        self.record("rest", 'procedure = "rest"', np.array([0.0, 10.0]), **dict.fromkeys(names, np.zeros(2)))

    def valve(self) -> None:
        """Two edges at a staircase of commands."""
        area, dead_band = self.near(NOMINAL["valve_area"]), self.near(NOMINAL["valve_dead_band"])
        form, dead_band = ("sharp", -0.8) if "underlap" in self.case else (self.form, dead_band)
        fine, coarse = self.random.choice([0.2, 0.25]), self.random.choice([0.5, 0.75])
        up = [*np.arange(0, 2 + fine / 2, fine), *np.arange(2 + coarse, 10, coarse), 10.0, 10.0]
        play, felt, command = 0.05 if "hysteresis" in self.case else 0.0, [0.0], up + up[::-1]
        for level in command:
            felt.append(min(max(felt[-1], level - play), level + play))
        dwell = self.random.uniform(1.2, 2)
        leakage = NOMINAL["valve_leakage"] * (10 if "x10" in self.case else 1)
        for number, edge in enumerate([("P-A", "B-T"), ("A-T", "P-B")][self.random.integers(2)]):
            later = 0.4 if "one dead" in form and number else 0.0
            curve = self.curves[edge] = opening(form, dead_band + later)
            _, volts, _ = staircase(command, dwell, 0.02)
            grid, _, spool = staircase(felt[1:], dwell, 0.02)
            k2, transition = edge_of(area * curve(spool))
            k2 = k2 / (1 - 0.03 * grid / grid[-1]) if "drifts" in self.case else k2
            full = min((self.random.uniform(180, 250) * LPM) ** 2 / np.max(k2), 140 * BAR)
            outer, part = self.random.uniform(20, 40) * BAR * curve(spool) ** 2, self.random.random()
            pressure = full + 40 * BAR - outer  # of the source, less what its lines take
            flow = quadratic(k2 * pressure, transition) + leakage * pressure
            sides = {"pressure_in": 5 * BAR + pressure + part * outer, "pressure_out": 5 * BAR + part * outer}
            signed = volts if edge in ("P-A", "B-T") else -volts
            oil = '\ndensity = { value = 870.0, unit = "kg/m3" }' if "870" in self.case else ""
            text = f'procedure = "valve"\nedge = "{edge}"{oil}'
            self.record(f"valve_{number}", text, grid, command=signed, flow=flow, **sides)
        self.truth["valve_area"] = area
        if "one dead" not in form:
            self.truth["valve_dead_band"] = dead_band
        if form.startswith(("line", "sharp")):
            rounding = NOMINAL["valve_command_rounding"] if form != "sharp" else 0.0
            self.truth["dead_band + rounding/2"] = dead_band + rounding / 2

    def law(self, c_r: float, thinner: Any = 1.0) -> Curve:
        """H(Q) of the hose; `thinner` is the viscosity over that of the start."""
        critical = 2300 * math.pi / 4 * MU / RHO * BORE * thinner
        laminar = 128 * MU * thinner * LENGTH / (math.pi * BORE**4)

        def drop(flow: Any) -> Any:
            power = 0.0 if "square" in self.case else 0.25
            turbulent = c_r * flow * abs(flow) * (thinner * FLOW_0 / (abs(flow) + 1e-9)) ** power
            share = 1.0 if "law" in self.case else 1 - 1 / (1 + (abs(flow) / critical) ** 8)
            return (1 - share) * laminar * flow + share * turbulent

        return drop

    def hose(self) -> None:
        """Resistance by steady flows, then two groups of fast changes."""
        area = math.pi / 4 * BORE**2
        c_r = self.near(NOMINAL["hose_reference_resistance"] * (MU / 8e-3) ** 0.25)
        inertance = self.near(RHO * LENGTH / area)
        capacitance = self.near(area * LENGTH / NOMINAL["bulk_modulus"])
        true = {"resistance": c_r, "inertance": inertance, "capacitance": capacitance}
        self.truth |= {f"boom_stick.stick_hose_{key}": value for key, value in true.items()}
        levels = np.arange(20, 281, self.random.choice([10.0, 13.0])) * LPM
        if "shuffled" in self.case or ("warms" not in self.case and self.random.random() < 0.3):
            self.random.shuffle(levels)
        grid, _, flow = staircase([0, *levels], 2.0, 0.1)
        thinner = 1 - 0.3 * grid / grid[-1] if "warms" in self.case else 1.0
        outlet = 5 * BAR + self.random.uniform(15, 40) * BAR * (flow / (280 * LPM)) ** 2
        inlet = outlet + self.law(c_r, thinner)(flow)
        size = f'length = {{ value = {LENGTH}, unit = "m" }}\ndiameter = {{ value = {BORE}, unit = "m" }}'
        text = f'procedure = "hose_resistance"\n{size}'
        self.record("hose_resistance", text, grid, pressure_in=inlet, pressure_out=outlet, flow=flow)
        for group in range(2):
            times, signals = self.fast_changes(self.law(c_r), inertance, capacitance)
            self.record(f"hose_dynamics_{group}", f'procedure = "hose_dynamics"\n{size}', times, **signals)

    def fast_changes(
        self, law: Curve, inertance: float, capacitance: float
    ) -> tuple[Array, dict[str, Array]]:
        """A hose between a valve that moves fast and a throttle."""
        corners = [(-1.0, 0.3)]
        while corners[-1][0] < 20:
            start = corners[-1][0] + self.random.uniform(0.25, 0.6)
            level = self.random.uniform(*((0.65, 1.0) if len(corners) % 4 == 1 else (0.25, 0.4)))
            corners += [(start, corners[-1][1]), (start + self.random.uniform(0.06, 0.1), level)]
        valve = RHO / 2 / (C_D * 3.2e-5) ** 2  # C_R of the open valve
        throttle = self.random.uniform(55, 75) * BAR / (200 * LPM) ** 2
        parts = np.array([1, 2, 2, 1]) / 6 if "three lumps" in self.form else np.array([0.998, 0.002])
        lumps = len(parts) - 1

        def ends(t: Any, first: Any, last: Any) -> tuple[Any, Any]:
            area = np.interp(t, *np.transpose(corners))
            return SUPPLY - valve / area**2 * first * abs(first), 2 * BAR + throttle * last * abs(last)

        def rhs(t: float, y: Array) -> Array:
            flows = y[: lumps + 1]
            inlet, outlet = ends(t, flows[0], flows[-1])
            pressures = np.concatenate([[inlet], BAR * y[lumps + 1 :], [outlet]])
            speeds = (-np.diff(pressures) / parts - law(flows)) / inertance
            return np.concatenate([speeds, -np.diff(flows) * lumps / capacitance / BAR])

        grid = np.arange(0, 20, 5e-4)
        begin = [70 * LPM] * (lumps + 1) + [12.0] * lumps
        options: dict[str, Any] = {"rtol": 1e-7, "atol": 1e-9, "max_step": 0.02}
        y = solve_ivp(rhs, (-1, 20), begin, "LSODA", grid, **options).y
        inlet, outlet = ends(grid, y[0], y[lumps])
        return grid, {"pressure_in": inlet, "pressure_out": outlet, "flow_in": y[0], "flow_out": y[lumps]}

    def motor(self) -> None:
        """The locked swing motor with the pressure stepped at one port, then at the other."""
        names = "internal_leakage_resistance", "external_leakage_resistance"
        self.truth |= {name: self.near(NOMINAL[name]) for name in names}
        up = np.linspace(20, 195, 10) * BAR
        for port in range(2):
            grid, _, moving = staircase([*up, *up[::-1]], 2.5, 0.15)
            _, _, still = staircase([20 * BAR] * 10 + [self.random.uniform(60, 100) * BAR] * 10, 2.5, 0.15)
            p_a, p_b = (still, moving) if port else (moving, still)
            warm = 1 - 0.1 * (grid / grid[-1] + port) if "warms" in self.case else 1.0
            inner, outer = (self.truth[name] * warm for name in names)
            square = 0.5 * inner**2 / (100 * BAR) if "turbulent" in self.case else 1e-9
            flow = quadratic(p_a - p_b, inner, square) + p_a / outer + 3e-13 * np.gradient(p_a, grid)
            flows = {"flow_a": flow, "drain_flow": (p_a + p_b) / outer}
            text = 'procedure = "motor_leakage"\nshaft = "locked"'
            self.record(f"motor_{port}", text, grid, pressure_a=p_a, pressure_b=p_b, **flows)

    def swing(self) -> None:
        """The arm turns back and forth in two poses, boom and stick held still."""
        self.truth["swing_damping"] = self.near(NOMINAL["swing_damping"])
        for number in range(2):
            boom, stick = self.random.uniform(0.1, 0.6), self.random.uniform(-2.0, -1.2)
            grid, angle, p_a, p_b = self.turned(boom, boom + stick)
            held = [np.full(len(grid), value) for value in (boom, stick)]
            signals = dict(zip((*PRESSURES, *ANGLES), (p_a, p_b, angle, *held), strict=True))
            self.record(f"swing_{number}", 'procedure = "damping"\njoint = "swing"', grid, **signals)

    def turned(self, boom: float, pitch: float) -> tuple[Array, Array, Array, Array]:
        """Times, angle and pressures of the swing."""
        n, near, faulty = NOMINAL, self.near, self.case.__contains__
        cos, sin = (math.cos(boom), math.cos(pitch)), (math.sin(boom), math.sin(pitch))
        centre = n["boom_pivot_x"] + cos[0] * n["boom_centre_x"] - sin[0] * n["boom_centre_z"]
        elbow = n["boom_pivot_x"] + cos[0] * n["stick_pivot_x"] - sin[0] * n["stick_pivot_z"]
        middle = elbow + cos[1] * n["stick_centre_x"] - sin[1] * n["stick_centre_z"]
        inertia = n["column_inertia"] + n["boom_inertia"] * cos[0] ** 2 + n["stick_inertia"] * cos[1] ** 2
        inertia += n["boom_mass"] * centre**2 + n["stick_mass"] * middle**2
        inertia += n["head_mass"] * (elbow + n["stick_length"] * cos[1]) ** 2
        inertia *= 1.05 if faulty("inertia") else 1
        gear = n["motor_displacement"] * n["gear_ratio"]
        line = math.pi * n["line_bore"] ** 4 / (128 * MU * n["line_length"])
        g_in, g_ex = (1 / near(n[f"{side}_leakage_resistance"]) for side in ("internal", "external"))
        area, capacitance = near(n["valve_area"]), near(3.03e-13)
        opened = opening("line", near(n["valve_dead_band"]))
        damping, dry = self.truth["swing_damping"], 400.0 if faulty("Coulomb") else 0.0
        square = 1.5 * damping if faulty("quadratic") else 0.0
        corners, sign = [(0.0, 0.0), (1.0, 0.0)], self.random.choice([-1.0, 1.0])
        while corners[-1][0] < 20:
            top, begin, sign = sign * self.random.uniform(1.5, 3.3), corners[-1][0], -sign
            times = begin + np.cumsum(self.random.uniform([0.3, 1.2, 0.8, 0.3], [0.6, 2.2, 1.6, 0.6]))
            corners += list(zip(times, (top, top, 0.0, 0.0), strict=True))
        moments, volts = np.transpose(corners)

        def rhs(t: float, y: Array) -> Array:
            speed, lines = y[1], BAR * y[2:]
            command = np.interp(t, moments, volts)
            k2, transition = edge_of(area * opened(abs(command)))
            far = np.array([SUPPLY, 0.0] if command > 0 else [0.0, SUPPLY])
            valve = n["valve_leakage"] * (SUPPLY - 2 * lines) + quadratic(k2 * (far - lines), transition)
            known, own = line * lines + np.array([-1, 1]) * gear * speed, line + g_in + g_ex
            ports = (own * known + g_in * known[::-1]) / (own**2 - g_in**2)
            friction = damping * speed + square * speed * abs(speed) + dry * math.tanh(speed / 0.005)
            cavity = 1e-12 * np.exp(np.clip((-2e4 - lines) / 5e3, -60, 40))
            rates = (valve - line * (lines - ports)) / (capacitance + cavity) / BAR
            return np.array([speed, (gear * (ports[0] - ports[1]) - friction) / inertia, *rates])

        grid = np.arange(0, moments[-1], 5e-4)
        options: dict[str, Any] = {"rtol": 1e-8, "atol": [1e-9, 1e-9, 1e-5, 1e-5], "max_step": 0.05}
        y = solve_ivp(rhs, (0, moments[-1]), [0, 0, 10, 10], "LSODA", grid, **options).y
        return grid, y[0], BAR * y[2], BAR * y[3]


def damage(case: str, rig: Path, folder: Path) -> dict[str, float]:
    """Copy recordings of the virtual rig with a fault; returns their truth."""
    paths = [
        path for name in ("rest", "damping_[bs]*[mk]_*", "weighing*") for path in rig.glob(f"{name}.csv")
    ]
    for path in paths:
        shutil.copy(path.with_suffix(".toml"), folder)
        head = path.read_text(encoding="utf-8").splitlines()[0]
        columns = dict(zip(head.split(","), np.loadtxt(path, delimiter=",", skiprows=1).T, strict=True))
        for name, values in columns.items():
            step = 360 / 65536 if name in ANGLES else 400 / 4096
            offset = 2 if "+2 deg" in case and name == ANGLES[2] else 0
            moved = FACTORS.get(case, {}).get(name, 1.0) * values + offset
            columns[name] = step * np.round(moved / step) if np.any(moved != values) else values
            if "late" in case and re.search("(head|rod)_pressure", name):
                columns[name] = np.concatenate([values[:1].repeat(4), values[:-4]])
        first, second = SWAPPED.get(case, ("", ""))
        if first in columns:
            columns[first], columns[second] = columns[second], columns[first]
        rows = np.transpose(list(columns.values()))
        np.savetxt(folder / path.name, rows, "%.12g", ",", header=head, comments="")
    names = "boom_piston_damping", "stick_piston_damping"
    return {name: NOMINAL[name] for name in names} | {"payload[weighing_loaded]": 300.0}


class Interval(NamedTuple):
    """An estimate with its interval, and the truth."""

    name: str
    value: float
    low: float
    high: float
    truth: float

    def beyond(self) -> float:
        """How far the truth is beyond an end, in half widths; negative inside."""
        width = max(self.high - self.low, 1e-9 * abs(self.value), 1e-30)  # an estimate at a bound has none
        return 2 * max(self.low - self.truth, self.truth - self.high) / width


@dataclass
class Verdict:
    """What `identify` said: parameters, and points of curves: of tables, and C_R at stated commands."""

    case: str
    status: int
    named: list[str] = field(default_factory=list)
    parameters: list[Interval] = field(default_factory=list)
    points: list[Interval] = field(default_factory=list)
    warning: str = ""


def identify(case: str, folder: Path, truth: dict[str, float], curves: dict[str, Curve]) -> Verdict:
    """Run the command and compare its numbers with the truth."""
    report, said = folder / "report", io.StringIO()
    out = ["--out", str(report / "parameters.toml"), "--report", str(report)]
    try:
        with redirect_stdout(said), redirect_stderr(said):
            verdict = Verdict(case, harvester(["identify", str(folder), "--no-joint", *out]))
    except Exception as error:  # one machine must not end the bench
        return Verdict(case, CRASH, warning=f"crash: {error!r}")
    if not (report / "identification.json").exists():
        verdict.warning = said.getvalue().strip().splitlines()[-1]
        return verdict
    data = json.loads((report / "identification.json").read_text(encoding="utf-8"))
    verdict.named = sorted({finding["fault"] for finding in data["findings"] if finding["named"]})
    verdict.warning = str(data["warnings"][0]) if data["warnings"] else ""
    same = len({float(curve(2.0)) for curve in curves.values()}) == 1  # the edges are estimated as one
    listed = {entry["name"]: entry for part in data["results"] for entry in part["listed"]}
    for entry in (entry for part in data["results"] for entry in part["estimates"] + part["others"]):
        numbers = entry["name"], entry["value"], entry["low"], entry["high"]
        if entry["name"] in truth:
            verdict.parameters.append(Interval(*numbers, truth[entry["name"]]))
        edge = next((edge for edge in curves if edge in entry["name"] or same), None)
        volt = re.match(r"C_R.*\((\d[\d.]*) V\)", entry["name"])
        if volt and edge and (opened := float(curves[edge](float(volt[1])))):
            verdict.points.append(Interval(*numbers, RHO / 2 / (C_D * truth["valve_area"] * opened) ** 2))
    for edge in list(curves)[: 1 if same else 2]:
        for name, entry in listed.items():
            if name.startswith(f"valve_{edge.replace('-', '').lower()}_opening") and 0 < entry["value"] < 1:
                volts = listed[name.replace("opening", "command")]["value"]
                numbers = f"{name} at {volts:.4g} V", entry["value"], entry["low"], entry["high"]
                verdict.points.append(Interval(*numbers, float(curves[edge](volts))))
    return verdict


def prepare(case: str, folder: Path, rig: Path, random: np.random.Generator) -> Verdict:
    """Make the recordings of one machine and identify it."""
    folder.mkdir(parents=True)
    if case.startswith("rig"):
        if not rig.exists():
            seed = str(random.integers(1000))
            with redirect_stdout(io.StringIO()):
                harvester(["rig", "--machine", "lumped", "--out", str(rig), "--seed", seed])
        return identify(case, folder, damage(case, rig, folder), {})
    machine = Machine(case, folder, random)
    if (random.random() < 0.5 and "declared" not in case) or "at rest" in case:
        machine.rest()
    for bench in ("valve", "hose", "motor", "swing") if case in CLEAN else case.split(":")[0].split("+"):
        getattr(machine, bench)()
    return identify(case, folder, machine.truth, machine.curves)


def share(items: Iterable[Interval]) -> str:
    """How many of the intervals hold the truth."""
    inside = [item.beyond() <= 0 for item in items]
    return f"{sum(inside)} of {len(inside)}"


def table(verdicts: list[Verdict]) -> str:
    """Markdown: a row for each form or fault."""
    lines = ["|form or fault|machines|status|named|intervals that hold|points of curves|"]
    lines.append("|---|--:|---|---|---|---|")
    for case in dict.fromkeys(verdict.case for verdict in verdicts):
        rows = [verdict for verdict in verdicts if verdict.case == case]
        named = ", ".join(sorted({name for row in rows for name in row.named})) or "-"
        cells = [case, str(len(rows)), ", ".join(str(row.status) for row in rows), named]
        cells += [share(item for row in rows for item in row.parameters)]
        lines.append(f"|{'|'.join(cells)}|{share(item for row in rows for item in row.points)}|")
    return "\n".join(lines)


def judge(verdicts: list[Verdict]) -> bool:
    """Print the misses of runs with status 0, and whether the bars are met."""
    silent = [(row, item) for row in verdicts if row.status == 0 for item in row.parameters + row.points]
    for row, item in silent:
        if (beyond := item.beyond()) > 0:
            text = f"{item.value:.6g} ({item.low:.6g} to {item.high:.6g}), true {item.truth:.6g}"
            kind = "WRONG" if beyond > 1 else "miss"
            print(f"{kind}: {row.case}: {item.name} {text}, {beyond:.2f} half widths beyond the end")
    counted = [row for row in verdicts if row.status == 0 and row.case != GAIN]
    parameters = [item for row in counted for item in row.parameters]
    coverage = sum(item.beyond() <= 0 for item in parameters) / max(len(parameters), 1)
    points = [item for row in counted for item in row.points]
    bad, curved = (sum(item.beyond() > 1 for item in items) for items in (parameters, points))
    alarms = [row.status != 0 for row in verdicts if row.case in CLEAN]
    print(f"clean machines with a status that is not 0: {sum(alarms)} of {len(alarms)}")
    print(f"bar 1, 90 to 98 %: {share(parameters)} of {len(counted)} machines, {100 * coverage:.1f} %")
    print(f"bar 2, nothing wrong with status 0: {bad} intervals, {curved} of curves ({share(points)} hold)")
    return 0.9 <= coverage <= 0.98 and not bad + curved


def main() -> int:
    """Run the machines; the exit status tells whether the bars are met."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seed", type=int, default=0, help="of parameters and noise")
    parser.add_argument("--only", metavar="FAULT", default="", help="forms and faults that contain this text")
    parser.add_argument("--keep", metavar="DIR", type=Path, help="new folder for the recordings")
    options = parser.parse_args()
    verdicts = list[Verdict]()
    with tempfile.TemporaryDirectory() as temporary:
        base = options.keep or Path(temporary)
        for number, case in enumerate((*CLEAN, *FAULTY, GAIN)):
            if options.only in case:
                begin, random = time.perf_counter(), np.random.default_rng([options.seed, number])
                verdict = prepare(case, base / f"{number:02}", base / "rig", random)
                verdicts.append(verdict)
                text = f"{share(verdict.parameters)}, {time.perf_counter() - begin:.0f} s; "
                text += verdict.warning.replace(f"{base}/", "")[:160]
                print(f"{number:02} {case}: {verdict.status}, {text}", flush=True)
    print(f"\n{table(verdicts)}\n")
    return 0 if judge(verdicts) else 1


if __name__ == "__main__":
    sys.exit(main())
