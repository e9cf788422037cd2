"""Every drive at random states: what any axes in any variant must keep, whatever their circuit."""

from dataclasses import is_dataclass, replace
from functools import cache

import casadi as ca
import numpy as np
import pytest
from kit.cranes import machine
from kit.drives import closing_balance, ports, random_point
from kit.equations import Part

from fmus import boom_stick, swing
from fmus.contract import Subsystem, family, quantities, symbols
from fmus.drives import cylinder, motor
from fmus.drives.compensated import COMPENSATED
from fmus.drives.cylinder import CYLINDER
from fmus.drives.detailed import detailed
from fmus.drives.drive import Axis, Fidelity, part
from fmus.drives.lumped import LUMPED
from fmus.drives.motor import MOTOR
from fmus.drives.quasistatic import QUASISTATIC
from fmus.machine.parts import FAMILIES
from fmus.parameters import numbers

PARTS = ("swing", "boom_stick")
PORTS = ("boom_head_pressure", "boom_rod_pressure")
VALVES = ("boom_head_valve_pressure", "boom_rod_valve_pressure")
# a crane of one's own: a valve for two axes, another one for the third; cylinders without some load holding
AXES = (
    Axis("lift", CYLINDER, cylinder.Inputs, held=()),
    Axis("slew", MOTOR, motor.Inputs),
    Axis("grab", CYLINDER, cylinder.Inputs, own_valve=True, held=("head",)),
)
FROM = {"lift_": "boom_", "grab_valve_spool_": "spool_", "grab_valve_": "valve_", "grab_": "stick_"}
FROM |= {"slew_brake_holding_": "brake_", "slew_": ""}


def crane(variant: str, fidelity: Fidelity) -> Subsystem:
    """The crane with the numbers of the harvester's drives."""
    sub = part("crane", AXES, fidelity, text="Crane", validity="-")
    known = {n: q for name in PARTS for n, q in numbers(FAMILIES[name][variant])["parameters"].items()}
    found = {}
    for name in quantities(sub.parameters):
        begin = next((b for b in FROM if name.startswith(b)), "")
        source = FROM.get(begin, "") + name.removeprefix(begin)
        found[name] = known[source if source in known else f"swing_{source}"]
    return replace(sub, numbers={"parameters": found, "start": {}})


FIDELITIES = {"lumped": LUMPED, "quasistatic": QUASISTATIC, "compensated": COMPENSATED}
FIDELITIES["detailed"] = detailed(lambda axis: 1 + len(axis.name) % 2)
CRANES = family("crane", **{variant: crane(variant, fidelity) for variant, fidelity in FIDELITIES.items()})
LOADER = machine().families["drives"]
DRIVES = {f"{part} {name}": sub for part in PARTS for name, sub in FAMILIES[part].items()} | {
    "swing, three lumps": swing.variants(lumps=3)["detailed"],
    "boom_stick, different lumps": boom_stick.variants(lumps={"boom": 1, "stick": 4})["detailed"],
    **{f"{variant} crane": sub for variant, sub in CRANES.items()},
    **{f"{variant} loader": LOADER[variant] for variant in ("detailed", "compensated")},
}
drives = pytest.mark.parametrize("name", DRIVES)


@cache
def drive(name: str) -> Part:
    """The equations of a drive."""
    return Part(DRIVES[name])


@drives
def test_energy_balance_closes_to_rounding(name):
    """Power in + convected = d(stored)/dt + heat at random states, and no heat is negative."""
    balance, rng = closing_balance(drive(name)), np.random.default_rng(4)
    for x, given in (random_point(drive(name), rng) for _ in range(100)):
        balance(x, **given)


@drives
def test_heat_by_cause_and_powers_by_axis_are_those_of_the_drive(name):
    """They sum to the heat and to what the lines give, from -20 to 80 C; no heat is negative."""
    part, rng = drive(name), np.random.default_rng(7)
    for x, u in (random_point(part, rng) for _ in range(50)):
        y = part(x, **u)[1]
        heat = y["dissipated_power"]
        heats = [v for n, v in y.items() if n.endswith("_heat")]
        # of a difference of two terms of a branch, rounding
        assert min(heats) >= -1e-12 * heat
        assert sum(heats) == pytest.approx(heat, rel=1e-9)  # the bar
        given = u["supply_pressure"] * y["supply_flow"], u["tank_pressure"] * y["return_flow"]
        taken = sum(v for n, v in y.items() if n.endswith("_hydraulic_power"))
        assert taken == pytest.approx(given[0] - given[1], abs=1e-12 * (abs(given[0]) + abs(given[1])))
        for effort, motion in ports(part):
            power = y[effort.rpartition("_")[0] + "_mechanical_power"]
            assert power == pytest.approx(y[effort] * u[motion], rel=1e-12)


