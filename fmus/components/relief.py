"""Relief and anti-cavitation valves: a smooth static characteristic.

    Q = g r(dP - P_set, w)        r the ramp of `fmus.components.smooth`: exactly 0 for dP <= P_set

Above P_set + w a straight line of slope g that starts at P_set + w/2. A relief valve sees the pressure of
its line over that of the return line, an anti-cavitation valve the other way round. Poppet dynamics (faster
than 5 ms) and hysteresis are left out.
"""

from __future__ import annotations

from dataclasses import dataclass

from fmus.components.smooth import ramp
from fmus.contract import Scalar


@dataclass(frozen=True)
class PressureValve:
    """Opening pressure P_set [Pa], slope g [m3/(s.Pa)], rounding w [Pa]."""

    pressure: Scalar
    gain: Scalar
    rounding: Scalar


def flow(valve: PressureValve, drop: Scalar) -> Scalar:
    """Flow [m3/s] along a pressure difference [Pa]; never against it if P_set >= 0."""
    return valve.gain * ramp(drop - valve.pressure, valve.rounding)


def cross_flow(valve: PressureValve, drop: Scalar) -> Scalar:
    """Flow [m3/s] of two valves back to back, with the sign of the pressure difference [Pa]."""
    return flow(valve, drop) - flow(valve, -drop)
