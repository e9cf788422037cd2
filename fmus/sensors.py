"""Sensors between a machine and what measures it: lag, delay, range, noise, resolution, and their faults.

    l' = (u - l)/T        d = 2 z - l,  z' = 2 (l - z)/tau
    y  = q round((d + b + s n(t))/q), within the range; one beyond it without a connection

u is the signal, T the lag of the sensor and tau the delay of the bus, an all-pass of first order. Its phase
is that of a pure delay within 2 % up to 0.08/tau Hz. n is noise of unit variance, a new number every
`noise_period`, the sum of four uniform ones; the same at the same time and seed. b, s and q are bias,
standard deviation and resolution. A stuck sensor keeps l. The drift of a sensor is a bias that grows.

Validity: one lag, delay, noise, range and resolution for all signals of a unit. Sampling is not modelled; it
adds half a sample of delay in the mean.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import casadi as ca

from fmus.contract import Quantity, Scalar, Subsystem, flat, make_group
from fmus.parameters import Number

NAME = "sensors"
# unit -> begin of the names of its parameters
NOMINAL = {"Pa": 1e7, "s": 0.01}
KINDS = {"Pa": "pressure", "rad": "angle", "m": "length", "rad/s": "turning", "m/s": "velocity"}
# lag [s], delay [s], noise, resolution, lowest and highest reading, that without a connection: of each kind
BUS, TURN = 0.005, 2 * math.pi  # s, rad
NUMBERS: Mapping[str, tuple[tuple[float, ...], str]] = {
    "pressure": (
        (2e-3, BUS, 1e4, 1e4, -1e5, 6e7, -1.5e7),
        "transducer of 600 bar, 4 to 20 mA, so 0 mA reads -150 bar; resolution and noise of 0.1 bar",
    ),
    "angle": (
        (1e-3, BUS, 0.0, 2 * math.pi / 65536, -4 * math.pi, 4 * math.pi, -5 * math.pi),
        "encoder of 65 536 counts per turn",
    ),
    "length": ((1e-3, BUS, 0.0, 1e-4, -1.0, 100.0, -10.0), "linear encoder"),
    "turning": (
        (0.01, BUS, 2e-3, 1e-4, -10.0, 10.0, -20.0),
        "gyroscope, or an encoder differentiated over 20 ms",
    ),
    "velocity": ((0.01, BUS, 1e-3, 1e-4, -10.0, 10.0, -20.0), "linear encoder differentiated over 20 ms"),
}
FIELDS = {
    "lag": ("s", "Lag of the {} sensors"),
    "delay": ("s", "Delay of the {} readings"),
    "noise": ("", "Standard deviation of the {} readings"),
    "resolution": ("", "Resolution of the {} readings; 0: as fine as numbers are"),
    "lowest": ("", "Lowest {} reading"),
    "highest": ("", "Highest {} reading"),
    "unconnected": ("", "Reading of a {} sensor that is not connected"),
}
FAULTS = {
    "bias": ("", "Bias of the reading of {}"),
    "stuck": ("1", "1: the reading of {} stands still"),
    "noise_added": ("", "Standard deviation of the reading of {} in addition"),
    "lost": ("1", "1: the sensor of {} is not connected"),
}
LEAST_LAG = 1e-4  # s
SIGNED = ("lowest", "highest", "unconnected")


def sensors(signals: Mapping[str, str]) -> Subsystem:
    """Sensors of these signals, each with its unit; inputs NAME, outputs NAME_measured."""
    kinds = {KINDS[unit]: unit for unit in KINDS if unit in signals.values()}
    declared, numbers = {}, {}
    for kind, unit in kinds.items():
        values, note = NUMBERS[kind]
        for (field, (own, text)), value in zip(FIELDS.items(), values, strict=True):
            name = f"{kind}_{field}"
            low = LEAST_LAG if field == "lag" else None if field in SIGNED else 0.0
            size = NOMINAL.get(own or unit, 1.0) / (1e3 if field in ("noise", "resolution") else 1)
            declared[name] = Quantity(
                own or unit, text.format(kind), size, low, group=f"{kind.capitalize()}s"
            )
            numbers[name] = Number(value, own or unit, "assumed", note)
    declared["noise_period"] = Quantity(
        "s", "Time between two numbers of the noise", 0.01, 1e-4, group="Noise"
    )
    declared["seed"] = Quantity("1", "Seed of the noise")
    numbers["noise_period"] = Number(1e-3, "s", "assumed", "sampling of a bus node")
    numbers["seed"] = Number(1.0, "1", "assumed", "any")
    parameters = make_group("Parameters", declared)
    nominal = {n: NOMINAL.get(unit, 1.0) for n, unit in signals.items()}
    inputs = {n: Quantity(unit, f"Signal {n}", nominal[n]) for n, unit in signals.items()}
    for n, unit in signals.items():
        for field, (own, text) in FAULTS.items():
            most = None if field in ("bias", "noise_added") else 1.0
            least = None if field == "bias" else 0.0
            size = 1.0 if own else 0.01 * nominal[n]
            text = f"Fault: {text.format(n)}"
            inputs[f"{n}_{field}"] = Quantity(
                own or unit, text, size, least, most, optional="the sensor is healthy"
            )
    states = {f"{n}_lagged": Quantity(unit, f"{n} behind the lag", nominal[n]) for n, unit in signals.items()}
    for n, unit in signals.items():
        states[f"{n}_delayed"] = Quantity(unit, f"{n} in the delay", nominal[n])
    states["clock"] = Quantity("s", "Time of the noise; starts at 0, independent of the start time")
    outputs = {
        f"{n}_measured": Quantity(unit, f"Reading of {n}", nominal[n], noisy=True)
        for n, unit in signals.items()
    }
    state, shown = make_group("States", states), make_group("Outputs", outputs)

    def dynamics(x: Any, u: Any, p: Any) -> Any:
        rates: dict[str, Scalar] = {"clock": 1}
        for n, unit in signals.items():
            lag, delay = (getattr(p, f"{KINDS[unit]}_{k}") for k in ("lag", "delay"))
            lagged, delayed = (getattr(x, f"{n}_{k}") for k in ("lagged", "delayed"))
            rates[f"{n}_lagged"] = (getattr(u, n) - lagged) / lag * (1 - getattr(u, f"{n}_stuck"))
            rates[f"{n}_delayed"] = 2 * (lagged - delayed) / ca.fmax(delay, LEAST_LAG)
        return state(**rates)

    def observe(x: Any, u: Any, p: Any) -> Any:
        readings, sample = {}, ca.floor(x.clock / p.noise_period)
        for k, (n, unit) in enumerate(signals.items()):
            own = {field: getattr(p, f"{KINDS[unit]}_{field}") for field in FIELDS}
            of = {field: getattr(u, f"{n}_{field}") for field in FAULTS}
            lagged, delayed = (getattr(x, f"{n}_{field}") for field in ("lagged", "delayed"))
            late = ca.if_else(own["delay"] > 0, 2 * delayed - lagged, lagged)
            spread = (own["noise"] + of["noise_added"]) * (1 - of["stuck"])
            value = late + of["bias"] + spread * noise(sample, p.seed, k)
            step = ca.fmax(own["resolution"], 1e-300)
            value = ca.if_else(own["resolution"] > 0, step * ca.floor(value / step + 0.5), value)
            value = ca.fmin(ca.fmax(value, own["lowest"]), own["highest"])
            readings[f"{n}_measured"] = value + of["lost"] * (own["unconnected"] - value)
        return shown(**readings)

    def initial(_: Any, u: Any, __: Any) -> dict[str, Scalar]:
        at = flat(u)
        return {f"{n}_{field}": at[n] for n in signals for field in ("lagged", "delayed")}

    def next_event(x: Any, _: Any, p: Any) -> Scalar:
        return p.noise_period * (ca.floor(x.clock / p.noise_period) + 1) - x.clock

    return Subsystem(
        name=NAME,
        text="Sensors: lag, delay, noise, resolution, range, and their faults",
        parameters=parameters,
        states=state,
        inputs=make_group("Inputs", inputs),
        outputs=shown,
        dynamics=dynamics,
        observe=observe,
        initial=initial,
        next_event=next_event,
        numbers={"parameters": numbers, "start": {}},
        stiff=False,
        validity="signals below 16 Hz at the delay of the default values",
    )


def noise(sample: Scalar, seed: Scalar, signal: int) -> Scalar:
    """Of unit variance, a number for each sample and signal."""

    def equal(k: int) -> Scalar:
        scrambled = 43758.5453 * ca.sin(12.9898 * sample + 78.233 * (4 * signal + k) + 37.719 * seed)
        return scrambled - ca.floor(scrambled)

    return math.sqrt(3) * (sum(equal(k) for k in range(4)) - 2)
