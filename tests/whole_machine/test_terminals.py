"""The ports of the subsystems: two terminals that fit carry exactly the wires of the machine."""

import zipfile
from dataclasses import replace
from itertools import combinations

import pytest
from lxml import etree

from fmus.contract import quantities
from fmus.export.interface import interface_of
from fmus.export.model_description import terminals
from fmus.machine.parts import ALL, COMMAND_WIRES, CONNECTIONS
from fmus.parameters import values
from fmus.ports import lever
from orchestrator.base.errors import Problem


def pairs():
    """(component, other component, terminal name): terminals of one name and kind on both."""
    for a, b in combinations(ALL, 2):
        for terminal in ALL[a].terminals:
            others = {t.name: t for t in ALL[b].terminals}
            supply = terminal.kind == "line"  # both drives hang on one line: not joined to each other
            if terminal.name in others and not supply:
                yield a, b, terminal.name


def members(component, name):
    """Member name -> Member of a terminal."""
    terminal = next(t for t in ALL[component].terminals if t.name == name)
    return {m.name: m for m in terminal.members}


def causality(component, variable):
    return "input" if variable in quantities(ALL[component].inputs) else "output"


@pytest.mark.parametrize(("a", "b", "name"), list(pairs()))
def test_terminals_of_one_name_fit(a, b, name):
    """Members are alike by name, an output on one side is an input on the other, flows are opposite."""
    here, there = members(a, name), members(b, name)
    assert set(here) == set(there)
    for word, member in here.items():
        assert {causality(a, member.variable), causality(b, there[word].variable)} == {"input", "output"}
        assert {member.flow, there[word].flow} in ({""}, {"in", "out"})


def test_terminals_carry_all_wires_of_the_machine():
    """Connecting terminals by the rule "plug" gives the connections of machine.py, no more and no fewer."""
    wires = set()
    for a, b, name in pairs():
        here, there = members(a, name), members(b, name)
        for word, member in here.items():
            ends = (f"{a}.{member.variable}", f"{b}.{there[word].variable}")
            wires.add(ends if causality(a, member.variable) == "output" else ends[::-1])
    assert wires == set(CONNECTIONS) | set(COMMAND_WIRES)


@pytest.mark.parametrize("version", ["fmu_dir", "fmi3_dir"])
def test_file_names_variables_of_the_fmu(request, version):
    """Every terminal member in the file is a variable of the model description beside it; the icon exists.

    FMI 2.0.4 adopted the folder from FMI 3.0.
    """
    for name in ALL:
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
    sub = replace(ALL["swing"], terminals=(lever("grapple"),))
    with pytest.raises(Problem, match="grapple_lever: grapple_command is not an input or output"):
        terminals(sub, interface_of(sub, values(sub)))
