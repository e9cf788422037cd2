"""Circuits: closed forms of a small one, the paper's Figs. 2 and 3, and what holds in every variant."""

import casadi as ca
import numpy as np
import pytest
from kit.equations import JOINTS, number

from fmus.components.chamber import AeratedOil
from fmus.components.circuit import CAUSES, GROUND, SUPPLY, TANK, WORK, Branch, Circuit, Kind, Node
from fmus.contract import Subsystem, column, quantities, stack, symbols
from fmus.machine.parts import FAMILIES
from fmus.parameters import values

VARIANTS = {
    f"{part} {variant}": sub
    for part, variants in FAMILIES.items()
    for variant, sub in variants.items()
    if part != "manipulator"
}


def small() -> Circuit:
    """Supply -> throttle -> chamber <- piston, and chamber -> relief valve, hose -> return line."""
    return Circuit(
        {
            SUPPLY: Node(20e6),
            TANK: Node(1e6),
            GROUND: Node(0.0),
            "chamber": Node(5e6, "C", 3e-12),
        },
        {
            "throttle": Branch(SUPPLY, "chamber", Kind.THROTTLE, lambda drop: drop / 1e10),
            "relief": Branch("chamber", TANK, Kind.RELIEF, 2e-4),
            "hose": Branch("chamber", TANK, Kind.COLUMN, 1e-3, "I", 2e7, 0.5e6),
            "piston": Branch(GROUND, "chamber", Kind.PISTON, 4e-4),
        },
    )


def test_rates_and_balances_of_a_small_circuit():
    """Worked out by hand: 1.5 mL/s come through the throttle, 0.4 from the piston, 1.2 leave."""
    c = small()
    # rounding; the cavity at 5 MPa is exp(-60) of 1e-12 m3/Pa
    assert number(c.rates["chamber"]) == pytest.approx((1.5e-3 + 4e-4 - 1.2e-3) / 3e-12, rel=1e-12)
    assert c.rates["hose"] == pytest.approx((5e6 - 1e6 - 0.5e6) / 2e7, rel=1e-12)
    assert c.heat() == pytest.approx({"throttle": 22500.0, "relief": 800.0, "hose": 500.0}, rel=1e-12)
    assert c.work(Kind.PISTON) == pytest.approx(-2000.0, rel=1e-12)
    found = c.outputs()
    expected = {"supply_flow": 1.5e-3, "return_flow": 1.2e-3, "relief_flow": 2e-4}
    expected |= {"dissipated_power": 23800.0, "stored_energy": 37.5 + 10.0}
    assert {n: number(found[n]) for n in expected} == pytest.approx(expected, rel=1e-12)


def test_heat_of_a_small_circuit_by_cause():
    """1 kW in a hose of which a quarter is a throttle, and an edge at the supply line with a compensator."""
    series = {Kind.COMPENSATOR: 7e6, Kind.RESISTANCE: lambda flow: 1e9 * flow}
    c = small() | Circuit(
        {},
        {
            "hose": Branch("chamber", TANK, Kind.COLUMN, 1e-3, "I", 2e7, 1e6, series={Kind.THROTTLE: 0.25e6}),
            "in": Branch(SUPPLY, "chamber", Kind.EDGE, 1e-3, series=series),
            "out": Branch("chamber", TANK, Kind.EDGE, 2e-3),
        },
    )
    expected = {"hose_heat": 750.0 + 1000.0, "throttle_heat": 250.0 + 22500.0, "relief_heat": 800.0}
    expected |= {"compensator_heat": 7000.0, "meter_in_heat": 7000.0, "meter_out_heat": 8000.0}
    assert c.heats == pytest.approx(expected, rel=1e-12)
    assert {kind for kind in Kind if kind not in WORK | {Kind.CAPACITANCE, Kind.GIVEN}} == {*CAUSES}


def test_power_into_a_node_is_what_it_stores_and_what_its_oil_takes_along():
    """P (C + V kappa + C_c) dP/dt = dE/dt, cavity and air included; a piston takes e of the oil with it."""
    pressure = ca.SX.sym("P")
    oil = AeratedOil(density=870.0, viscosity=0.02, bulk_modulus=1.6e9, air_share=0.01, air_exponent=1.4)
    node = Node(pressure, "C", 2e-12, 4e-3, oil, cavity=0.5)
    circuit = Circuit(
        {"a": node, GROUND: Node(0)}, {"piston": Branch("a", GROUND, Kind.PISTON, ca.SX(-3e-4), "gy_1")}
    )
    rate = circuit.rates["a"]
    growth = ca.jacobian(circuit.stored_energy, pressure) * rate
    found = ca.Function("f", [pressure], [growth, pressure * 3e-4, circuit.convected_power])
    for p in (2e7, 1e5, -3e4):
        energy, power, convected = (float(v) for v in found(p))
        # exact identity; the closed form of e is a difference of terms 100 times as large
        assert energy == pytest.approx(power, rel=1e-9)
        density = ca.Function("e", [pressure], [oil.energy_density(pressure)])
        assert convected == pytest.approx(-3e-4 * float(density(p)), rel=1e-12)


# ---- the paper's figures: its branches, by symbol, between the nodes of the variant

