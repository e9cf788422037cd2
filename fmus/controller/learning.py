"""draft"""
from dataclasses import dataclass
from typing import Any

import casadi as ca

from fmus.contract import Scalar
from fmus.controller.arm import ControlledAxis
from fmus.controller.valve import Actuator
from fmus.smooth import direction, ramp, s_curve


LARGEST = 0.3


@dataclass(frozen=True)
class ValveMap:
    dead_bands: tuple[Scalar, Scalar]
    flows: tuple[Scalar, Scalar]


def learned_map(axis: ControlledAxis, x: Any) -> ValveMap:
    d, f = (tuple(getattr(x, f"{axis.name}_{n}_{side}") for side in ("up", "down")) for n in ("dead_band", "flow"))
    return ValveMap(d, f)


@dataclass(frozen=True)
class Lesson:
    rates: dict
    residual: Scalar  # V, sign of motion
    weight: Scalar
    volts: Scalar
    sign: Scalar
    change: Scalar


def lesson(axis, a: Actuator, motion, wanted, margin, oscillation, error, volt, x, p) -> Lesson:
    name = axis.name
    (speed, change, reference_rate), (commanded, opening) = motion, wanted
    limit = getattr(p, f"{name}_speed_limit")
    slow = p.learning_share * limit
    late, shift = getattr(x, f"{name}_commanded"), getattr(x, f"{name}_shift")
    innovation = (oscillation / a.stiffness - error - shift) / p.learning_filter_time
    load_time = getattr(p, f"{axis.loop}_load_time")
    sign = direction(speed, slow)
    inside = s_curve(ca.fabs(speed) / slow - 1) * s_curve(late * sign / slow - 1)
    inside *= margin * (1 - s_curve(ca.fabs(opening) / 0.1 - 8.5))
    residual = innovation / volt * sign
    rates = {
        f"{name}_commanded": (commanded - late) / (p.amplifier_time + p.learning_lag),
        f"{name}_shift": late - reference_rate - oscillation / a.stiffness / load_time + innovation,
    }
    return Lesson(rates, residual, inside, late * sign / volt, speed, change / volt)


def map_rates(name, found: Lesson, spool, spool_rate, side, x, p, on) -> dict:
    """Rates."""
    T = p.learning_filter_time
    volts, moved, turned = (getattr(x, f"{name}_{n}") for n in ("volts_late", "spool_late", "side_late"))
    moving = (spool - moved) / T
    result = {
        f"{name}_volts_late": (found.volts - volts) / T,
        f"{name}_spool_late": moving,
        f"{name}_side_late": (side - turned) / T,
    }
    up = found.sign > 0
    d = ca.if_else(up, 1, -1)
    noise2 = (p.learning_noise ** 2 + (moving * p.learning_lag) ** 2) * p.learning_correlation
    r = found.residual / (1 + (found.residual / LARGEST) ** 2)
    spread = (p.dead_band_spread, p.flow_spread, p.play_spread)
    f = (-spread[0], volts * spread[1], -d * turned * spread[2])
    active = on * p.learning * found.weight
    pairs = [(i, j) for i in range(3) for j in range(i, 3)]
    half = 0
    for end, mine in (("up", ca.if_else(up, active, 0)), ("down", ca.if_else(up, 0, active))):
        P = {ij: getattr(x, f"{name}_p{ij[0]}{ij[1]}_{end}") for ij in pairs}
        get = lambda i, j: P[min(i, j), max(i, j)]
        k = [sum(get(i, j) * f[j] for j in range(3)) for i in range(3)]
        gain = mine / noise2
        dv, fv = (getattr(x, f"{name}_{n}_{end}") for n in ("dead_band", "flow"))
        result[f"{name}_dead_band_{end}"] = gain * k[0] * r * spread[0] - over(dv, p.dead_band_limit) / p.unwinding_time
        result[f"{name}_flow_{end}"] = gain * k[1] * r * spread[1] - over(fv, p.gain_limit) / p.unwinding_time
        half += gain * k[2] * r * spread[2]
        for (i, j), v in P.items():
            result[f"{name}_p{i}{j}_{end}"] = mine * ((i == j) - v) / p.learning_memory - gain * k[i] * k[j]
    return result, half


def over(z, limit):
    return z - ca.fmin(ca.fmax(z, -limit), limit)
