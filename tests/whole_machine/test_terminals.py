"""The ports of the subsystems: they carry exactly the wires of the machine."""

import zipfile
from dataclasses import replace
from itertools import product

import pytest
from kit.mistakes import problem
from lxml import etree

from fmus.export.interface import interface_of
from fmus.export.model_description import terminals
from fmus.machine.machine import wiring
from fmus.machine.parts import FAMILIES, FERIC
from fmus.parameters import values
from fmus.ports import lever
from fmus.supply import SUPPLY
from orchestrator import assemble, load


@pytest.mark.parametrize("part", FAMILIES)
def test_variants_of_a_part_swap_without_wires(part):
    """All of them have the same terminals."""
    assert len({sub.terminals for sub in FAMILIES[part].values()}) == 1


# what the parts exchange, by terminal: power ports with their rates, levers, lines
PISTON = ("position", "velocity", "acceleration", "holding_force")
MOTION = {
    "swing": ("swing", ("torque", "torque_rate"), ("speed", "acceleration")),
    **dict.fromkeys(("boom", "stick"), ("boom_stick", ("force", "force_rate"), PISTON)),
}
LINES = ("supply_pressure", "tank_pressure", "load_sensing_pressure")


def expected_wires():
    """The wires of the machine, written out."""
    for axis, (drive, effort, motion) in MOTION.items():
        yield from ((f"{drive}.{axis}_{v}", f"manipulator.{axis}_{v}") for v in effort)
        yield from ((f"manipulator.{axis}_{v}", f"{drive}.{axis}_{v}") for v in motion)
        for v in ("command", "command_rate"):
            yield f"operator_input.{axis}_{v}", f"{drive}.{axis}_{v}"
    yield "operator_input.payload_mass", "manipulator.payload_mass"
    for drive in ("swing", "boom_stick"):
        for rate in ("", "_rate"):
            yield from ((f"supply.{line}{rate}", f"{drive}.{line}{rate}") for line in LINES)
            yield f"{drive}.{drive}_load_pressure{rate}", f"supply.{drive}_load_pressure{rate}"
        yield from ((f"{drive}.{v}", f"supply.{v}_{drive}") for v in ("supply_flow", "return_flow"))
        yield "supply.oil_temperature", f"{drive}.oil_temperature"


def test_terminals_carry_all_wires_of_the_machine():
    """Connecting terminals by the rule "plug" gives the connections of the machine, no more and no fewer."""
    wires = FERIC.connections + FERIC.operator_wires + FERIC.supply_wires
    assert sorted(wires) == sorted(expected_wires())
    assert len(wires) == 45


def test_the_controller_measures_what_it_has_inputs_for():
    """Its levers feed the drives; angles, speeds, pressures of the cylinders and of the lines come back."""
    commands = [(s, t) for s, t in FERIC.operator_wires if "command" in s]
    levers = {(s.replace("operator_input", "controller"), t) for s, t in commands}
    sources = {source for source, target in FERIC.controller_wires if target.startswith("controller.")}
    assert set(FERIC.controller_wires) - levers == {(s, f"controller.{s.partition('.')[2]}") for s in sources}
    assert sources == {
        *(f"manipulator.{axis}_{kind}" for axis in MOTION for kind in ("angle", "speed")),
        *(f"boom_stick.{axis}_{side}_pressure" for axis in ("boom", "stick") for side in ("head", "rod")),
        *(f"{line}_pressure" for line in ("supply.supply", "supply.tank")),
        *(f"swing.swing_pressure_{line}" for line in "ab"),
    }
    assert len(FERIC.controller_wires) == 20


def test_a_machine_without_supply_and_operator_has_their_signals_as_inputs():
    """Both drives share the lines, which come last."""
    connections, inputs = wiring(FERIC.subsystems)
    assert connections == FERIC.connections
    levers = [f"{axis}_{v}" for axis in MOTION for v in ("command", "command_rate")]
    lines = [*(f"{line}{rate}" for line in LINES for rate in ("", "_rate")), "oil_temperature"]
    assert list(inputs) == [*levers, "payload_mass", *lines]
    assert all(inputs[line] == (f"swing.{line}", f"boom_stick.{line}") for line in lines)
    driven = {n: inputs[n] for n in (*levers, "payload_mass")}
    assert wiring(FERIC.subsystems | {"supply": SUPPLY})[1] == driven


def test_assemble_connects_terminals(fmu_dir):
    """Thirteen terminals of the FMUs give the 45 connections of harvester.ssp."""
    rods = [f"boom_stick.{axis}_rod -> manipulator.{axis}_rod" for axis in ("boom", "stick")]
    levers = [f"operator_input.{axis}_lever -> {drive}.{axis}_lever" for axis, (drive, *_) in MOTION.items()]
    pairs = product(("swing", "boom_stick"), ("supply", "return", "load_sensing"))
    lines = [f"supply.{line}_line_{drive} -> {drive}.{line}_line" for drive, line in pairs]
    wires = [*rods, *levers, "operator_input.grip -> manipulator.grip"]
    wires.append("swing.swing_shaft -> manipulator.swing_shaft")
    files = {name: fmu_dir / f"{name}.fmu" for name in FERIC.components}
    found = {str(c) for c in assemble(files, [*wires, *lines]).connections}
    assert found == {str(c) for c in load(fmu_dir / "harvester.ssp").connections}
    assert len(found) == 45


@pytest.mark.parametrize("version", ["fmu_dir", "fmi3_dir"])
def test_file_names_variables_of_the_fmu(request, version):
    """Every terminal member in the file is a variable of the model description beside it; the icon exists.

    FMI 2.0.4 adopted the folder from FMI 3.0.
    """
    for name in FERIC.components:
        with zipfile.ZipFile(request.getfixturevalue(version) / f"{name}.fmu") as archive:
            assert archive.read("terminalsAndIcons/icon.png")
            ports = etree.fromstring(archive.read("terminalsAndIcons/terminalsAndIcons.xml"))
            model = etree.fromstring(archive.read("modelDescription.xml"))
        variables = {v.get("name") for v in model.find("ModelVariables")}
        used = [m.get("variableName") for m in ports.iter("TerminalMemberVariable")]
        assert used
        assert set(used) <= variables


def test_member_that_is_no_port_is_refused():
    """A terminal with a parameter or an unknown name is told in one line."""
    sub = replace(FERIC.components["swing"], terminals=(lever("grapple"),))
    told = "grapple_lever: grapple_command is not an input or output"
    problem(lambda: terminals(sub, interface_of(sub, values(sub))), told)
