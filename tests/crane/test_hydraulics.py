"""Hydraulics of cranes: what the file says, what follows from the size of the crane, what is assumed."""

from pathlib import Path

import numpy as np
import pytest
from kit.cranes import CRANES, changed, machine, told_of
from kit.equations import Part
from kit.mistakes import problem
from scipy.optimize import brentq

from fmus.contract import quantities
from fmus.crane.axes import at_start
from fmus.crane.check import check
from fmus.crane.description import NEW, read
from fmus.crane.machine import crane_machine, drives, with_pressures
from fmus.parameters import numbers, values
from fmus.supply import supply

TURN = 2 * np.pi  # rad
VALVE = 'valve = "40 mm2", hose = "3 m"'
ADDED = """[boom]
cushion = { length = "40 mm", resistance = 2e12 }
reliefs = { pressure = "280 bar", gain = 1e-9 }
regeneration = { area = "20 mm2" }
"""


@pytest.mark.parametrize("variant", ["lumped", "quasistatic", "detailed", "compensated"])
def test_the_slewing_motor_holds_its_torque_from_the_start(variant):
    """Its lines begin with the pressures of the torque; the motor's leakage takes less than 1e-4 in them."""
    of, held = Part(machine().families["drives"][variant]), {"slew_holding_torque": -8e3}
    _, shown = of(of.start(held), **held)
    assert shown["slew_torque"] == pytest.approx(-8e3, rel=1e-4)


def test_a_valve_by_its_rated_flow_passes_it(tmp_path):
    """90 L/min at 35 bar over an edge: the area of the orifice equation; what is assumed is told."""
    sizes = [(f", {n} = {x}", "") for n, x in (("hose_bore", '"19.05 mm"'), ("damping", '"20 kN.s/m"'))]
    valve = 'valve = "40 mm2", hose = "3 m"', 'flow = "90 l/min", drop = "35 bar"'
    crane = read(changed(tmp_path, valve, *sizes))
    area = crane.joint("boom")["valve_area"]
    assert 0.62 * area * np.sqrt(2 * 35e5 / 870) == pytest.approx(90 / 6e4, rel=1e-12)
    told = told_of(crane)
    assert "assumed: [boom] cylinder.damping 2e+04 N.s/m" in told
    bore = np.sqrt(4 * 90 / 6e4 / (np.pi * 5))  # 5 m/s
    assert f"hydraulics.hose 3 m, hydraulics.hose_bore {bore:.4g} m" in told


def test_all_that_a_file_does_not_say_is_listed(tmp_path):
    """Of the paper's machine pumps, engine, valves, air; of tables the keys that are missing, no others."""
    crane = read(changed(tmp_path, ('viscosity = "0.02 Pa.s"\n', ""), ("[supply]", "[ground]\n[supply]")))
    told = [line for line in told_of(crane).splitlines() if line.startswith("assumed: ")]
    assert "assumed: [oil] viscosity 0.02 Pa.s" in told
    assert "assumed: [ground] stiffness 2e+06 N/m, damping 0.5 s/m, friction 0.6" in told
    supply = ("pump_displacement 1.13e-05 m3/rad", "engine_torque_rise 0.25", "torque_limit 385 N.m")
    drives = ("air_share 0.005,", "valve_spool_frequency 8 Hz", "compensator_setting 1.2e+06 Pa")
    numbers = {"supply": supply, "drives": drives}
    of = {part: "".join(x for x in told if x.startswith(f"assumed: {part}, ")) for part in numbers}
    assert all(f" {number}" in of[part] for part in numbers for number in numbers[part])
    built = crane_machine(crane)
    names = [n for sub in built.families["drives"].values() for n in values(sub).p]
    # each parameter of the drives without a joint's name is of the file, derived from it, zero, or listed
    rest = {n for n in names if n.partition("_")[0] not in ("slew", "boom", "jib", "extension")}
    own = {"density", "viscosity", "bulk_modulus", "counterbalance_band"}
    own |= {f"{valve}_pressure" for valve in ("port_relief", "relief", "counterbalance")}
    own |= {"counterbalance_area", "counterbalance_check_area", "neutral_area"}
    zero = {n for sub in built.families["drives"].values() for n, x in values(sub).p.items() if not x}
    assert {n for n in rest - own - zero if f" {n} " not in of["drives"]} == set()


