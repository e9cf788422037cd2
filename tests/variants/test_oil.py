"""Oil with air: its modulus, its energy, and the chamber of `lumped` when there is none."""

import math

import casadi as ca
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fmus.components import chamber
from fmus.components.chamber import ATMOSPHERE, FLOOR, Fluid

BETA = 1.6e9
pressures = st.floats(-1.5e5, 4e7)


def fluid(air: float = 0.01, exponent: float = 1.4) -> Fluid:
    return Fluid(density=970.0, viscosity=0.02, bulk_modulus=BETA, air_share=air, air_exponent=exponent)


def number(value: object) -> float:
    return float(ca.DM(value))


def mixture(air: float, exponent: float, absolute: float) -> float:
    """Bulk modulus of the mixture of V20, per volume that it has at this pressure."""
    liquid = (1 - air) * math.exp(-(absolute - ATMOSPHERE) / BETA)
    gas = air * (ATMOSPHERE / absolute) ** (1 / exponent)
    return (liquid + gas) / (liquid / BETA + gas / (exponent * absolute))


@given(st.floats(1e6, 4e7), st.floats(0.0, 0.01), st.floats(1.01, 1.4))
def test_modulus_is_that_of_the_mixture_above_ten_bar(absolute, air, exponent):
    """V20: within 0.3 % for up to 1 % of air, at least 10 bar absolute. V20's share is of the whole."""
    found = number(chamber.bulk_modulus(fluid(air / (1 - air), exponent), absolute - ATMOSPHERE))
    # what the module says: the volume of the air is neglected beside that of the oil
    assert found == pytest.approx(mixture(air, exponent, absolute), rel=3e-3)


@given(st.floats(0.0, 0.02), st.floats(1.01, 1.4))
def test_modulus_at_atmospheric_pressure_is_off_by_the_share_of_air(air, exponent):
    """V20 at 1 bar: by the share of air itself."""
    found = number(chamber.bulk_modulus(fluid(air / (1 - air), exponent), 0.0))
    # exact identity: both compliances have the same terms, V20's times 1 - air
    expected = mixture(air, exponent, ATMOSPHERE) * (1 - air)
    assert found == pytest.approx(expected, rel=1e-12)


@given(pressures)
def test_oil_without_air_is_the_chamber_of_lumped(pressure):
    """No air: modulus, pressure rate and energy are those of `fmus.components.chamber`, cavity and all."""
    plain, volume, net = fluid(0.0), 3e-3, 1e-4
    # exact identities: rounding of the closed forms
    assert number(chamber.bulk_modulus(plain, pressure)) == pytest.approx(BETA, rel=1e-14)
    capacitance = volume * chamber.compliance(plain, pressure)
    assert number(chamber.pressure_rate(pressure, net, capacitance)) == pytest.approx(
        number(chamber.pressure_rate(pressure, net, volume / BETA)), rel=1e-12
    )
    energy = volume * chamber.energy_density(plain, pressure) + chamber.stored_energy(pressure, 0.0)
    assert number(energy) == pytest.approx(number(chamber.stored_energy(pressure, volume / BETA)), rel=1e-12)


P = ca.SX.sym("P")
AIR, EXPONENT = ca.SX.sym("air"), ca.SX.sym("exponent")
MIXED = fluid(AIR, EXPONENT)
SLOPES = ca.Function(
    "slopes",
    [P, AIR, EXPONENT],
    [
        chamber.compliance(MIXED, P),
        ca.jacobian(chamber.energy_density(MIXED, P), P),
        ca.jacobian(chamber.compliance(MIXED, P), P),
    ],
)


@given(st.floats(-3e5, 4e7), st.floats(0.0, 0.05), st.floats(1.01, 1.7))
def test_energy_is_the_integral_of_pressure_over_volume(pressure, air, exponent):
    """de/dP = P kappa(P), on the polytropic law and on the tangent below it; e(0) = 0."""
    compliance, slope, _ = (float(v) for v in SLOPES(pressure, air, exponent))
    # exact identity; the closed form is a difference of terms 1/(1 - 1/n) = 100 times as large
    assert slope == pytest.approx(pressure * compliance, rel=1e-10, abs=1e-9)
    # rounding of terms of air p_0/(1 - 1/n), up to 5e5 J/m3
    assert number(chamber.energy_density(fluid(air, exponent), 0.0)) == pytest.approx(0.0, abs=1e-8)


@given(st.floats(-1e12, 1e12), st.floats(0.0, 0.05))
def test_compliance_is_finite_and_above_that_of_oil_at_any_trial_pressure(pressure, air):
    """No pressure that a solver may try, below vacuum or not, gives an infinite or too small compliance."""
    compliance, slope, bend = (float(v) for v in SLOPES(pressure, air, 1.4))
    assert compliance >= 1 / BETA * (1 - 1e-14)
    assert all(map(math.isfinite, (compliance, slope, bend)))
    assert bend <= 0  # oil gets stiffer with pressure


def test_compliance_has_no_kink_at_the_floor():
    """Value and slope of the compliance are the same on both sides of the absolute pressure FLOOR."""
    at = FLOOR - ATMOSPHERE
    below, above = (SLOPES(at + d, 0.01, 1.4) for d in (-1e-3, 1e-3))
    # 2 mPa apart: the curvature there changes the slope by 1e-6 of it
    assert float(below[0]) == pytest.approx(float(above[0]), rel=1e-6, abs=0)
    assert float(below[2]) == pytest.approx(float(above[2]), rel=1e-6, abs=0)
