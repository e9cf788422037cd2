"""Oil with air: its modulus, its energy, and the chamber of `lumped` when there is none; its viscosity."""

import math

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from kit.equations import Part, number
from kit.fmu import driving

from fmus.components import chamber, oil
from fmus.components.chamber import ATMOSPHERE, FLOOR, AeratedOil
from fmus.machine.parts import FAMILIES
from fmus.parameters import values
from orchestrator import load

BETA = 1.6e9
pressures = st.floats(-1.5e5, 4e7)


def fluid(air: float = 0.01, exponent: float = 1.4) -> AeratedOil:
    return AeratedOil(density=970.0, viscosity=0.02, bulk_modulus=BETA, air_share=air, air_exponent=exponent)


def mixture(air: float, exponent: float, absolute: float) -> float:
    """Bulk modulus of the mixture of V20, per volume that it has at this pressure."""
    liquid = (1 - air) * math.exp(-(absolute - ATMOSPHERE) / BETA)
    gas = air * (ATMOSPHERE / absolute) ** (1 / exponent)
    return (liquid + gas) / (liquid / BETA + gas / (exponent * absolute))


@given(st.floats(1e6, 4e7), st.floats(0.0, 0.01), st.floats(1.01, 1.4))
def test_modulus_is_that_of_the_mixture_above_ten_bar(absolute, air, exponent):
    """V20: within 0.3 % for up to 1 % of air, at least 10 bar absolute. V20's share is of the whole."""
    found = 1 / number(fluid(air / (1 - air), exponent).compliance(absolute - ATMOSPHERE))
    # what the module says: the volume of the air is neglected beside that of the oil
    assert found == pytest.approx(mixture(air, exponent, absolute), rel=3e-3)


@given(st.floats(0.0, 0.02), st.floats(1.01, 1.4))
def test_modulus_at_atmospheric_pressure_is_off_by_the_share_of_air(air, exponent):
    """V20 at 1 bar: by the share of air itself."""
    found = 1 / number(fluid(air / (1 - air), exponent).compliance(0.0))
    # exact identity: both compliances have the same terms, V20's times 1 - air
    assert found == pytest.approx(mixture(air, exponent, ATMOSPHERE) * (1 - air), rel=1e-12)


@given(pressures)
def test_oil_without_air_is_the_chamber_of_lumped(pressure):
    """No air: modulus, pressure rate and energy are those of `fmus.components.chamber`, cavity and all."""
    plain, volume, net = fluid(0.0), 3e-3, 1e-4
    # exact identities: rounding of the closed forms
    assert 1 / number(plain.compliance(pressure)) == pytest.approx(BETA, rel=1e-14)
    found, expected = (volume * plain.compliance(pressure), volume / BETA)
    rates = [number(chamber.pressure_rate(pressure, net, c)) for c in (found, expected)]
    assert rates[0] == pytest.approx(rates[1], rel=1e-12)
    energy = volume * plain.energy_density(pressure) + chamber.stored_energy(pressure, 0.0)
    assert number(energy) == pytest.approx(number(chamber.stored_energy(pressure, volume / BETA)), rel=1e-12)


P, AIR, EXPONENT = (ca.SX.sym(n) for n in ("P", "air", "exponent"))
MIXED = fluid(AIR, EXPONENT)
KAPPA = MIXED.compliance(P)
RATES = [KAPPA, ca.jacobian(MIXED.energy_density(P), P), ca.jacobian(KAPPA, P)]
SLOPES = ca.Function("slopes", [P, AIR, EXPONENT], RATES)


@given(st.floats(-3e5, 4e7), st.floats(0.0, 0.05), st.floats(1.01, 1.7))
def test_energy_is_the_integral_of_pressure_over_volume(pressure, air, exponent):
    """de/dP = P kappa(P), on the polytropic law and on the tangent below it; e(0) = 0."""
    compliance, slope, _ = (float(v) for v in SLOPES(pressure, air, exponent))
    # exact identity; the closed form is a difference of terms 1/(1 - 1/n) = 100 times as large
    assert slope == pytest.approx(pressure * compliance, rel=1e-10, abs=1e-9)
    # rounding of terms of air p_0/(1 - 1/n), up to 5e5 J/m3
    assert number(fluid(air, exponent).energy_density(0.0)) == pytest.approx(0.0, abs=1e-8)


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
    for k in (0, 2):  # 2 mPa apart: the curvature there changes the slope by 1e-6 of it
        assert float(below[k]) == pytest.approx(float(above[k]), rel=1e-6, abs=0)


@given(st.floats(-20.0, 100.0))
def test_viscosity_is_a_straight_line_on_the_chart_of_astm_d341(celsius):
    """lg lg (nu + 0.7) over lg T, through the middle of ISO VG 46 at 40 degC and 6.8 mm2/s at 100 degC."""

    def chart(kelvin):
        return math.log10(math.log10(1e6 * number(oil.kinematic_viscosity(kelvin)) + 0.7))

    kelvin, (cold, hot) = celsius + 273.15, (313.15, 373.15)
    share = (math.log10(kelvin) - math.log10(cold)) / (math.log10(hot) - math.log10(cold))
    expected = (1 - share) * math.log10(math.log10(46.7)) + share * math.log10(math.log10(7.5))
    assert chart(kelvin) == pytest.approx(expected, rel=1e-12)  # exact identity, rounding


# mPa.s at 30, 60, 100 degC of oils near ISO VG 46: Stachowiak and Batchelor, Engineering Tribology, table 2.3
PUBLISHED = [(107.0, 23.3, 6.4), (122.0, 26.3, 7.3), (45.0, 12.0, 3.9), (38.0, 12.1, 5.3)]


