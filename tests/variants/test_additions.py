"""Components in addition to those of a model: they do nothing by default, and keep the energy."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from kit.drives import closing_balance, random_point
from kit.equations import SUPPLY, Part
from scipy.integrate import quad

from fmus import boom_stick, swing
from fmus.components.additions import (
    CLOSED,
    Accumulator,
    Addition,
    ChamberReliefs,
    Cushion,
    PistonLeakage,
    Regeneration,
)
from fmus.components.spool_valve import CurvedValve
from fmus.contract import Subsystem, family, nested
from fmus.drives.drive import part
from fmus.drives.lumped import LUMPED
from fmus.drives.quasistatic import QUASISTATIC
from fmus.machine.parts import FAMILIES
from fmus.parameters import numbers
from fmus.supply import CONSUMERS, supply
from orchestrator.base.errors import Problem

# what they do if they act: values of parameters of the boom
CYLINDERS = {
    "leakage": (PistonLeakage, {"conductance": 1e-12}),
    "reliefs": (ChamberReliefs, {"pressure": 8e6, "gain": 1e-9}),
    "cushion": (Cushion, {"length": 0.3, "resistance": 1e12}),
    "regeneration": (Regeneration, {"area": 2e-5}),
}
HEATS = {"leakage": "leakage_heat", "reliefs": "relief_heat"}
HEATS |= {"cushion": "throttle_heat", "regeneration": "check_valve_heat"}


def drives(**additions: type[Addition]) -> Subsystem:
    """The lumped boom and stick drives, the boom with additions."""
    boom, stick = boom_stick.AXES
    axes = (replace(boom, additions=tuple(additions.items())), stick)
    sub = part("boom_stick", axes, LUMPED, text="-", validity="-", values=boom_stick.VALUES)
    return family("boom_stick", **boom_stick.VARIANTS, more=sub)["more"]


def flows(of: Part, states: dict[str, float], **inputs: float) -> dict[str, float]:
    """Flows of the boom's circuit [m3/s] at these states, the others at the start."""
    sub, x = of.sub, dict(zip(of.states, of.start(), strict=True)) | states
    groups = ((sub.states, x), (sub.inputs, of.u | inputs), (sub.parameters, of.p))
    circuit = sub.circuits(*(nested(group, values) for group, values in groups))["boom"]
    return {name: float(ca.DM(flow)) for name, flow in circuit.flows.items()}


def test_flows_of_additions_are_those_of_their_laws():
    """Leakage g dp, a relief valve's straight line, an edge by eq. (1); no flow the other way."""
    added = {name: CYLINDERS[name][0] for name in ("leakage", "reliefs", "regeneration")}
    given = {f"boom_{n}_{k}": v for n in added for k, v in CYLINDERS[n][1].items()}
    of = Part(drives(**added), **given)
    high, low = ({"boom_head_pressure": a, "boom_rod_pressure": b} for a, b in ((1.2e7, 4e6), (4e6, 1.2e7)))
    forward, back = flows(of, high, boom_command=10.0), flows(of, low, boom_command=10.0)
    # at the temperature of the parameters the leakage is as stated; the valve is rounded over 1 bar
    assert forward["leakage"] == pytest.approx(1e-12 * 8e6, rel=1e-12)
    above = 1.2e7 - of.u["tank_pressure"] - 8e6 - 0.5e5
    assert forward["reliefs_head"] == pytest.approx(1e-9 * above, rel=1e-12)
    assert forward["reliefs_rod"] == forward["regeneration"] == 0
    rho, discharge = of.p["density"], of.p["valve_discharge_coefficient"]
    # the transition flow of 0.6 L/min at 80 L/min
    assert back["regeneration"] == pytest.approx(discharge * 2e-5 * np.sqrt(2 * 8e6 / rho), rel=1e-3)
    assert flows(of, low, boom_command=of.p["boom_regeneration_command"])["regeneration"] == 0
    half = flows(of, low, boom_command=5.5)["regeneration"] / back["regeneration"]
    # a straight line, its foot rounded over 0.4 V
    assert half == pytest.approx((4.5 - 0.2) / (9 - 0.2), rel=1e-3)


