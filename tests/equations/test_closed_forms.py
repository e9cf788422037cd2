"""Steady values and frequencies against closed forms, through the FMUs (bars: 0.5 %)."""

import math

import numpy as np
import pytest
from kit.equations import SUPPLY, edge_resistance, piston_areas, steady_velocity
from kit.fmu import driving
from scipy.optimize import brentq, fsolve

from fmus.machine.parts import FERIC
from fmus.parameters import values

BAR = 5e-3  # the stated bar: rounding of |Q| at Q_t and the leakage of closed edges lie below
BOOM_STICK, SWING = (values(FERIC.subsystems[n]).p for n in ("boom_stick", "swing"))


def settled_force(path, name: str, command: float, velocity: float) -> float:
    """Force of a cylinder moved at a constant velocity, after the oil has settled."""
    with driving(path, **{f"{name}_command": command, f"{name}_velocity": velocity}) as fmu:
        return float(fmu.step(0.05, 40).get(f"{name}_force")[0])


# each pair of a cylinder, a direction and a load once
@pytest.mark.parametrize(
    ("name", "command", "load"),
    [("boom", 10.0, 0.0), ("boom", -4.0, 50e3), ("stick", 4.0, 50e3), ("stick", -10.0, 0.0)],
)
def test_cylinder_speeds(fmu_dir, name, command, load):
    """Steady speed by the closed form: extension and retraction, free and under load."""
    expected = steady_velocity(BOOM_STICK, name, command, load)
    path = fmu_dir / "boom_stick.fmu"
    found = brentq(lambda v: settled_force(path, name, command, v) - load, 0.9 * expected, 1.1 * expected)
    assert found == pytest.approx(expected, rel=BAR)


@pytest.mark.parametrize("load", [0.0, 5e3])
def test_swing_speed_with_leakage(fmu_dir, load):
    """Swing speed from orifice, line and leakage equations written out here, eqs. (1), (8), (11), (12)."""
    command, friction = 5.0, 300.0
    c_r, d = edge_resistance(SWING, command), SWING["motor_displacement"] * SWING["gear_ratio"]
    r, r_in, r_ex = (
        SWING[n] for n in ("line_resistance", "internal_leakage_resistance", "external_leakage_resistance")
    )

    def equations(z):
        q1, q2, w, p1, p2 = z * (1e-3, 1e-3, 1.0, 1e7, 1e7)
        drops = SUPPLY - c_r * q1 * abs(q1) - r * q1 - p1, p2 - r * q2 - c_r * q2 * abs(q2)
        flows = q1 - d * w - (p1 - p2) / r_in - p1 / r_ex, d * w + (p1 - p2) / r_in - p2 / r_ex - q2
        return np.array([*drops, *flows, d * (p1 - p2) - friction * w - load]) / (1e7, 1e7, 1e-3, 1e-3, 1e4)

    expected = fsolve(equations, [1.0, 1.0, 1.0, 1.0, 1.0], xtol=1e-12)[2]

    def excess(speed: float) -> float:
        with driving(fmu_dir / "swing.fmu", swing_command=command, swing_speed=speed) as fmu:
            return float(fmu.step(0.05, 60).get("swing_torque")[0]) - friction * speed - load

    assert brentq(excess, 0.9 * expected, 1.1 * expected) == pytest.approx(expected, rel=BAR)


@pytest.mark.parametrize("name", ["boom", "stick"])
def test_hydraulic_natural_frequency(fmu_dir, name):
    """omega^2 = beta (A_h^2/V_h + A_r^2/V_r) / m of a mass on the locked cylinder, by FMU Jacobian."""
    mass, position = 1e4, 0.3
    (head, rod), p, beta = piston_areas(BOOM_STICK, name), BOOM_STICK, BOOM_STICK["bulk_modulus"]
    both = p[f"{name}_hose_capacitance"] * beta + p[f"{name}_dead_volume"]
    v_head, v_rod = both + head * position, both + rod * (p[f"{name}_stroke"] - position)
    expected = math.sqrt(beta * (head**2 / v_head + rod**2 / v_rod) / mass)
    oil = [f"{name}_{s}_{k}" for k in ("pressure", "flow") for s in ("head", "rod")]
    with driving(fmu_dir / "boom_stick.fmu", "me", **{f"{name}_position": position}) as fmu:
        rates = [f"der_{n}" for n in oil]
        a_oil, b_velocity = fmu.derivative(rates, oil), fmu.derivative(rates, [f"{name}_velocity"])
        c_force = fmu.derivative([f"{name}_force"], oil)
    system = np.block([[a_oil, b_velocity], [c_force / mass, np.zeros((1, 1))]])
    slow = [e for e in np.linalg.eigvals(system) if abs(e.imag) > 1.0]
    assert min(abs(e.imag) for e in slow) == pytest.approx(expected, rel=BAR)
