"""Writes crane.txt, in place of a recording: 1024 rows of valve command and oil pressure, no names, no units.

The machine has more in it than the model that `run.py` fits: two unequal chambers whose volumes change with
the stroke, a valve with four edges and a spool of second order, dry friction, damping in the bending arm,
noise and a 12-bit converter. The transducer ends at +-1, and the logger missed a few samples.
"""

from pathlib import Path
from types import SimpleNamespace

import casadi as ca
import numpy as np
from scipy.integrate import solve_ivp
from scipy.signal import savgol_filter

from fmus.components.chamber import Liquid, pressure_rate
from fmus.components.spool_valve import CurvedValve, ports_from_pressure
from fmus.contract import nested, quantities
from fmus.smooth import direction

STEP, SAMPLES, SEED = 0.04, 1024, 7  # s, 1, 1
SUPPLY, TANK, BULK = 16e6, 0.2e6, 4e8  # Pa, Pa, Pa with the hoses
HEAD, ROD, LENGTH = 5e-3, 2.5e-3, 2.6  # areas of the piston [m2], both chambers together [m]
PISTON, VISCOUS, DRY = 1.5e3, 9e4, 1.5e3  # moved with the piston [kg], friction [N.s/m] and [N]
ARM, BENDING, INNER = 1.6e4, 1.1e6, 3e3  # mass of the arm [kg], its stiffness [N/m] and damping [N.s/m]
SPOOL, RATIO = 22.0, 0.8  # natural frequency [rad/s] and damping ratio [1]
NUMBERS = {
    "area": 9e-6,
    "discharge_coefficient": 0.62,
    "dead_band": 0.8,
    "full_command": 4.5,
    "command_rounding": 0.4,
    "leakage": 2e-13,
    "transition_reynolds": 10.0,
}
VALVE = nested(CurvedValve, dict.fromkeys(quantities(CurvedValve), 0.0) | NUMBERS)  # no tables
OIL = Liquid(density=870.0, viscosity=0.02)
LINES = SimpleNamespace(supply_pressure=SUPPLY, tank_pressure=TANK)
FULL, SPAN = 10.0, 4.5e6  # V and Pa that the logger writes as 1
NOISE, CODE = 0.004, 2 / 4096  # of the pressure, of what the logger writes
MISSED = slice(330, 338)


def strokes(random):
    """Strokes of a lever [V], back towards the middle when the arm is far out, shape (SAMPLES,)."""
    time, level, far = [0.0, 0.6], [0.0, 0.0], 0.0
    while time[-1] < STEP * SAMPLES:
        sign = -np.sign(far) if abs(far) > 6 else random.choice([-1, 1])
        volts, lengths = (
            sign * random.uniform(0.5, 9.5),
            random.uniform([0.3, 0.3, 0.3, 0.2], [0.9, 2, 0.8, 1.8]),
        )
        time += list(time[-1] + np.cumsum(lengths))  # rise, hold, fall, pause [s]
        level += [volts, volts, 0.0, 0.0]
        far += volts * lengths[1]
    return savgol_filter(np.interp(STEP * np.arange(SAMPLES), time, level), 7, 2)


def machine():
    """(state, command [V]) -> rate of the state, in SI units."""
    x, volts = ca.SX.sym("x", 8), ca.SX.sym("volts")
    p_a, p_b, stroke, speed, bend, arm, spool, slide = ca.vertsplit(x)
    a, b = ports_from_pressure(VALVE, spool, (p_a, p_b), LINES, OIL, None)
    force = BENDING * bend + INNER * (speed - arm)
    friction = VISCOUS * speed + DRY * direction(speed, 0.005)
    rate = ca.vertcat(
        pressure_rate(p_a, a.line - HEAD * speed, HEAD * (LENGTH / 2 + stroke) / BULK),
        pressure_rate(p_b, b.line + ROD * speed, ROD * (LENGTH / 2 - stroke) / BULK),
        speed,
        (HEAD * p_a - ROD * p_b - friction - force) / PISTON,
        speed - arm,
        force / ARM,
        slide,
        SPOOL**2 * (volts - spool) - 2 * RATIO * SPOOL * slide,
    )
    return ca.Function("machine", [x, volts], [rate])


def load_pressure(volts):
    """p_A - p_B B/A [Pa] at the samples: what is left for the load, zero at rest."""
    time, rate = STEP * np.arange(SAMPLES), machine()
    balanced = [6e6 * ROD / HEAD, 6e6, 0, 0, 0, 0, 0, 0]
    small = [10, 10, 1e-7, 1e-7, 1e-8, 1e-7, 1e-6, 1e-5]

    def slope(t, x):
        return rate(x, np.interp(t, time, volts)).full()[:, 0]

    found = solve_ivp(slope, (0, time[-1]), balanced, "BDF", time, max_step=STEP, rtol=1e-6, atol=small)
    return found.y[0] - found.y[1] * ROD / HEAD


if __name__ == "__main__":
    random = np.random.default_rng(SEED)
    volts = strokes(random)
    seen = -load_pressure(volts) / SPAN + random.normal(
        0, NOISE, SAMPLES
    )  # a transducer wired the other way round
    seen = np.clip(CODE * np.round(seen / CODE), -1, 1)
    seen[MISSED] = np.nan
    rows = np.column_stack([volts / FULL, seen])
    np.savetxt(Path(__file__).with_name("crane.txt"), rows, "%.6f")
