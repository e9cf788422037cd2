"""Mappings of values in SSP: of Booleans, whole numbers and enumerations, on every way that a value can take.

`types` has int_out = int_in + 1, bool_out = not bool_in, enum_out = enum_in; its enumeration is red = 1,
green = 2.
"""

from functools import partial

import numpy as np
import pytest
from kit.mistakes import problem, table
from kit.ssp import inline, second, ssd, system, wire

from orchestrator import Trace, load, run
from orchestrator.ssp.write import write_ssp

LAMPS = """<ssd:Enumerations><ssc:Enumeration name="Lamp">
<ssc:Item name="stop" value="7"/><ssc:Item name="go" value="-3"/></ssc:Enumeration></ssd:Enumerations>"""


def mapping(kind, *entries):
    """A transformation by a table."""
    rows = "".join(f'<ssc:MapEntry source="{a}" target="{b}"/>' for a, b in entries)
    return f"<ssc:{kind}MappingTransformation>{rows}</ssc:{kind}MappingTransformation>"


def port(name, kind, type_="Integer", more=""):
    return f'<ssd:Connector name="{name}" kind="{kind}"><ssc:{type_} {more}/></ssd:Connector>'


def part(name, bindings=""):
    """A component without connectors in the file."""
    ends = "".join(
        port(f"{kind}_{end}", way, type_, 'name="Colour"' * (kind == "enum"))
        for kind, type_ in (("int", "Integer"), ("bool", "Boolean"), ("enum", "Enumeration"))
        for end, way in (("in", "input"), ("out", "output"))
    )
    return f"""<ssd:Component name="{name}" source="types.fmu"><ssd:Connectors>{ends}</ssd:Connectors>
{bindings}</ssd:Component>"""


def values(mapping_entries, **parameters):
    """A binding with a parameter mapping; parameters: name -> (element, value)."""
    rows = [(n, f'<ssv:{kind} value="{v}"/>') for n, (kind, v) in parameters.items()]
    text = f'<ssm:ParameterMapping version="1.0">{mapping_entries}</ssm:ParameterMapping>'
    end = "</ssd:ParameterBinding>"
    return inline(*rows).replace(end, f"<ssd:ParameterMapping>{text}</ssd:ParameterMapping>{end}")


def entries(*pairs):
    """Entries of a parameter mapping: source, target, and what is inside, if there is something."""
    rows = ((source, target, "".join(inside)) for source, target, *inside in pairs)
    return "".join(f'<ssm:MappingEntry source="{a}" target="{b}">{m}</ssm:MappingEntry>' for a, b, m in rows)


@pytest.fixture(params=["fmus", "fmus3"])
def make(request, zip_ssp):
    """An .ssp around types.fmu, of SSP 1.0 with FMI 2.0 and of SSP 2.0 with FMI 3.0."""
    fmus = request.getfixturevalue(request.param)
    edition = str if request.param == "fmus" else lambda text: second(text).replace(":Integer ", ":Int32 ")

    def write(elements, wires, connectors="", bindings=""):
        text = edition(ssd(system(elements, wires, connectors, bindings), LAMPS))
        return zip_ssp(text, {"types.fmu": fmus["types"]})

    return write


def stairs(**columns):
    """A scenario of samples, half a second from one to the next."""
    signals = {name.replace("__", "."): np.array(v, float) for name, v in columns.items()}
    return Trace(0.5 * np.arange(len(next(iter(signals.values())))), signals)


def driven(path, signal, **columns):
    """A signal at the samples of a scenario."""
    return run(path, stairs(**columns), step=0.5).trace[signal].tolist()


def test_what_is_not_mapped_is_kept(make):
    """The counter passes 1 2 3 4 5; one entry, a line that is no rule for the others, and a permutation."""
    for entries, right in (
        ([(2, 9)], [1, 9, 3, 4, 5]),
        ([(1, 10), (2, 20), (3, 30)], [10, 20, 30, 4, 5]),
        ([(1, 5), (5, 2), (2, 1)], [5, 1, 3, 4, 2]),
    ):
        path = make([part("p"), part("q")], [wire("p.int_out", "q.int_in", mapping("Integer", *entries))])
        assert driven(path, "q.int_in", p__int_in=[0, 1, 2, 3, 4]) == right
        again = write_ssp(load(path), path.with_name("again.ssp"))
        assert driven(again, "q.int_in", p__int_in=[0, 1, 2, 3, 4]) == right


@pytest.mark.parametrize("master", ["jacobi", "hermite"])
def test_other_masters_map_the_same(make, master):
    """One step later, as their inputs are held."""
    path = make([part("p"), part("q")], [wire("q.int_in", "p.int_out", mapping("Integer", (2, 9), (4, -1)))])
    trace = run(path, stairs(p__int_in=[0, 1, 2, 3, 4]), step=0.5, master=master).trace
    assert trace["q.int_in"].tolist() == [1, 9, 3, -1, 5]