def test_an_addition_that_does_not_fit_is_told():
    """A cylinder's at a motor, a name that the axis has, and a cushion at lines without oil columns."""
    (axis,), text = swing.AXES, {"text": "-", "validity": "-"}
    leaking = [replace(axis, additions=(("past_piston", PistonLeakage),))]
    with pytest.raises(
        Problem, match=r"^swing: past_piston: expected a node head_pressure, got supply, tank, "
    ):
        part("swing", leaking, LUMPED, **text)
    named = replace(axis, additions=(("leakage", PistonLeakage),))  # a motor has one of its own
    with pytest.raises(Problem, match=r"^Own: leakage is a name in its base already"):
        part("swing", [named], LUMPED, **text)
    boom = replace(boom_stick.AXES[0], additions=(("cushion", Cushion),))
    with pytest.raises(
        Problem, match=r"^cushion: expected lines with oil columns, as in lumped and detailed"
    ):
        part("boom", [boom], QUASISTATIC, **text)


@pytest.mark.parametrize("name", CYLINDERS)
def test_an_addition_does_nothing_by_default(name):
    """Rates and outputs are those of the drives without it, to rounding; its own output is its heat, 0."""
    plain, added = Part(FAMILIES["boom_stick"]["lumped"]), Part(drives(**{name: CYLINDERS[name][0]}))
    rng = np.random.default_rng(1)
    for x, u in (random_point(plain, rng) for _ in range(50)):
        (rates, shown), (other_rates, others) = plain(x, **u), added(x, **u)
        assert other_rates == pytest.approx(rates, rel=1e-12)
        assert others == pytest.approx(shown | {f"boom_{HEATS[name]}": 0.0}, rel=1e-12)


@pytest.mark.parametrize("name", CYLINDERS)
def test_energy_closes_with_an_addition_at_work(name):
    """Power in + convected = d(stored)/dt + heat; the heat of the addition is not negative and not zero."""
    group, values = CYLINDERS[name]
    at_work = Part(drives(**{name: group}), **{f"boom_{name}_{n}": v for n, v in values.items()})
    balance = closing_balance(at_work, at_work.expressions["y"][f"boom_{HEATS[name]}"])
    plain, more, rng = Part(FAMILIES["boom_stick"]["lumped"]), 0.0, np.random.default_rng(2)
    for x, given in (random_point(at_work, rng) for _ in range(50)):
        heat, added = balance(x, **given)
        alone = plain(x, **given)[1]["dissipated_power"]
        assert heat - alone == pytest.approx(added, abs=1e-12 * heat)
        assert added >= 0
        more = max(more, heat - alone)
    assert more > 1.0  # W


def test_a_cushion_stops_the_oil_only_at_the_end_and_only_outwards():
    """dp = R Q^2 at the end of the stroke, none at `length` from the end, none for oil that flows in."""
    plain = Part(FAMILIES["boom_stick"]["lumped"])
    at = plain.at("boom_head_flow")
    inertance = plain.p["boom_hose_inertance"]
    cushioned = Part(drives(cushion=Cushion), boom_cushion_length=0.1, boom_cushion_resistance=1e12)

    def drop(position: float, flow: float) -> float:
        x = plain.start(boom_head_flow=flow)
        one, other = (p(x, boom_position=position)[0][at] for p in (plain, cushioned))
        return float((one - other) * inertance)

    assert drop(0.0, -1e-3) == pytest.approx(-1e6, rel=1e-9)  # Pa; rounding of pressures of 10 MPa
    assert drop(0.1, -1e-3) == 0
    assert drop(0.0, 1e-3) == 0