@pytest.mark.parametrize("name", ["swing", "boom_stick"])
def test_a_section_heats_by_its_two_drops(name):
    """Q d in the metering edge, the rest of Q (P_s - P) in compensator and check valve."""
    part = drive(f"{name} compensated")
    swing, hoses = ("pressure_a", "pressure_b"), ("head_valve_pressure", "rod_valve_pressure")
    sides = {"swing": swing} if name == "swing" else {"boom": hoses, "stick": hoses}
    for axis, (side, other) in sides.items():
        x = part.start(**{f"{axis}_{side}": 8e6, f"{axis}_{other}": 2e6})
        y = part(x, **{f"{axis}_command": 6.0, "supply_pressure": 18e6, "load_sensing_pressure": 8e6})[1]
        flow, drop, left = (y[f"{axis}_{n}"] for n in ("meter_in_flow", "metering_drop", "compensator_drop"))
        assert flow > 1e-4
        # the closed edge of the other port leaks 1e-4 of the flow
        assert y[f"{axis}_meter_in_heat"] == pytest.approx(flow * drop, rel=1e-3)
        assert y[f"{axis}_compensator_heat"] == pytest.approx(flow * left, rel=1e-3)
        assert drop + left == pytest.approx(10e6, rel=1e-3)


@pytest.mark.parametrize(("variant", "sides"), [("quasistatic", PORTS), ("compensated", VALVES)])
def test_a_hose_in_series_heats_as_the_hose_alone(variant, sides):
    """At the flows of both hoses, those of the lumped drives have the same heat."""
    part, alone = drive(f"boom_stick {variant}"), drive("boom_stick lumped")
    x = part.start(boom_head_pressure=6e6, boom_rod_pressure=4e6)
    for name, pressure in zip(sides, (9e6, 1e6), strict=True):
        x[part.at(name)] = pressure
    x[[k for k, n in enumerate(part.states) if n.endswith("_opening")]] = 1.0
    given = {"boom_command": 7.0, "supply_pressure": 18e6, "load_sensing_pressure": 8e6}
    y = part(x, **given)[1]
    flows = {n: y[n] for n in ("boom_head_flow", "boom_rod_flow")}
    assert min(map(abs, flows.values())) > 1e-4
    expected = alone(alone.start(**flows), **given)[1]["boom_hose_heat"]
    # leakage flows through the hose, too, and not through the edge or valve: 1e-4 of the flow
    assert y["boom_hose_heat"] == pytest.approx(expected, rel=1e-3)


@drives
def test_rates_are_exact_and_forces_depend_on_states_alone(name):
    """A rate output is the derivative along the solution; no input moves a force or torque at once.

    The load pressure refers to the return line, which has no rate, so only its rate is compared. The torque
    of a lumped motor follows its speed: docs/design.md, "The cut between the FMUs".
    """
    part, rng = drive(name), np.random.default_rng(5)
    u, y = part.expressions["u"], part.expressions["y"]
    names = [n for n in y if f"{n}_rate" in y]
    assert f"{part.sub.part}_load_pressure" in names
    for moved in names:
        if not moved.endswith("load_pressure"):
            followed = {n for n in u if ca.depends_on(y[moved], u[n])}
            resistive = part.sub.variant == "lumped" and moved.endswith("_torque")
            through_line = {moved.replace("torque", "speed"), "tank_pressure", "oil_temperature"}
            assert followed <= (through_line if resistive else set())
        both = part.of(y[f"{moved}_rate"], part.along(y[moved]))
        for x, given in (random_point(part, rng) for _ in range(20)):
            shown, exact = (v.item() for v in both(x, **given))
            # exact identity, rounding of flows over capacitances; of a load pressure also that of the foot
            # of its step
            stiff = part.sub.variant != "detailed" or moved.endswith("load_pressure")
            room = {"rel": 1e-10, "abs": 1e-3} if stiff else {"rel": 1e-12}
            assert shown == pytest.approx(exact, **room), moved


@pytest.mark.parametrize("variant", CRANES)
def test_the_variables_of_own_axes_have_the_name_of_their_axis(variant):
    """Common ones have none, those of an own valve that of its axis; no name stands for two variables."""
    sub = CRANES[variant]

    def variables(group):
        return sum(variables(v) if is_dataclass(v) else 1 for v in vars(group).values())

    groups = (sub.parameters, sub.inputs, sub.states, sub.outputs)
    assert [variables(symbols(group)) for group in groups] == [len(quantities(group)) for group in groups]
    p, u, x, y = map(quantities, groups)
    known = {"density", "valve_leakage", "grab_valve_leakage", "lift_hose_length", "slew_line_length"}
    assert known <= set(p)
    assert not [n for n in p if n.startswith(("lift_valve", "slew_valve", "slew_hose", "grab_line"))]
    assert {"supply_pressure", "lift_command", "grab_velocity", "slew_speed"} <= set(u)
    assert {"lift_head_pressure", "grab_rod_pressure", "slew_pressure_a"} <= set(x)
    assert {"crane_load_pressure", "supply_flow", "slew_torque", "grab_force_rate"} <= set(y)
