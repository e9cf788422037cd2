"""Linear models against closed forms of hydraulics, and exact eigenvalues."""

import math
from decimal import Decimal, localcontext

import numpy as np
import pytest
from kit.equations import SUPPLY, edge_resistance, piston_areas, steady_velocity
from kit.fmu import driving

from fmus.machine.parts import FERIC
from fmus.parameters import values
from orchestrator import linearize
from orchestrator.linear.modes import eigen

OIL, SWING = (values(FERIC.subsystems[n]).p for n in ("boom_stick", "swing"))
BAR = 5e-3  # the bar of all closed forms: leakage, friction, inertia of the oil lie below


def stiffness(name, position):
    """beta (A_h^2/V_h + A_r^2/V_r) of a locked cylinder with its hoses [N/m]."""
    head, rod = piston_areas(OIL, name)
    beta, dead = OIL["bulk_modulus"], OIL[f"{name}_dead_volume"]
    hose = OIL[f"{name}_hose_capacitance"] * beta
    v_rod = hose + dead + rod * (OIL[f"{name}_stroke"] - position)
    return beta * (head**2 / (hose + dead + head * position) + rod**2 / v_rod)


@pytest.mark.parametrize("pose", ["reach", "close"])
def test_frequencies_are_hydraulic_stiffness_over_inertia(fmu_dir, pose):
    """Valves closed: swing by 2 (D_m N)^2/(C J), boom and stick by eig(M^-1 K) at their pistons."""
    linear = linearize(fmu_dir / "harvester.ssp", parameters=[pose], steady=True)
    at = {s.name: v for s, v in zip(linear.states, linear.x0, strict=True)}
    y = {s.name: v for s, v in zip(linear.outputs, linear.y0, strict=True)}
    angles = {f"initial_{j}_angle": at[f"manipulator.{j}_angle"] for j in ("boom", "stick")}
    pistons = ("boom", "stick")
    with driving(fmu_dir / "manipulator.fmu", "me", **angles) as arm:
        turning = arm.derivative(["swing_acceleration"], ["swing_torque"])[0, 0]
        mobility = arm.derivative([f"{j}_acceleration" for j in pistons], [f"{j}_force" for j in pistons])
    oil = [stiffness(j, y[f"manipulator.{j}_position"]) for j in pistons]
    displacement = SWING["motor_displacement"] * SWING["gear_ratio"]
    squares = [2 * displacement**2 / SWING["line_capacitance"] * turning, *np.linalg.eigvals(mobility * oil)]
    found = sorted(m.frequency for m in linear.modes if m.oscillates)
    np.testing.assert_allclose(found, np.sort(np.sqrt(squares)) / (2 * math.pi), rtol=BAR)


@pytest.mark.parametrize("pose", ["reach", "close"])
def test_the_gain_from_command_to_speed_is_the_slope_of_the_valve(fmu_dir, pose):
    """-C A^-1 B, angles fixed, is dv/du of v = sqrt((A_h P_s - F)/(C_R (A_h^3 + A_r^3))), written by hand."""
    names = ["manipulator.boom_velocity", "boom_stick.boom_force"]
    chosen = {"parameters": pose, "inputs": "boom_command", "outputs": names}
    linear = linearize(fmu_dir / "harvester.ssp", steady=True, speeds={"boom": 0.2}, **chosen)
    quick = [i for i, s in enumerate(linear.states) if not s.name.endswith("_angle")]
    steady = np.linalg.solve(linear.a[np.ix_(quick, quick)], linear.b[quick])
    speed_gain, force_gain = (linear.d - linear.c[:, quick] @ steady).ravel()
    (speed, force), command = linear.y0, linear.u0[0]
    assert speed == pytest.approx(steady_velocity(OIL, "boom", command, force), rel=BAR)
    edge, drive = edge_resistance(OIL, command), piston_areas(OIL, "boom")[0] * SUPPLY - force
    resistance = edge + OIL["boom_hose_resistance"]
    beyond = command - OIL["valve_dead_band"] - OIL["valve_command_rounding"] / 2
    slope = speed * edge / resistance / beyond - speed / (2 * drive) * force_gain  # friction grows with speed
    assert speed_gain == pytest.approx(slope, rel=BAR)


# ---- matrices with rates from 1e-6 to 1e7 1/s: against a diagonal, and against 80 digits


SAME = 1e-6  # relative, what is promised of eigenvalues
DIGITS = 80  # rates reach 1e13: so many that none of what is seen here is rounding


def resolvent_trace(a, value):
    """tr (s - A)^-1 = p'(s)/p(s) with p the characteristic polynomial, by Gauss-Jordan on real blocks."""
    n, decimal = len(a), np.vectorize(Decimal, otypes=[object])
    one = decimal(np.eye(n))
    real, imaginary = decimal(-a) + Decimal(value.real) * one, Decimal(value.imag) * one
    m = np.block([[real, -imaginary, one], [imaginary, real, decimal(np.zeros((n, n)))]])
    for k in range(2 * n):
        pivot = k + int(np.argmax(np.abs(m[k:, k])))
        if not m[pivot, k]:
            return math.inf  # an exact eigenvalue, such as that of a lag by itself
        m[[k, pivot]] = m[[pivot, k]]
        m[k] = m[k] / m[k, k]
        others = np.flatnonzero((np.arange(2 * n) != k) & (m[:, k] != 0))
        m[others] = m[others] - m[others, k][:, None] * m[k]
    return complex(float(np.trace(m[:n, 2 * n :])), float(np.trace(m[n:, 2 * n :])))


@pytest.mark.parametrize(("pose", "swap"), [("folded", {}), ("reach", {"swing": "detailed"})])
def test_eigenvalues_of_the_machine_are_those_of_80_digits(fmu_dir, pose, swap):
    """|s - s_k| <= n |p(s)/p'(s)| for some eigenvalue s_k (Laguerre): each s found, to 1e-6 of itself."""
    linear = linearize(fmu_dir / "harvester.ssp", parameters=[pose], steady=True, swap=swap)
    size = np.array([s.nominal for s in linear.states])
    with localcontext() as context:
        context.prec = DIGITS
        for value in eigen(linear.a, size)[0]:
            if value and value.imag >= 0.0:  # zero is exact: the column of the swing angle is
                distance = len(size) / abs(resolvent_trace(linear.a, complex(value)))
                assert distance <= SAME * abs(value), value
    assert sum(eigen(linear.a, size)[0] == 0.0) == sum(~linear.a.any(axis=0))


def test_eigenvalues_of_mixed_scales_are_those_of_the_diagonal():
    """Rates from 1e-6 to 1e7 on the diagonal of a triangular matrix, its rows mixed, in Pa and in m3/s."""
    wanted = -np.array([9.1e6, 1e-6, 20.0, 9e6, 3e-3, 4e3, 0.5])
    rng = np.random.default_rng(0)
    triangular = wanted[:, None] * (np.eye(7) + np.triu(rng.uniform(-1, 1, (7, 7)), 1))
    place, size = rng.permutation(7), np.array([1.0, 1e7, 1e-3, 1.0, 1e7, 1e-3, 1.0])
    found = eigen((size[:, None] * triangular / size)[np.ix_(place, place)], size[place])[0]
    assert not found.imag.any()
    # hundredth of what is promised
    np.testing.assert_allclose(np.sort(found.real), np.sort(wanted), rtol=1e-8)