def test_inputs_of_the_system_are_mapped(make):
    """A scenario, a single value, a start value in the file; whole numbers, Booleans, items, and a line."""
    wires = [
        wire("count", "p.int_in", mapping("Integer", (1, 100), (3, 300))),
        wire("count", "q.int_in", '<ssc:LinearTransformation factor="-2" offset="5"/>'),
        wire("on", "p.bool_in", mapping("Boolean", ("true", "false"), ("false", "true"))),
        wire("on", "q.bool_in", mapping("Boolean", ("false", "true"))),
        wire("p.enum_in", "lamp", mapping("Enumeration", ("go", "green"), ("stop", "red"))),
    ]
    inlets = port("count", "input") + port("on", "input", "Boolean")
    inlets += port("lamp", "input", "Enumeration", 'name="Lamp"')
    path = make([part("p"), part("q")], wires, inlets)
    scenario = stairs(count=[0, 1, 2, 3], on=[0, 1, 1, 0], lamp=[7, -3, -3, 7])
    trace = run(path, scenario, step=0.5).trace
    assert trace["p.int_in"].tolist() == [0, 100, 2, 300]
    assert trace["q.int_in"].tolist() == [5, 3, 1, -1]
    assert trace["p.bool_in"].tolist() == [1, 0, 0, 1]
    assert trace["q.bool_in"].tolist() == [1, 1, 1, 1]
    assert trace["p.enum_in"].tolist() == [1, 2, 2, 1]
    chosen = load(path).with_start({"count": 3, "on": "true", "lamp": "go"}).components
    assert (chosen["p"].start["int_in"], chosen["q"].start["int_in"]) == (300, -1)
    assert (chosen["p"].start["bool_in"], chosen["q"].start["bool_in"]) == (False, True)
    assert chosen["p"].start["enum_in"] == 2
    given = {"count": ("Integer", 1), "lamp": ("Enumeration", "go")}
    bindings = values(entries(("count", "count"), ("lamp", "lamp")), **given)
    start = load(make([part("p"), part("q")], wires, inlets, bindings)).components["p"].start
    assert (start["int_in"], start["enum_in"]) == (100, 2)


def test_outputs_of_the_system_are_mapped(make):
    """The output of the component keeps its value, that of the system has the mapped one."""
    wires = [
        wire("p.int_out", "n", mapping("Integer", (2, -2))),
        wire("p.bool_out", "b", mapping("Boolean", (1, 0))),
        wire("lamp", "p.enum_out", mapping("Enumeration", ("green", "go"))),
    ]
    outlets = port("n", "output") + port("b", "output", "Boolean")
    outlets += port("lamp", "output", "Enumeration", 'name="Lamp"')
    path = make([part("p")], wires, outlets)
    scenario = stairs(p__int_in=[0, 1, 2], p__bool_in=[0, 1, 0], p__enum_in=[1, 2, 1])
    trace = run(path, scenario, step=0.5).trace
    assert (trace["p.int_out"].tolist(), trace["n"].tolist()) == ([1, 2, 3], [1, -2, 3])
    assert (trace["p.bool_out"].tolist(), trace["b"].tolist()) == ([1, 0, 1], [0, 0, 0])
    assert trace["lamp"].tolist() == [1, -3, 1]


def test_mappings_one_after_the_other(make):
    """Through the connectors of a system inside: a line, a table, a table; as each alone, in turn."""
    first, then = mapping("Integer", (3, 8), (9, 7)), mapping("Integer", (5, 50), (8, 1), (7, 70))
    inner = system([part("q")], [wire("u", "q.int_in", then)], port("u", "input"), name="inner")
    line = wire("p.int_out", "middle.u", '<ssc:LinearTransformation factor="2" offset="1"/>')
    middle = system([inner], [wire("u", "inner.u", first)], port("u", "input"), name="middle")
    path = make([part("p"), middle], [line])
    found = driven(path, "middle.inner.q.int_in", p__int_in=[0, 1, 2, 3, 4, 5])
    # 3 5 7 9 11 13 behind the line, 8 5 7 7 11 13 behind the first table
    assert found == [1, 50, 70, 70, 11, 13]


def test_parameters_are_mapped_by_their_type(make):
    """With values of any spelling; what the mapping does not name, or misspells, is not set, with a note."""
    inside = entries(
        ("n", "int_in", mapping("Integer", ("4", "-4"))),
        ("on", "bool_in", mapping("Boolean", ("true", "false"))),
        ("colour", "enum_in", mapping("Enumeration", ("blau", "green"))),
        ("text", "label"),
    )
    given = {"n": ("Integer", "04"), "on": ("Boolean", "1"), "colour": ("Enumeration", "blau")}
    given |= {"text": ("String", "you"), "gain": ("Real", 9), "int_in": ("Integer", 3)}
    path = make([part("p", values(inside, **given))], [])
    loaded = load(path)
    assert loaded.components["p"].start == {"int_in": -4, "bool_in": False, "enum_in": 2, "label": "you"}
    assert [n.partition(": ")[2] for n in loaded.notes] == ["left out, not in the mapping: gain, int_in"]
    misspelt = values(entries(("m", "int_in")), n=("Integer", 1))
    assert "the parameter set has no 'm'" in load(make([part("p", misspelt)], [])).notes[0]


@table(__file__, "impossible", "pairs, told")
def test_parameter_mappings_that_cannot_be_are_told(make, pairs, told):
    """In one line."""
    given = values(entries(*pairs), n=("Integer", 1), m=("Integer", 2))
    problem(partial(load, make([part("p", given)], [])), f"{told}$")


def test_items_that_no_enumeration_has_are_told(make):
    """With those that there are."""
    wires = [wire("lamp", "p.enum_in", mapping("Enumeration", ("go", "blue")))]
    inlet = port("lamp", "input", "Enumeration", 'name="Lamp"')
    told = "expected one of the items red, green, got 'blue'$"
    problem(lambda: load(make([part("p")], wires, inlet)), told)


def test_values_that_no_trace_holds_are_told(make):
    """A source that no value has is ignored (SSP 2.0), a target is refused."""
    far = wire("p.int_out", "q.int_in", mapping("Integer", (2**54, 1), (1, 2)))
    assert driven(make([part("p"), part("q")], [far]), "q.int_in", p__int_in=[0, 1]) == [2, 2]
    far = wire("p.int_out", "q.int_in", mapping("Integer", (1, 2**54)))
    told = "whole numbers of at most 9007199254740992$"
    problem(lambda: run(make([part("p"), part("q")], [far]), step=0.5, stop=0.5), told)