FIG_2 = {
    ("C_R", SUPPLY, "valve_pressure_a"),
    ("I_1", "valve_pressure_a", "pressure_a"),
    ("R_1", "pressure_a", "motor_pressure_a"),
    ("R_in", "motor_pressure_a", "motor_pressure_b"),
    ("D_m N", "motor_pressure_a", "motor_pressure_b"),
    ("R_e1", "motor_pressure_a", TANK),
    ("R_e2", "motor_pressure_b", TANK),
    ("R_2", "motor_pressure_b", "pressure_b"),
    ("I_2", "pressure_b", "valve_pressure_b"),
    ("C_Re", "valve_pressure_b", TANK),
}
FIG_3 = {
    ("C_R", SUPPLY, "head_valve_pressure"),
    ("I_1, R_1", "head_valve_pressure", "head_pressure"),
    ("gy_1", "head_pressure", GROUND),
    ("gy_2", GROUND, "rod_pressure"),
    ("I_2, R_2", "rod_pressure", "rod_valve_pressure"),
    ("C_Re", "rod_valve_pressure", TANK),
}
# correction E7: the edges that the other direction opens
OTHER_EDGES = {"swing": ("valve_pressure_b", "valve_pressure_a")}
OTHER_EDGES |= dict.fromkeys(("boom", "stick"), ("rod_valve_pressure", "head_valve_pressure"))


@pytest.mark.parametrize(
    ("part", "circuit", "figure"),
    [("swing", "swing", FIG_2), ("boom_stick", "boom", FIG_3), ("boom_stick", "stick", FIG_3)],
)
def test_lumped_drives_are_the_graphs_of_the_paper(part, circuit, figure):
    """The branches of Figs. 2 and 3, and no other one but the two edges of the other direction."""
    drive = drawn(FAMILIES[part]["lumped"])[circuit]
    found = {(b.symbol, frozenset((b.start, b.end))) for b in drive.branches.values()}
    inlet, outlet = OTHER_EDGES[circuit]
    edges = {("C_R", SUPPLY, inlet), ("C_Re", outlet, TANK)}
    assert found == {(symbol, frozenset(ends)) for symbol, *ends in figure | edges}
    assert len(drive.branches) == len(figure) + 2
    symbols_of_nodes = {node.symbol for node in drive.nodes.values()}
    assert symbols_of_nodes >= {"P_s", "C_1", "C_2"}


# ---- every variant


def groups(sub: Subsystem) -> tuple[object, object, object]:
    """Symbols of states, inputs and parameters."""
    return symbols(sub.states), symbols(sub.inputs), symbols(sub.parameters)


def drawn(sub: Subsystem) -> dict[str, Circuit]:
    """The circuits of a variant."""
    return dict(sub.circuits(*groups(sub)))


def at_random(sub: Subsystem, expressions, seed):
    """Expressions of x, u, p at 20 points with pressures up to 40 MPa, with the parameters of the file."""
    (x, u, p), rng = groups(sub), np.random.default_rng(seed)
    found = ca.Function("f", [stack(g) for g in (x, u, p)], [column(*expressions(sub.circuits(x, u, p)))])
    own = values(sub)

    def one(name, quantity, start):
        if "pressure" in name:
            return rng.uniform(-5e4, 4e7)
        return start if quantity.unit in ("K", "m", "1") else start + rng.uniform(-1, 1) * quantity.nominal

    def point():
        return [
            [one(n, q, known[n]) for n, q in quantities(group).items()]
            for group, known in ((sub.states, own.x), (sub.inputs, own.u))
        ]

    return np.array([found(*point(), list(own.p.values())).full()[:, 0] for _ in range(20)])


@pytest.mark.parametrize("name", VARIANTS)
def test_every_variant_is_drawn(name):
    """Each branch joins two nodes that are there, and is no loop; every pressure of oil is a state."""
    sub = VARIANTS[name]
    circuits = drawn(sub)
    assert circuits
    for circuit_name, circuit in circuits.items():
        prefix = f"{circuit_name}_" if circuit_name in JOINTS else ""
        for branch in circuit.branches.values():
            assert {branch.start, branch.end} <= circuit.nodes.keys()
            assert branch.start != branch.end
        used = {end for b in circuit.branches.values() for end in (b.start, b.end)}
        assert used >= circuit.nodes.keys() - {GROUND}
        states = {f"{prefix}{n}" for n in circuit.rates}
        assert states <= quantities(sub.states).keys()
        pressures = {n for n in quantities(sub.states) if n.startswith(prefix) and "pressure" in n}
        assert pressures - {"load_sensing_pressure"} <= states  # which is a lag, without flow


SOURCES = (SUPPLY, TANK, GROUND, "reservoir_pressure")


@pytest.mark.parametrize("name", [name for name in VARIANTS if name != "supply ideal"])  # a source itself
def test_what_flows_into_a_node_without_oil_flows_out(name):
    """Ports of valves and motors: the pressures that the variant gives them satisfy Kirchhoff's law."""

    def remainders(circuits):
        for c in circuits.values():
            for n, node in c.nodes.items():
                if node.capacitance is None and n not in SOURCES:
                    yield c.into(n)
        yield 0.0  # not every variant has such a node

    # 1e-3 m3/s, and pressures of 1e7 Pa times conductances of edges up to 1e-7 m3/(s.Pa), rounded
    assert np.abs(at_random(VARIANTS[name], remainders, 1)).max() < 1e-14


@pytest.mark.parametrize("name", VARIANTS)
def test_no_branch_creates_power(name):
    """The heat of each single branch is not negative, in cavitation neither."""

    def heats(circuits):
        return (heat for c in circuits.values() for heat in [*c.heat().values(), 0.0])

    # rounding of products of 1e-3 m3/s and 1e7 Pa
    assert at_random(VARIANTS[name], heats, 2).min() >= -1e-6