def test_viscosity_falls_as_that_of_published_oils():
    """From 30 to 60 and from 60 to 100 degC by a factor between those of the four published oils."""
    cold, warm, hot = (number(oil.viscosity_ratio(t + 273.15)) for t in (30.0, 60.0, 100.0))
    assert warm == 1.0
    for found, ratios in ((cold, [a / b for a, b, _ in PUBLISHED]), (hot, [c / b for _, b, c in PUBLISHED])):
        assert min(ratios) < found < max(ratios)


def test_density_and_modulus_fall_with_the_temperature():
    """Density by 7e-4/K, of mineral oils; 1.6 GPa at 60 degC are 1.95 at 20 and 1.38 at 90, as in data."""
    assert number(oil.density_ratio(333.15)) == 1.0
    assert 1 / number(oil.density_ratio(343.15)) - 1 == pytest.approx(7e-3, rel=1e-9)  # rounding
    found = [1.6 * number(oil.bulk_modulus_ratio(t + 273.15)) for t in (20.0, 60.0, 90.0)]
    assert found == pytest.approx([2.0, 1.6, 1.3], rel=0.06)
    slope = math.log(found[0] / found[2]) / 70.0
    assert slope == pytest.approx(5e-3, rel=1e-9)  # exact identity


def test_a_winter_oil_is_thinner_in_the_cold():
    """HVLP of index 150: at -20 degC less than half of the default oil, at 40 degC the same."""
    winter = oil.Grade(oil_viscosity_40=46e-6, oil_viscosity_100=8.2e-6)
    cold, usual = (number(oil.viscosity_ratio(t, winter) / oil.viscosity_ratio(t)) for t in (253.15, 313.15))
    assert cold < 0.5
    assert usual == pytest.approx(1.0, rel=1e-12)  # rounding
    refused = oil.Grade(oil_viscosity_40=6e-6, oil_viscosity_100=8.2e-6)
    assert min(number(m) for m in oil.is_oil(refused).values()) < 0


def test_hoses_of_compensated_drives_have_walls():
    """A l (1/beta + 1/E_wall) of 3/4 in with 1.6e9 and 0.6e9 Pa: 3.67 times that of a rigid hose."""
    soft, rigid = (values(FAMILIES["boom_stick"][v]).p for v in ("compensated", "lumped"))
    metre = math.pi / 4 * 0.01905**2 * (1 / 1.6e9 + 1 / 6e8)
    for name, metres in (("boom_hose_capacitance", 3.0), ("stick_hose_capacitance", 4.0)):
        assert soft[name] == pytest.approx(metres * metre, rel=1e-12)
        assert soft[name] / rigid[name] == pytest.approx(1 + 16 / 6, rel=1e-12)
    swing = values(FAMILIES["swing"]["compensated"]).p["line_capacitance"]
    assert swing == pytest.approx(metre + 1.215e-3 / 1.6e9, rel=1e-12)


@pytest.mark.parametrize("kind", ["cs", "me"])
@pytest.mark.parametrize("part", ["boom_stick", "swing"])
def test_an_fmu_follows_the_temperature_that_is_set(fmu_dir, part, kind):
    """After some steps the oil is colder, then as warm as before: each time the outputs of the equations."""
    model = Part(FAMILIES[part]["lumped"])
    with driving(fmu_dir / f"{part}.fmu", kind, **{f"{model.sub.part.split('_')[0]}_command": 4.0}) as fmu:
        if kind == "cs":
            fmu.step(1e-3, 20)
        x = np.array(fmu.get(*model.states))
        u = dict(zip(model.inputs, fmu.get(*model.inputs), strict=True))
        seen = []
        for kelvin in (333.15, 268.15, 333.15):
            fmu.set(oil_temperature=kelvin)
            _, y = model(x, **u | {"oil_temperature": kelvin})
            seen.append(fmu.get(*model.outputs))
            # the same formulas in another order; flows that nearly cancel
            assert seen[-1] == pytest.approx([*y.values()], rel=1e-8, abs=1e-12)
        assert (seen[0] == seen[2]).all()
        assert (seen[0] != seen[1]).any()
        fmu.set(oil_temperature=0.0)  # as many tools do with an open input: 60 degC
        assert (fmu.get(*model.outputs) == seen[0]).all()


def test_a_temperature_that_is_set_replaces_that_of_the_supply(fmu_dir):
    """Cold oil in the boom alone; each other connected input is refused, see test_system.toml."""
    system = load(fmu_dir / "harvester.ssp")
    cold = system.with_start({"boom_stick.oil_temperature": "0degC"})
    assert cold.components["boom_stick"].value("oil_temperature") == pytest.approx(273.15)
    (left,) = set(system.connections) - set(cold.connections)
    assert str(left) == "supply.oil_temperature -> boom_stick.oil_temperature"
    assert "boom_stick.oil_temperature is set, which replaces its connection" in cold.notes[-1]


def test_a_saved_state_has_its_temperature(fmu_dir):
    """A state that was saved in cold oil continues in cold oil, also after a warm step."""
    ends = []
    with driving(fmu_dir / "boom_stick.fmu", boom_command=4.0, oil_temperature=263.15) as fmu:
        saved = fmu.state()
        fmu.step(5e-3)
        ends.append(fmu.get("boom_head_pressure"))
        fmu.set(oil_temperature=333.15)
        fmu.step(5e-3)
        fmu.restore(saved, 0.0)
        fmu.step(5e-3)
        ends.append(fmu.get("boom_head_pressure"))
    assert ends[0] == ends[1]