SIZES = {"a laboratory arm": (0.2, 0.32, 60), "a loader": (20, 40, 215), "a shovel": (600, 900, 320)}


@pytest.mark.parametrize(("slew", "others", "pressure"), SIZES.values(), ids=SIZES)
def test_hydraulics_follow_the_machine(slew, others, pressure):
    """The pump gives the two largest sections their flow; engine, dead volumes, hoses and tank follow.

    Every supply meets its requirements at the start, such as that the engine turns the pump.
    """
    text = NEW.read_text(encoding="utf-8").replace("25 mm2", f"{slew} mm2").replace("40 mm2", f"{others} mm2")
    own = crane_machine(read(Path("sized.toml"), text.replace("210 bar", f"{pressure} bar").encode()))
    pump = values(own.families["supply"]["load_sensing"]).p
    jet = 0.62 * np.sqrt(2 * 12e5 / 870)
    flow = pump["main_pump_displacement"] * pump["engine_rated_speed"]
    assert flow == pytest.approx(1.1 * 2 * others * 1e-6 * jet, rel=1e-6)
    size = flow * pressure / (2.308e-5 * 261.7994 * 206.84)  # power, over that of the paper's machine
    assert pump["engine_rated_torque"] == pytest.approx(max(433 * size, 1.0), rel=1e-6)
    assert pump["heat_capacity"] == pytest.approx(max(6e5 * size, 1e3), rel=1e-6)
    for sub in own.families["supply"].values():
        of = Part(sub)
        assert all(of.of(of.model.require)(of.start())[0] > 0)
    drives = values(own.subsystems["drives"]).p
    area = np.pi / 4 * drives["boom_hose_bore"] ** 2
    assert others * 1e-6 * jet / area <= 5.0 * (1 + 1e-9)  # m/s


def test_pump_engine_and_sections_have_keys(tmp_path):
    """Displacement, margin, cut-off and power of the pump, the engine, flows and edges to both sides."""
    pump = '[pump]\ndisplacement = "60 cm3/rev"\nmargin = "18 bar"\ncut_off = "200 bar"\npower = "40 kW"\n'
    engine = '[engine]\nspeed = "2000 rpm"\npower = "45 kW"\n'
    section = 'rod_flow = "30 L/min", head_return = "20 mm2", rod_pilot_ratio = 3, leakage'
    text = (CRANES / "loader.toml").read_text(encoding="utf-8").partition("[pump]")[0]
    text = text.replace("leakage", section).replace(section, "leakage", 1)  # not of the motor
    own = crane_machine(read(tmp_path / "own.toml", (text + pump + engine).encode()))
    found = values(own.families["supply"]["load_sensing"]).p | values(own.families["drives"]["compensated"]).p
    speed = 2000 * TURN / 60
    expected = {
        **{"main_pump_displacement": 60e-6 / TURN, "margin": 18e5, "pressure_cut_off": 200e5},
        **{"torque_limit": 40e3 / speed, "engine_rated_speed": speed, "engine_rated_torque": 45e3 / speed},
        **{"boom_rod_section_flow": 30 / 6e4, "jib_head_return_area": 20e-6, "boom_rod_pilot_ratio": 3.0},
    }
    assert {n: found[n] for n in expected} == pytest.approx(expected, rel=1e-9)
    assert found["boom_section_flow"] > 30 / 6e4
    by_flow = read(tmp_path / "flow.toml", (text + '[pump]\nflow = "120 L/min"\n' + engine).encode())
    found = values(with_pressures(supply(["drives"])["load_sensing"], by_flow)).p
    assert found["main_pump_displacement"] == pytest.approx(120 / 6e4 / speed, rel=1e-9)


def compensated(crane):
    """Its compensated drives."""
    return Part(drives(crane, "drives", crane.driven, at_start(crane), "compensated"))


