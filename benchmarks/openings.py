"""Test benches of valves with known openings, by equations of their own: truth for the valve procedure.

A metering edge and a throttle behind it lie between the supply and the tank:

    Q = K(V) sqrt(dp)        p_s = Q^2 / K^2 + C Q^2        K = C_d A a(V) sqrt(2/rho)

No component of the project is used, neither leakage nor laminar flow are modelled (the known ones are set to
almost nothing). Pressure transducers have noise, steps of a converter and errors of their zeros within the
class that the recording declares; the turbine reads nothing below its dead zone.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from fmus.identification.procedures.experiment_data import pressure_offset
from fmus.identification.procedures.valve import identify_openings
from fmus.parameters import Number
from orchestrator.data.recording import Recording, Sensor

Array = NDArray[np.float64]
Share = Callable[[Array], Array]  # opening over the command [V], relative to the area

BAR, LITRES = 1e5, 1e-3 / 60  # Pa, m3/s
AREA, DEAD_BAND, FULL = 27e-6, 0.6, 10.0  # m2, V, V
C_D, DENSITY, SUPPLY, THROTTLE = 0.62, 870.0, 200 * BAR, 2e11  # -, kg/m3, Pa, Pa.s2/m6
ZERO_ERROR = 0.5 * BAR  # of each transducer: class 0.125 % of 400 bar
RATE, HOLD = 200.0, 1.5  # Hz, s
UP = (*np.arange(0.25, 2.01, 0.25), *np.arange(2.5, 10.01, 0.5))  # V, the rig's staircase
# each level twice: a step may be left out, as when equal samples at its extreme look clipped (1 in 1000)
STEPS = (*UP, *UP[-2::-1], FULL)

KNOWN = {
    f"boom_stick.{name}": Number(value, unit, "assumed", "of the bench")
    for name, value, unit in (
        ("valve_discharge_coefficient", C_D, "1"),
        ("valve_full_command", FULL, "V"),
        ("valve_command_rounding", 0.4, "V"),
        ("valve_leakage", 1e-17, "m3/(s.Pa)"),
        ("valve_transition_reynolds", 1e-3, "1"),
        ("viscosity", 0.02, "Pa.s"),
        ("density", DENSITY, "kg/m3"),
    )
}


def power(exponent: float, dead_band: float = DEAD_BAND) -> Share:
    """line^n: a straight line behind a dead band, raised to a power."""
    return lambda v: np.clip((v - dead_band) / (FULL - dead_band), 0.0, None) ** exponent


def through(*points: tuple[float, float]) -> Share:
    """A monotone cubic through points (command, opening), closed up to the first one."""
    v, a = np.array([(points[0][0] - 1.0, 0.0), *points]).T
    curve = PchipInterpolator(v, a)
    return lambda x: np.where(x <= points[0][0], 0.0, curve(np.maximum(x, v[0])))


# spools with notches: slow at first, then fast, then slower again; with different overlaps and areas
FINE = through((0.9, 0.0), (2.0, 0.03), (3.5, 0.12), (5.0, 0.32), (7.0, 0.66), (8.5, 0.88), (10.0, 1.0))
FAST = through((0.4, 0.0), (1.0, 0.08), (2.0, 0.25), (3.0, 0.38), (5.0, 0.6), (7.0, 0.75), (10.0, 0.9))
KINKED = through((0.7, 0.0), (3.0, 0.2), (6.0, 0.3), (8.0, 0.75), (10.0, 1.0))
VALVES: Mapping[str, Mapping[str, Share]] = {
    **{f"line^{n:g}": dict.fromkeys(("P-A", "P-B"), power(n)) for n in (0.9, 1.0, 1.05, 1.1, 1.3, 2.0)},
    "asymmetric 1": {"P-A": FINE, "P-B": FAST},
    "asymmetric 2": {"A-T": KINKED, "B-T": power(1.2, 1.1)},
}


def edge(name: str, share: Share, zeros: Array, seed: Sequence[int]) -> Recording:
    """One edge at stepped commands, each held for `HOLD`, with the noise of a seed.

    zeros   errors of the two transducers [Pa]
    """
    random = np.random.default_rng(seed)
    volts = np.array(STEPS)
    gain = C_D * AREA * share(volts) * np.sqrt(2 / DENSITY)
    flow = gain * np.sqrt(SUPPLY / (1 + THROTTLE * gain**2))
    drop = SUPPLY - THROTTLE * flow**2
    inlet = np.full_like(drop, SUPPLY) if name.startswith("P") else drop
    sign = 1 if name in ("P-A", "B-T") else -1
    true = {"pressure_in": inlet + zeros[0], "pressure_out": inlet - drop + zeros[1], "flow": flow}
    held = {n: np.repeat(x, round(HOLD * RATE)) for n, x in true.items()}
    signals = {n: _read(SENSORS[n], x, random) for n, x in held.items()}
    signals["command"] = np.repeat(sign * volts, round(HOLD * RATE))
    return Recording(
        source=Path(f"{name}.csv"),
        procedure="valve",
        conditions={"edge": name},
        time=np.arange(signals["flow"].size) / RATE,
        signals=signals,
        units={"command": "V", "pressure_in": "Pa", "pressure_out": "Pa", "flow": "m3/s"},
        sensors=SENSORS,
    )


_TRANSDUCER = Sensor("0-400 bar, 12 bit", 0.1 * BAR, 400 * BAR / 4096, -2 * BAR, 400 * BAR, 0.0, ZERO_ERROR)
SENSORS = {
    "pressure_in": _TRANSDUCER,
    "pressure_out": _TRANSDUCER,
    "flow": Sensor("turbine", 0.3 * LITRES, 600 * LITRES / 4096, -300 * LITRES, 300 * LITRES, 10 * LITRES),
}


def _read(sensor: Sensor, true: Array, random: np.random.Generator) -> Array:
    noisy = true + random.normal(0.0, sensor.noise, true.size)
    steps = np.clip(sensor.resolution * np.round(noisy / sensor.resolution), sensor.low, sensor.high)
    return np.where(np.abs(true) < sensor.dead_zone, 0.0, steps)


def recordings(valve: str, seed: int) -> list[Recording]:
    """The recordings of the edges of a valve, all with the same transducers."""
    number = list(VALVES).index(valve)
    zeros = np.random.default_rng([seed, number]).uniform(-ZERO_ERROR, ZERO_ERROR, 2)
    shares = VALVES[valve].items()
    return [edge(e, share, zeros, [seed, number, i]) for i, (e, share) in enumerate(shares)]


def start_of(share: Share) -> float:
    """Command [V] from which an opening is above zero, within 1 mV."""
    volts = np.arange(0.0, FULL, 1e-3)
    return float(volts[np.flatnonzero(share(volts) > 0)[0]]) - 1e-3


@dataclass(frozen=True)
class Trial:
    """One fitted opening against the truth.

    inside      share of the measured commands at which the 95 % interval of the area holds the truth
    area        relative error of the area at full command
    zero        found difference of the transducers over what they are declared to have, both together
    start       whether the interval of the start holds the truth
    straight    whether a straight line was found to suffice
    half        median of half these intervals over the truth
    table       largest error of the table at commands between the lowest and the highest measured one
    """

    valve: str
    edge: str
    inside: float
    area: float
    zero: float
    start: bool
    straight: bool
    half: float
    table: float


def trials(valve: str, seed: int) -> list[Trial]:
    """The valve procedure on the recordings of a valve, one row for each edge."""
    found = identify_openings(recordings(valve, seed), KNOWN)
    rows = []
    for name, share in VALVES[valve].items():
        opening = found.openings[name]
        true = AREA * share(opening.command)
        low, high = (np.array([getattr(e, end) for e in opening.areas]) for end in ("low", "high"))
        rounding, start = 1e-9 * AREA, start_of(share)
        inside = (low <= true + rounding) & (true <= high + rounding)
        between = np.arange(opening.command[0], FULL, 0.05)
        rows.append(
            Trial(
                valve=valve,
                edge=name,
                inside=float(inside.mean()),
                area=opening.full.value / float(true[-1]) - 1,
                zero=abs(pressure_offset(found.solution).value) / (2 * ZERO_ERROR),
                start=opening.start.low <= start + 2e-3 and start <= opening.start.high + 2e-3,
                straight=found.straight is not None,
                half=float(np.median((high - low) / 2 / true)),
                table=float(np.max(np.abs(opening.drawn(between) / (AREA * share(between)) - 1))),
            )
        )
    return rows
