"""Synthetic test benches: valve edges and a hose with given signals, and instruments like the paper's.

They use neither a solver nor the rig: flows follow from chosen drops, or pressures from chosen flows.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy import stats
from scipy.optimize import brentq

from fmus.parameters import Number
from orchestrator.data.recording import Recording, Sensor

BAR, LITRES = 1e5, 1e-3 / 60  # Pa, m3/s
RATE = 200.0  # Hz
PRESSURE = Sensor("transducer 0-400 bar, 12 bit", 0.1 * BAR, 400 * BAR / 4096, 0.0, 400 * BAR)
FLOW = Sensor("turbine, 12 bit", 0.3 * LITRES, 600 * LITRES / 4096, -300 * LITRES, 300 * LITRES, 10 * LITRES)

AREA, DEAD_BAND, ROUNDING, C_D, DENSITY = 4e-5, 0.6, 0.4, 0.62, 970.0
LEAKAGE, TRANSITION, VISCOSITY, SUPPLY, TANK = 1.6e-14, 10.0, 0.02, 20.684e6, 0.5e6
LENGTH, BORE, RESISTANCE, INERTANCE, CAPACITANCE = 4.0, 0.01905, 3.2e10, 1.361e7, 7.126e-13
HOSE = {"length": LENGTH, "diameter": BORE, "density": DENSITY}

KNOWN = {
    name: Number(value, unit, "assumed", "of the test")
    for name, value, unit in (
        ("boom_stick.valve_discharge_coefficient", C_D, "1"),
        ("boom_stick.valve_full_command", 10.0, "V"),
        ("boom_stick.valve_command_rounding", ROUNDING, "V"),
        ("boom_stick.valve_leakage", LEAKAGE, "m3/(s.Pa)"),
        ("boom_stick.valve_transition_reynolds", TRANSITION, "1"),
        ("boom_stick.density", DENSITY, "kg/m3"),
        ("boom_stick.viscosity", VISCOSITY, "Pa.s"),
        ("boom_stick.bulk_modulus", 1.6e9, "Pa"),
        ("boom_stick.stick_hose_resistance", RESISTANCE, "Pa.s2/m6"),
        ("boom_stick.stick_hose_length", LENGTH, "m"),
        ("boom_stick.stick_hose_bore", BORE, "m"),
        ("boom_stick.boom_hose_length", 3.0, "m"),
        ("boom_stick.boom_hose_bore", BORE, "m"),
        ("swing.line_length", 1.0, "m"),
        ("swing.line_bore", BORE, "m"),
    )
}


def measured(sensor, true, random):
    """Readings of an instrument with noise, resolution, range and dead zone."""
    read = true + random.normal(0.0, 1.0, true.size) * sensor.noise
    if sensor.resolution:
        read = sensor.resolution * np.round(read / sensor.resolution)
    return np.where(np.abs(true) < sensor.dead_zone, 0.0, np.clip(read, sensor.low, sensor.high))


def recorded(name, time, true, units, sensors, seed, procedure, conditions=None):
    """A recording of true signals by instruments; a signal without an instrument is exact."""
    random = np.random.default_rng(seed)
    read = {n: measured(sensors[n], x, random) if n in sensors else x for n, x in true.items()}
    about = {"procedure": procedure, "conditions": conditions or {}, "sensors": sensors}
    return Recording(time, read, units, Path(f"{name}.csv"), **about)


def recording(procedure, conditions, signals, seed, flow=FLOW):
    """A recording at a bench; the command has no noise."""
    sensors = {n: PRESSURE if n.startswith("pressure") else flow for n in signals if n != "command"}
    time = np.arange(len(next(iter(signals.values())))) / RATE
    units = {name: {"c": "V", "p": "Pa", "f": "m3/s"}[name[0]] for name in signals}
    return recorded(procedure, time, signals, units, sensors, seed, procedure, conditions)


def changed(record, signals):
    """The recording with other samples of some signals."""
    return replace(record, signals={**record.signals, **signals})


def with_sensors(record, first="", **changes):
    """The recording with other properties of the sensors whose signals begin so."""
    own = {n: replace(s, **changes) for n, s in record.sensors.items() if n.startswith(first)}
    return replace(record, sensors={**record.sensors, **own})


def opening(command, dead_band=DEAD_BAND, rounding=ROUNDING):
    """Fraction of the full area at a command [V]: zero, a rounded foot, a straight line to one at 10 V."""

    def ramp(z):
        s = np.clip(z / rounding, 0.0, 1.0)
        return rounding * (s**3 - s**4 / 2) + np.maximum(z - rounding, 0.0)

    return ramp(command - dead_band) / ramp(10.0 - dead_band)


STEPS = (0.25, 0.5, 0.75, 1.0, 1.25, 1.5, 1.75, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0)


def edge(name, seed, area=AREA, steps=STEPS, flow=FLOW, leakage=LEAKAGE):
    """One edge, each step held for 1.5 s; the load behind it takes 0.4 MPa per volt, so its drop is known."""
    volts = np.array(steps)
    gain = C_D * area * opening(volts) * np.sqrt(2 / DENSITY)
    supply_drop = SUPPLY - TANK
    drop = supply_drop - 4e5 * (volts - volts[0])
    leak = leakage * drop - leakage * (supply_drop - drop)  # of the open edge minus that of the closed one

    # flow of that Reynolds number through a round hole of the same area
    laminar = TRANSITION * VISCOSITY / DENSITY * np.sqrt(np.pi * area * opening(volts)) / 2

    def surplus(q, i):
        through = q - leak[i]
        return through * (abs(through) + laminar[i]) - gain[i] ** 2 * drop[i]

    q = np.array([brentq(surplus, -1e-6, 1e-2, args=(i,), xtol=1e-15) for i in range(volts.size)])
    hold = round(1.5 * RATE)
    q, drop = np.repeat(q, hold), np.repeat(drop, hold)
    before = np.full_like(q, SUPPLY) if name[0] == "P" else TANK + drop
    command = np.repeat(volts, hold) * (1 if name in ("P-A", "B-T") else -1)
    signals = {"command": command, "pressure_in": before, "pressure_out": before - drop, "flow": q}
    return recording("valve", {"edge": name}, signals, seed, flow)


def edges(seed, leakage=LEAKAGE, **changes):
    """The four edges; `changes` are areas by edge."""
    names = ("P-A", "B-T", "P-B", "A-T")
    return [edge(n, [seed, i], changes.get(n, AREA), leakage=leakage) for i, n in enumerate(names)]


FLOWS = tuple(np.linspace(5.0, 280.0, 24))  # L/min


def friction(q, viscosity=VISCOSITY):
    """Pressure drop [Pa] at a flow [m3/s]: Hagen-Poiseuille below Re 2300, Blasius above, smooth between."""
    reynolds = 4 * q * DENSITY / (np.pi * BORE * viscosity)
    s = reynolds**8 / (2300.0**8 + reynolds**8)
    turbulent = RESISTANCE * (viscosity / VISCOSITY * 170 * LITRES * q**7) ** 0.25
    return (1 - s) * 128 * viscosity * LENGTH / (np.pi * BORE**4) * q + s * turbulent


def steady_hose(seed, drop, flows=FLOWS):
    """A hose at stepped flows [L/min], with a pressure drop that is a function of the flow [m3/s]."""
    q = np.repeat(np.array(flows) * LITRES, round(1.5 * RATE))
    inlet = 80 * BAR
    signals = {"pressure_in": np.full_like(q, inlet), "pressure_out": inlet - drop(q), "flow": q}
    return [recording("hose_resistance", HOSE, signals, seed)]


def moving_hose(seed, share=0.0, groups=2, length=10.0, late=(), delay=0.0):
    """A hose with a flow and a pressure that are sums of sines; the other signals follow by its equations.

    share   position s of the flow of the inertance towards the outlet, and of the pressure of the capacitance
            towards the inlet; 0 in the machine's model
    late    signals that are late by `delay` [s]
    """
    return [_group([seed, i], i, share, length, late, delay) for i in range(groups)]


def _group(seed, number, share, length, late, delay):
    time = np.arange(round(length * RATE)) / RATE
    tones = np.array([0.7, 1.9, 3.1, 4.3]) * (1 + 0.1 * number)  # Hz
    phase = np.arange(4) * (1 + number)

    def waves(mean, sizes):
        angle = 2 * np.pi * tones * time[:, None] + phase
        omega = 2 * np.pi * tones
        value = mean + np.sin(angle) @ sizes
        return value, np.cos(angle) @ (sizes * omega)

    # the flow Q of the inertia and the pressure P of the capacitance are chosen, with their derivatives;
    # Q_in, Q_out, P_in, P_out are the sums and differences of these and of what is stored between the ends
    q, dq = waves(120 * LITRES, np.array([30.0, 20.0, 12.0, 10.0]) * LITRES)
    p, dp = waves(120 * BAR, np.array([15.0, 15.0, 10.0, 10.0]) * BAR)
    drop = INERTANCE * dq + friction(q)
    stored = CAPACITANCE * dp
    signals = {
        "pressure_in": p + (1 - share) * drop,
        "pressure_out": p - share * drop,
        "flow_in": q + share * stored,
        "flow_out": q - (1 - share) * stored,
    }
    signals |= {n: np.interp(time - delay, time, signals[n]) for n in late}
    return recording("hose_dynamics", HOSE, signals, seed)


def named(result):
    """All estimates of a procedure by name."""
    return {e.name: e for e in (*result.estimates, *result.others)}


def assert_coverage(truth, estimates, wrong=1e-3):
    """Independent 95 % intervals cover the truth in 95 %, and errors match their standard deviations.

    wrong   probability that chance fails the test, on each side
    """
    count = len(estimates)
    covered = sum(e.low <= truth <= e.high for e in estimates)
    assert stats.binom.ppf(wrong, count, 0.95) <= covered <= stats.binom.isf(wrong, count, 0.95)
    squares = sum(((e.value - truth) / e.sd) ** 2 for e in estimates)
    assert stats.chi2.ppf(wrong, count) <= squares <= stats.chi2.isf(wrong, count)