# keys -> share of the rod side, by hand: L/min of 0.62 A sqrt(2 dp/rho), or mm2
JET = 0.62e-6 * np.sqrt(2 / 870) * 6e4
SHARES = {
    'valve = "40 mm2"': 1.0,
    'valve = "40 mm2", rod_flow = "20 L/min"': 20 / (40 * JET * np.sqrt(12e5)),
    'valve = "40 mm2", rod_valve = "20 mm2"': 0.5,
    'flow = "40 L/min", drop = "7 bar", rod_valve = "20 mm2"': 20 * JET * np.sqrt(7e5) / 40,
    'flow = "40 L/min", drop = "7 bar", rod_flow = "55 L/min"': 55 / 40,
}


@pytest.mark.parametrize("keys", SHARES)
def test_the_rod_side_has_its_share_in_all_variants(tmp_path, keys):
    """Of the edges of a spool valve, and of the flows of a section; the area has the origin of its key."""
    crane = read(changed(tmp_path, (VALVE, f'{keys}, hose = "3 m"')))
    for variant in ("lumped", "detailed", "compensated"):
        sub = drives(crane, "drives", [crane.joint("boom")], at_start(crane), variant)
        p = values(sub).p
        if variant == "compensated":
            share = p["boom_rod_section_flow"] / p["boom_section_flow"]
        else:
            of = {edge: p[f"boom_valve_{edge}_opening_4"] or 1.0 for edge in ("pa", "pb")}  # 0: no curve
            share = of["pb"] / of["pa"]
            area = numbers(sub)["parameters"]["boom_valve_area"]
            own = "derived" if keys.startswith("flow") or SHARES[keys] > 1 else "literature"
            assert (area.source, "widest" in area.note) == (own, False)
        assert share == pytest.approx(SHARES[keys], rel=1e-9)


def test_the_controller_knows_the_slower_way_of_a_piston(tmp_path):
    """Half the speed without load: here inwards, by a narrow edge from the head side."""
    edges = VALVE.replace("hose", 'head_return = "4 mm2", rod_valve = "90 mm2", hose')
    found = values(crane_machine(read(changed(tmp_path, (VALVE, edges)))).controller).p
    filled, emptied = np.pi / 4 * (0.12**2 - 0.07**2), np.pi / 4 * 0.12**2

    def force(v):
        drops = (((a * v / (0.62 * edge)) ** 2 * 870 / 2) for a, edge in ((filled, 90e-6), (emptied, 4e-6)))
        of_filled, of_emptied = drops
        return filled * (215e5 - of_filled) - emptied * of_emptied

    assert found["boom_speed_limit"] == pytest.approx(brentq(force, 1e-6, 1) / 2, rel=1e-9)


@pytest.mark.parametrize(("held", "sides"), [("none", ()), ("head", ("head",)), ("both", ("head", "rod"))])
def test_a_cylinder_may_be_without_counterbalance_valves(tmp_path, held, sides):
    """A side that has one has its opening as a state; a closed spool blocks the others, but its leakage."""
    of = compensated(read(changed(tmp_path, (VALVE, f'{VALVE}, counterbalance = "{held}"'))))
    names = ("boom_{}_counterbalance_opening", "boom_{}_valve_pressure", "boom_{}_pilot_ratio")
    for side in ("head", "rod"):
        assert [n.format(side) in {*of.states, *of.p} for n in names] == [side in sides] * 3
    _, y = of(of.start(boom_head_pressure=9e6, boom_rod_pressure=4e6))
    for side, other in (("head", 9e6), ("rod", 4e6)):
        supply, to_tank = of.u["supply_pressure"] - other, other - of.u["tank_pressure"]
        # both edges leak, the one behind the check valve less by half of its rounding
        leaks = of.p["boom_valve_leakage"] * (supply - 5e3 - to_tank)
        assert side in sides or y[f"boom_{side}_flow"] == pytest.approx(leaks, rel=1e-9)
    # the relief and check valves are closed, so nothing else flows
    assert y["boom_relief_flow"] == y["boom_anti_cavitation_flow"] == 0


