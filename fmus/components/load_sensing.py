"""Load-sensing line: the load pressure of a section, and the highest one of several.

A section has a bore in its valve that connects the chamber behind the open meter-in edge to the
load-sensing line; a closed valve connects the line to the tank. With c the command (or the position of the
spool) and d the dead band,

    P_load = P_t + w(c) (P_A - P_t) + w(-c) (P_B - P_t)        w(c) = s(2 c/d - 1)

s is a smooth step (`smooth.s_curve`): the bore opens between half the dead band and its end, before the
metering edge. Shuttle valves pass on the highest pressure, rounded:

    max(a, b) ~ b + r(a - b + W/2)        exact for |a - b| > W/2, above the maximum by at most 0.094 W

r is the `ramp` of width W of `smooth`.

The line has an orifice and a small relief valve, which limits its pressure to P_max:

    P_max - r(P_max - P + V/2)      as `smooth.lowest`, rounded over V

and follows with a lag, a state of the supply.

P_A, P_B are the pressures of the actuator's chambers, so the drop in the hose, 0.7 bar at 90 L/min in 4 m of
3/4 in, is not sensed. In `compensated` drives they are the pressures of the valve's ports, and it is. Valid
for a line whose own volume is negligible; its lag belongs to the supply.
Reference: Ivantysyn and Ivantysynova, Hydrostatic Pumps and Motors, 2001, ch. 9.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeAlias

import casadi as ca

from fmus.components import opening_curve
from fmus.contract import Scalar
from fmus.smooth import lowest, ramp, s_curve

SHUTTLE_ROUNDING = 5e4  # W [Pa]: at most 0.05 bar above the higher pressure
LEAST_DEAD_BAND = 1e-3  # of full command; keeps w defined for a valve without dead band


@dataclass(frozen=True)
class LoadPressure:
    """A load pressure [Pa] and its exact time derivative [Pa/s]."""

    value: Scalar
    rate: Scalar


def _connected(command: Scalar, command_rate: Scalar, dead_band: Scalar) -> tuple[Scalar, Scalar]:
    """w and dw/dt [1/s]."""
    slope = 2 / dead_band
    z = slope * command - 1
    inside = ca.fmin(ca.fmax(z, 0), 1)
    return s_curve(z), 30 * (inside * (1 - inside)) ** 2 * slope * command_rate


# (pressures of the chambers, their rates, inputs) -> load pressure of a section
Sensed: TypeAlias = Callable[[tuple[Scalar, Scalar], tuple[Scalar, Scalar], Any], LoadPressure]


def load_pressure(
    command: Scalar,
    command_rate: Scalar,
    dead_bands: tuple[Scalar, Scalar],
    full: Scalar,
    pressures: tuple[Scalar, Scalar],
    pressure_rates: tuple[Scalar, Scalar],
    u: Any,
) -> LoadPressure:
    """Load pressure of a section.

    command       command or spool position, positive opens P-A, and its rate
    dead_bands    of the edges P-A and P-B, in the unit of the command
    full          command at which the valve is fully open
    pressures     of the chambers at A and B [Pa], and their rates [Pa/s]
    u             inputs with the pressure of the return line [Pa] and its rate [Pa/s]
    """
    tank, tank_rate = u.tank_pressure, u.tank_pressure_rate
    value, rate = tank, tank_rate
    for sign, d, p, p_rate in zip((1, -1), dead_bands, pressures, pressure_rates, strict=True):
        least = ca.fmax(d, LEAST_DEAD_BAND * full)
        weight, weight_rate = _connected(sign * command, sign * command_rate, least)
        value += weight * (p - tank)
        rate += weight * (p_rate - tank_rate) + weight_rate * (p - tank)
    return LoadPressure(value, rate)


def sensed(valve: Any, u: Any) -> Sensed:
    """Load pressure of a valve without dynamics; u: inputs with its command and the rate of that."""
    bands = opening_curve.meter_in_dead_bands(valve, valve.dead_band, valve.dead_band)
    return partial(load_pressure, u.command, u.command_rate, bands, valve.full_command)


def highest(a: LoadPressure, b: LoadPressure) -> LoadPressure:
    """The higher one of two load pressures, by a shuttle valve."""
    z = a.value - b.value + SHUTTLE_ROUNDING / 2
    share = _ramp_slope(z, SHUTTLE_ROUNDING)
    return LoadPressure(b.value + ramp(z, SHUTTLE_ROUNDING), b.rate + share * (a.rate - b.rate))


def relieved(load: LoadPressure, limit: Scalar, rounding: Scalar) -> LoadPressure:
    """Steady pressure of the line at a highest load pressure, limited by its relief valve."""
    share = 1 - _ramp_slope(load.value - limit + rounding / 2, rounding)
    return LoadPressure(lowest(load.value, limit, rounding), share * load.rate)


def _ramp_slope(z: Scalar, width: Scalar) -> Scalar:
    s = ca.fmax(0, ca.fmin(1, z / width))
    return s**2 * (3 - 2 * s)