def test_an_accumulator_holds_the_energy_of_its_gas():
    """Its stored energy is the integral of P dV of p V^n = constant, none below the precharge."""
    gas = Accumulator(volume=1e-2, precharge=9e6, exponent=1.4, conductance=1e-9)
    start = 9e6 + 101325.0

    def slope(pressure: float) -> float:  # dV/dP of V_0 (1 - (p_0/p)^(1/n))
        return (start / (pressure + 101325.0)) ** (1 / 1.4) / 1.4 / (pressure + 101325.0)

    energy = quad(lambda p: p * slope(p), 9e6, 2e7, epsrel=1e-12)[0] + CLOSED * slope(9e6) * 9e6**2 / 2
    assert float(gas.energy_density(2e7)) == pytest.approx(energy, rel=1e-9)  # of the quadrature
    assert float(gas.compliance(2e7)) == pytest.approx(slope(2e7), rel=1e-12)
    assert float(gas.compliance(5e6)) == pytest.approx(CLOSED * slope(9e6), rel=1e-12)


@pytest.mark.parametrize("variant", ["engine_pump", "load_sensing"])
def test_an_accumulator_at_the_supply(variant):
    """Shut off it changes nothing; open, it takes oil from the line, and the energy of the supply closes."""
    sub = supply(CONSUMERS, additions={"accumulator": Accumulator})[variant]
    plain, shut = Part(FAMILIES["supply"][variant]), Part(sub)
    x, own, gas = plain.start(), shut.start(), shut.at("accumulator_pressure")
    others = [i for i in range(own.size) if i != gas]
    assert own[gas] == shut.p["accumulator_precharge"]
    assert own[others] == pytest.approx(x, rel=1e-12)
    assert shut(own)[0][others] == pytest.approx(plain(x)[0], rel=1e-12)
    at_work = Part(sub, accumulator_conductance=1e-8)
    y, u = at_work.expressions["y"], at_work.expressions["u"]
    delivered = y["supply_pressure"] * y["supply_flow"] - y["tank_pressure"] * y["return_flow"]
    powers = y["engine_power"] - delivered, at_work.along(y["stored_energy"]), y["dissipated_power"]
    balance = at_work.of(*powers)
    rng = np.random.default_rng(3)
    for _ in range(20):
        state = own * rng.uniform(0.9, 1.1, own.size)
        state[gas] = rng.uniform(5e6, SUPPLY)
        given = {n: rng.uniform(0, 1e-3) for n in u if "flow" in n}
        power, stored, heat = (b.item() for b in balance(state, **given))
        assert power - stored - heat == pytest.approx(0, abs=1e-9 * (abs(power) + abs(stored) + heat))
        drop, shown = state[at_work.at("supply_pressure")] - state[gas], at_work(state, **given)[1]
        assert shown["throttle_heat"] == pytest.approx(1e-8 * drop**2, rel=1e-12)
        assert shown["accumulator_pressure"] == state[gas]


class Progressive(CurvedValve):
    """A valve whose edges open with the square of the command beyond the dead band."""

    def openings(self, command):
        """Openings by edge."""
        return {edge: opening**2 for edge, opening in super().openings(command).items()}


def test_a_drive_with_another_valve_is_one_class():
    """At half of the travel its edges have a quarter of the area, not a half: half of the flow."""
    usual = FAMILIES["boom_stick"]["quasistatic"]
    own = part("drive", boom_stick.AXES, replace(QUASISTATIC, valve=Progressive), text="-", validity="-")
    of, other = Part(usual), Part(replace(own, numbers=numbers(usual)))
    foot = of.p["valve_dead_band"] + of.p["valve_command_rounding"] / 2
    half = (of.p["valve_full_command"] + foot) / 2
    small, line = (o(o.start(), boom_command=half)[1]["boom_head_flow"] for o in (other, of))
    # the friction of the hose, which is in series, takes more of the larger flow
    assert small / line == pytest.approx(0.5, rel=0.1)
    assert small < 0.6 * line