def test_relief_valves_of_its_own_limit_a_drive(tmp_path):
    """Forces, torque, and what holds the arm at the start; the gain follows the flow of the section."""
    motor = ("[slew]\n", '[slew]\nreliefs = { pressure = "120 bar" }\n')
    boom = ("[boom]\n", '[boom]\nreliefs = { pressure = "180 bar", rod_pressure = "90 bar" }\n')
    slew, lift, *_ = check(crane := read(changed(tmp_path, motor, boom)))
    assert (slew.push, slew.pull) == pytest.approx((1.14e-3 * 120e5,) * 2)
    head, rod = np.pi / 4 * 0.12**2, np.pi / 4 * (0.12**2 - 0.07**2)
    assert (lift.push, lift.pull) == pytest.approx((180e5 * head, 90e5 * rod))
    of = compensated(crane)
    _, y = of(of.start(slew_pressure_a=145e5, slew_pressure_b=10e5))
    # g (dp - p) less half of the rounding, times dp
    gain = of.p["slew_reliefs_gain"]
    assert gain == pytest.approx(of.p["port_relief_gain"] / 2, rel=1e-9)  # 20 mm2 of the largest, 40
    assert y["slew_relief_heat"] == pytest.approx(gain * (15e5 - 0.5e5) * 135e5, rel=1e-9)
    weak = read(changed(tmp_path, (boom[0], boom[1].replace("180", "60"))))
    assert "with 73 bar, expected at most its relief valve's 60 bar" in problem(lambda: check(weak))


def test_valves_of_no_cylinder_have_no_settings():
    """A table for counterbalance valves needs one."""
    text = NEW.read_text(encoding="utf-8") + "\n[counterbalance]\npressure = 2e7\n"
    none = text.replace('valve = "40 mm2"', 'valve = "40 mm2", counterbalance = "none"')
    assert read(Path("own.toml"), text.encode()).numbers["counterbalance"]["counterbalance_pressure"].value
    told = problem(lambda: read(Path("own.toml"), none.encode()))
    assert "[counterbalance] expected a cylinder with such a valve, got none" in told


# displacement [m3/rad], ratio, keys of the stop -> volume of a side [m3]
RACK = {
    (6.5e-4, 1, "at = 2"): 6.5e-4 * 2,  # half of it empty, half of it full
    (6.5e-4, 1, "at = 2, from = -1"): 6.5e-4 * 1.5,
    (6.5e-4, 1, ""): 8 * 6.5e-4,  # as of the paper's motor: 0.2 L of 25 cm3/rad
    (2.5e-5, 60, "at = 2"): 2e-4,
}


@pytest.mark.parametrize(("displacement", "ratio", "stop"), RACK)
def test_a_rack_has_the_oil_of_its_middle(tmp_path, displacement, ratio, stop):
    """Half of what it displaces between its stops, if that is less than of a motor of its displacement."""
    motor = f"displacement = {displacement}, ratio = {ratio}"
    stops = ("[slew]\n", f"[slew]\nstop = {{ {stop} }}\n") if stop else ("[slew]\n", "[slew]\n")
    old = 'displacement = "1.14e-3 m3/rad", ratio = 1, volume = "0.2 L"'
    crane = read(changed(tmp_path, stops, (old, motor)))
    assert crane.joint("slew")["motor_volume"] == pytest.approx(RACK[displacement, ratio, stop])


def test_components_in_addition_have_keys(tmp_path):
    """Of a cylinder and of the supply; a cushion in the drives whose lines have oil columns."""
    gas = '[supply]\naccumulator = { volume = "5 L", precharge = "90 bar", conductance = 1e-9 }'
    built = crane_machine(read(changed(tmp_path, ("[boom]\n", ADDED), ("[supply]", gas))))
    drives = {v: values(sub).p for v, sub in built.families["drives"].items()}
    shown = ("cushion_length", "reliefs_pressure", "regeneration_area", "regeneration_command")
    assert [drives["detailed"][f"boom_{n}"] for n in shown] == pytest.approx([0.04, 2.8e7, 2e-5, 1.0])
    told = {v for v, sub in built.families["drives"].items() if "no cushions" in sub.validity}
    assert told == {"quasistatic", "compensated"}
    assert all("boom_reliefs_gain" in p and "jib_reliefs_gain" not in p for p in drives.values())
    sensing = built.families["supply"]["load_sensing"]
    assert values(sensing).p["accumulator_volume"] == 5e-3
    assert "accumulator_pressure" in quantities(sensing.outputs)
