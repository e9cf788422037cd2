"""Power bonds: found from units, and the energy error of the coupling."""

import numpy as np
import pytest
from kit.mistakes import problem, table

from orchestrator import Coupling, System, assemble, run
from orchestrator.base.units import DeclaredUnit
from orchestrator.engine.result import BondEnergy, Card
from orchestrator.fmi.description import FmuVariable
from orchestrator.fmi.interface import FmuInterface
from orchestrator.ssp.power_bonds import bond_of, find_bonds
from orchestrator.ssp.system import Component, Connection, Port

UNITS = {
    "N": DeclaredUnit("N", (1, 1, -2, 0, 0, 0, 0, 0)),
    "m": DeclaredUnit("m", (0, 1, 0, 0, 0, 0, 0, 0)),
    "m/s": DeclaredUnit("m/s", (0, 1, -1, 0, 0, 0, 0, 0)),
    "N/s": DeclaredUnit("N/s", (1, 1, -3, 0, 0, 0, 0, 0)),
    "bar": DeclaredUnit("bar", (1, -1, -2, 0, 0, 0, 0, 0), 1e5),
    "L/min": DeclaredUnit("L/min", (0, 3, -1, 0, 0, 0, 0, 0), 1e-3 / 60),
}


def wired(*signals):
    """A system of components x and y; 'boom_force N x->y' is an output of x and an input of y."""
    variables = {"x": {}, "y": {}}
    connections = []
    for text in signals:
        name, unit, way = text.split()
        source, target = way.split("->")
        variables[source][f"out_{name}"] = FmuVariable(f"out_{name}", causality="output", unit=UNITS[unit])
        variables[target][name] = FmuVariable(name, causality="input", unit=UNITS[unit])
        connections.append(Connection(Port(source, f"out_{name}"), Port(target, name)))
    return System("s", {c: Component(c, FmuInterface(v)) for c, v in variables.items()}, tuple(connections))


@pytest.mark.parametrize("master", ["jacobi", "gauss-seidel"])
def test_residual_is_the_energy_that_the_coupling_made(bounce, master):
    """Both parts conserve energy, so the total change of energy is the residual of the bond."""
    result = run(bounce(False), master=master, step=1e-3, stop=1.0)
    made = 0.5 * result["mass.v"] ** 2 + 0.5 * 100.0 * result["spring.stretch"] ** 2  # energy of both [J]
    (bond,) = result.card.bonds
    assert bond.name == "mass - spring"
    # the trapezoidal rule over a step of 0.01 rad is wrong by (0.01)^2/12 of the power; the residual of
    # gauss-seidel nearly cancels over an oscillation, so it is measured against what was turned over
    assert bond.residual == pytest.approx(made[-1] - made[0], abs=1e-4 * bond.turnover + 1e-9 * made[0])


def test_energies_are_the_sums_over_the_recorded_steps(bounce):
    """Held inputs equal their sources at the start of the step, so the residual follows from the record."""
    result = run(bounce(False), master="jacobi", step=1e-2, stop=1.0)
    (bond,), effort, flow = result.card.bonds, result["mass.force"], result["spring.v"]
    errors = 0.5e-2 * (effort[1:] * flow[:-1] - effort[:-1] * flow[1:])
    power = np.abs(effort * flow)
    expected = [errors.sum(), np.abs(errors).sum(), 0.5e-2 * (power[1:] + power[:-1]).sum()]
    # the lengths of steps, differences of rounded times, and the order of a hundred summands: rounding
    assert [bond.residual, bond.turnover, bond.exchanged] == pytest.approx(expected, rel=1e-11)


def test_each_bond_has_an_energy_of_its_own(bounce):
    """Three pairs have the energies that each has alone, to the bit."""

    def bonds(*pairs):
        files = {f"{n}{k}": part.source.path for n, part in bounce(False).components.items() for k in pairs}
        wires = [w for k in pairs for w in (f"spring{k}.force -> mass{k}.force", f"mass{k}.v -> spring{k}.v")]
        start = {f"mass{k}.spring": 0.0 for k in pairs} | {f"spring{k}.stiffness": 100.0 + k for k in pairs}
        card = run(assemble(files, wires, start), master="jacobi", step=1e-2, stop=1.0).card
        return [(b.residual, b.turnover, b.exchanged) for b in card.bonds]

    alone = [*bonds(0), *bonds(1), *bonds(2)]
    assert bonds(0, 1, 2) == alone
    assert len({*alone}) == 3


