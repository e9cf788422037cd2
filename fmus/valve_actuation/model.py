"""Electrical actuation of the valves: driver, pilot head and spool, from a command to what the valve does.

    command u -> dead-band compensation -> + dither -> play, lag and ramp of the spool -> valve command z

    v = u + c (1 - |u|/U) u/sqrt(u^2 + f^2)              c: `dead_band_compensation`; u limited to -U ... U
    dz/dt = R sat(k (r(e - h + w/2) - r(-e - h + w/2))/R)    e = v + a sin(2 pi n t) - z

r, h and k are those of `fmus.components.play`: h is half of `hysteresis` times full command U, 1/k the lag. R
is the largest rate, sat the `saturation` of a spool, a and n are amplitude and frequency of the dither. z is
a state, so no output but the rates depends on an input directly.

A delay, such as that of a bus, is no part of this: it needs samples, and these equations have no events.

Signs: those of the commands.
"""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import casadi as ca

from fmus import ports
from fmus.components.play import play_rate
from fmus.components.spool_valve import saturation
from fmus.contract import Group, Quantity, Scalar, Subsystem, make_group, nested, quantities

# valve -> what a positive command does, part of the machine that contains it
VALVES: Mapping[str, tuple[str, str]] = {
    "swing": ("turns left", "swing"),
    "boom": ("raises the boom", "boom_stick"),
    "stick": ("folds the stick in", "boom_stick"),
}
FOOT = 0.05  # V: command over which the compensation changes its sign


class Parameters(Group):
    """Driver, pilot head and spool; the same for all valves."""

    hysteresis: Scalar = Quantity(
        "1",
        "Hysteresis: width of the loop of spool over command in slow motion, as a fraction of full command",
        0.01,
        minimum=0.0,
        maximum=0.5,
        group="Pilot head and spool",
    )
    full_command: Scalar = Quantity("V", "Command for the full stroke of the spool", 10.0, minimum=0.1)
    lag: Scalar = Quantity("s", "Time constant with which the spool follows", 0.01, minimum=1e-4)
    rounding: Scalar = Quantity(
        "V", "Range of the command over which the spool begins to move", 0.1, minimum=1e-4
    )
    largest_rate: Scalar = Quantity("V/s", "Ramp: largest rate of the valve command", 100.0, minimum=1e-2)
    dead_band_compensation: Scalar = Quantity(
        "V", "Dead band that the driver steps over as soon as there is a command", minimum=0.0, group="Driver"
    )
    dither_amplitude: Scalar = Quantity("V", "Amplitude of the dither", 0.1, minimum=0.0)
    dither_frequency: Scalar = Quantity("Hz", "Frequency of the dither", 100.0, minimum=0.0)


class Condition(Group):
    """Of one valve, apart from the others; zeros: as the others."""

    stuck: Scalar = Quantity("1", "1: the {} spool is stuck, 0: it moves", value=0.0, group="{} valve")
    loss: Scalar = Quantity("1", "Fraction of the {} command that does not arrive", value=0.0)
    more_hysteresis: Scalar = Quantity("1", "Hysteresis of the {} valve in addition", 0.01, value=0.0)


LIKE_OTHERS = nested(Condition, dict.fromkeys(quantities(Condition), 0.0))


def _variables(valves: Mapping[str, tuple[str, str]]) -> tuple[type[Any], ...]:
    """States, inputs and outputs for these valves."""
    inputs, states, rates = dict[str, Quantity](), dict[str, Quantity](), dict[str, Quantity]()
    for valve, (meaning, _) in valves.items():
        rate, text = f"{valve}_command_rate", f"Command that the {valve} valve follows, positive {meaning}"
        inputs[f"{valve}_command"] = ports.command(valve, meaning, rate)
        inputs[rate] = ports.rate_input(f"{valve}_command", "V/s", 10.0)
        states[f"{valve}_valve_command"] = Quantity("V", text, 10.0)
        rates[f"{valve}_valve_command_rate"] = ports.rate_output(f"{valve}_valve_command", "V/s", 10.0)
    clock = {"clock": Quantity("s", "Time of the dither; starts at 0, independent of the start time")}
    return (
        make_group("States", {**states, **clock}),
        make_group("Inputs", inputs),
        make_group("Outputs", states | rates),
    )


def compensated(u: Scalar, p: Any) -> Scalar:
    """The command [V] behind the compensation of the dead band."""
    full = p.full_command
    u = ca.fmin(ca.fmax(u, -full), full)
    return u + p.dead_band_compensation * (1 - ca.fabs(u) / full) * u / ca.sqrt(u**2 + FOOT**2)


def actuation(valves: Mapping[str, tuple[str, str]] = VALVES, conditions: bool = False) -> Subsystem:
    """The actuation of these valves; conditions: each has parameters of its own."""
    states, inputs, outputs = _variables(valves)
    own: dict[str, Any] = dict.fromkeys(valves, Condition) if conditions else {}

    def rates(x: Any, u: Any, p: Any) -> dict[str, Scalar]:
        dither = p.dither_amplitude * ca.sin(2 * math.pi * p.dither_frequency * x.clock)

        def rate(valve: str) -> Scalar:
            of = getattr(p, valve, LIKE_OTHERS)
            half = (p.hysteresis + of.more_hysteresis) * p.full_command / 2
            wanted = compensated(getattr(u, f"{valve}_command") * (1 - of.loss), p) + dither
            free = play_rate(wanted, getattr(x, f"{valve}_valve_command"), half, 1 / p.lag, p.rounding)
            return p.largest_rate * saturation(free / p.largest_rate) * (1 - of.stuck)

        return {f"{valve}_valve_command": rate(valve) for valve in valves}

    def dynamics(x: Any, u: Any, p: Any) -> Any:
        return states(clock=1, **rates(x, u, p))

    def observe(x: Any, u: Any, p: Any) -> Any:
        moved = {f"{n}_rate": rate for n, rate in rates(x, u, p).items()}
        return outputs(**moved, **{f"{v}_valve_command": getattr(x, f"{v}_valve_command") for v in valves})

    return Subsystem(
        name="valve_actuation",
        text="Electrical actuation of the valves: hysteresis, lag and ramp of the spool, dither, dead band",
        parameters=make_group("Parameters", {}, Parameters, **own) if conditions else Parameters,
        states=states,
        inputs=inputs,
        outputs=outputs,
        dynamics=dynamics,
        observe=observe,
        values=Path(__file__).with_name("parameters.toml"),
        require=lambda _x, _u, p: {
            "full_command exceeds dead_band_compensation": p.full_command - p.dead_band_compensation
        },
        terminals=(
            *(ports.lever(valve) for valve in valves),
            *(ports.lever(valve, part) for valve, (_, part) in valves.items()),
        ),
        stiff=False,
        validity="commands below about 20 Hz; no delay; valves of one kind",
    )


ACTUATION = actuation()