def test_inputs_that_move_are_judged_as_what_they_were_at_both_ends(bounce):
    """Extrapolated at their slopes: v' = -F is given, that of F follows from its last four values."""
    h, result = 1e-2, run(bounce(True), master=Coupling("jacobi", 1), step=1e-2, stop=1.0)
    force, speed = result["mass.force"], result["spring.v"]
    slope = np.zeros_like(force)  # backward differences; nothing is known at the start
    slope[1] = (force[1] - force[0]) / h
    slope[2] = (3 * force[2] - 4 * force[1] + force[0]) / (2 * h)
    slope[3:] = (11 * force[3:] - 18 * force[2:-1] + 9 * force[1:-2] - 2 * force[:-3]) / (6 * h)
    force_used, speed_used = force[:-1] + h * slope[:-1], speed[:-1] - h * force[:-1]
    errors = 0.5 * h * (force[1:] * speed_used - force_used * speed[1:])
    # rounding of forces up to 1000 N and speeds up to 100 m/s, of which errors are differences
    assert result.card.bonds[0].residual == pytest.approx(errors.sum(), abs=1e-8)
    assert result.card.bonds[0].turnover == pytest.approx(np.abs(errors).sum(), abs=1e-8)


def test_exchanged_energy_is_the_integral_of_power(bounce):
    """A mass on a spring moves its energy to and fro: |P| integrates to twice the energy per half period."""
    period = 2 * np.pi / 10
    result = run(bounce(False), step=period / 20000, stop=period)
    # 20000 first-order steps per period: the amplitude drifts by h omega^2 T / 2 = 1e-3
    assert result.card.bonds[0].exchanged == pytest.approx(4 * 5000.0, rel=2e-3)


@table(__file__, "bonds", "signals, bonds")
def test_bonds_are_found_by_units_and_names(signals, bonds):
    """An effort one way and a flow the other; names decide between bonds of equal units."""
    found = {f"{b.effort.variable} {b.flow.variable}" for b in find_bonds(wired(*signals))}
    assert found == set(bonds)


def test_bond_in_other_units_counts_in_watts():
    """Pressure in bar times flow in L/min is scaled to watts."""
    (bond,) = find_bonds(wired("pressure bar x->y", "flow L/min y->x"))
    assert bond.scale == pytest.approx(1e5 * 1e-3 / 60, rel=1e-15)  # one product, rounding only


def card_of(*bonds):
    """The card of a run with these bonds."""
    return Card(master="jacobi", step=1e-3, bonds=bonds)


def test_a_bond_at_rest_has_no_share():
    """An exchange of rounding errors is left out; a small exchange has no relative residual."""
    idle = BondEnergy("idle", -1e-33, 1e-33, 2e-29)
    bonds = (idle, BondEnergy("busy", 1e-3, 1e-3, 2e4), BondEnergy("calm", 1e-3, 1e-3, 0.4))
    card, figures = card_of(*bonds), [("0.001", "2e+04", "5.0e-08"), ("0.001", "0.4", "-")]
    assert [card.bond(b) for b in bonds] == [("", "", "no exchange"), *figures]
    rows = [line.split() for line in card.text().splitlines()[-2:]]
    assert rows == [["busy", *figures[0]], ["calm", *figures[1]]]
    assert card_of(idle).text().endswith("\n\nno power bond exchanges energy")


def test_the_likely_cause_of_a_failure_needs_a_large_energy_error():
    """Master, step and worst bond above 10 %; a bond that hardly exchanges anything is no evidence."""
    fine, idle = BondEnergy("fine", 90.0, 90.0, 1e3), BondEnergy("idle", 1.0, 1.0, 2.0)
    assert card_of().likely_cause() == card_of(fine, idle).likely_cause() == ""
    bad, worse = BondEnergy("bad", -300.0, 400.0, 1e3), BondEnergy("worse", 420.0, 500.0, 1e3)
    assert card_of(fine, bad, worse).likely_cause() == (
        "likely cause: the coupling, jacobi with a step of 0.001 s"
        " (energy error +42% of the energy exchanged by worse); use a shorter step or the master hermite"
    )


def test_requested_bonds_must_be_opposite_connections(bounce):
    """A requested bond is checked and used."""
    system = bounce(False)
    assert bond_of(system, "mass.force", "spring.v").name == "mass - spring"
    problem(lambda: bond_of(system, "mass.x", "spring.v"), r"mass.x is not a connected input")
    result = run(system, step=1e-2, stop=0.1, bonds=[("mass.force", "spring.v")])
    assert len(result.card.bonds) == 1
