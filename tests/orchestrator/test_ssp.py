"""Reading SSP 1.0: flattening, directions, transformations, units, parameters, and refused files."""

from functools import partial

import numpy as np
import pytest
from kit import shards
from kit.mistakes import problem, table
from kit.ssp import UNITS, bound, connector, gain, inline, real, second, ssd, system, wire

from orchestrator import Problem, Trace, load, run
from orchestrator.base.files import Location, require_system

# each edition of SSP with one version of FMI: what reads the one does not read the other
EDITIONS = [
    *(pytest.param(("fmus", str), id="ssp1-fmi2"), pytest.param(("fmus3", second), id="ssp2-fmi3")),
    pytest.param(("fmus3", str), id="ssp1-fmi3", marks=shards.search),
    pytest.param(("fmus", second), id="ssp2-fmi2", marks=shards.search),
]


@pytest.fixture(params=EDITIONS)
def make(request, zip_ssp):
    """An .ssp around gain.fmu, from the text of its System."""
    fmus, edition = request.getfixturevalue(request.param[0]), request.param[1]

    def write(text, files=None, tail=UNITS):
        parts = {name: edition(f) if isinstance(f, str) else f for name, f in (files or {}).items()}
        return zip_ssp(edition(ssd(text, tail)), {"resources/gain.fmu": fmus["gain"], **parts})

    return write


def test_a_chain_from_system_input_to_system_output(make):
    """Inlets and outlets of the system, the default experiment, and start values inside a component."""
    parts = [gain("a", inline(real("factor", 3))), gain("b")]
    wires = [wire("command", "a.u"), wire("a.y", "b.u"), wire("b.y", "result")]
    path = make(system(parts, wires, connector("command", "input") + connector("result", "output")))
    ramp = Trace(np.array([0.0, 1.0]), {"command": np.array([0.0, 2.0])})
    trace = run(path, ramp, step=0.25).trace
    np.testing.assert_array_equal(trace.time, [0.5, 0.75, 1.0])  # start of the SSP, end of the scenario
    np.testing.assert_array_equal(trace["result"], [3.0, 4.5, 6.0])
    assert trace.units["result"] == "m"
    time = run(path, step=0.25).trace.time  # without a scenario
    assert (time[0], time[-1]) == (0.5, 1.5)


def test_nested_systems_are_flattened(make):
    """Names become paths; transformations and unit conversions along the path are combined."""
    b = gain("b")
    for port, kind in (("u", "input"), ("y", "output")):
        b = b.replace(f'<ssd:Connector name="{port}" kind="{kind}"/>', connector(port, kind, "mm"))
    ten = wire("demand", "b.u", '<ssc:LinearTransformation factor="10" offset="1"/>')
    ports = connector("demand", "input", "m") + connector("answer", "output")
    inner = system([b], [ten, wire("b.y", "answer")], ports, name="inner")
    wires = [
        wire("command", "inner.demand", '<ssc:LinearTransformation factor="2" offset="0.5"/>'),
        wire("inner.answer", "a.u", '<ssc:LinearTransformation factor="1" offset="1"/>'),
    ]
    loaded = load(make(system([inner, gain("a")], wires, connector("command", "input", "mm"))))
    assert list(loaded.components) == ["inner.b", "a"]
    assert str(loaded.connections[0]) == "inner.b.y -> a.u"
    level = Trace(np.array([0.0, 1.0]), {"command": np.array([500.0, 500.0])})
    # 500 mm = 0.5 m at `demand`, times 2 plus 0.5; 1500 mm at b, times 10 plus 1; then plus 1 m
    np.testing.assert_allclose(run(loaded, level, step=0.5).trace["a.y"], 16.001, rtol=1e-15)  # roundings


def test_direction_of_a_connection_and_suppressed_conversion(make):
    """From input to output, too; suppressUnitConversion with and without a transformation in place."""
    loaded = load(make(system([gain("a"), gain("b")], [wire("b.u", "a.y")])))
    assert [str(c) for c in loaded.connections] == ["a.y -> b.u"]
    inlet = connector("command", "input", "mm")
    half = '<ssc:LinearTransformation factor="0.5"/>'
    wires = [wire("command", "a.u", extra='suppressUnitConversion="true"')]
    wires += [wire("command", "b.u", half, 'suppressUnitConversion="true"'), wire("command", "c.u")]
    path = make(system([gain("a"), gain("b"), gain("c")], wires, inlet))
    trace = run(path, Trace(np.array([0.0, 1.0]), {"command": np.full(2, 8.0)}), step=0.5).trace
    assert [trace[f"{c}.u"][0] for c in "abc"] == [8.0, 4.0, 0.008]


def test_outer_bindings_win_over_inner_ones(make):
    """Component, inner system, outer system; prefix and hierarchical names."""
    b = gain("b", inline(real("factor", 2), real("offset", 1)))
    inner = system([b], [], bindings=inline(real("b.factor", 3)), name="inner")
    outer = inline(real("factor", 4), prefix="inner.b.")
    loaded = load(make(system([inner], [], bindings=outer)))
    assert loaded.components["inner.b"].start == {"factor": 4.0, "offset": 1.0}


def test_external_sets_and_mappings_with_units(make):
    """SSV and SSM files: a new name, a unit, a transformation; one inside the component's FMU."""
    ssv = """<ParameterSet version="1.0" name="p"><Parameters>
<Parameter name="shift"><Real value="250" unit="mm"/></Parameter>
<Parameter name="nothing"><Real value="1"/></Parameter></Parameters>
<Units><Unit name="mm"><BaseUnit m="1" factor="0.001"/></Unit></Units></ParameterSet>"""
    ssm = """<ParameterMapping version="1.0">
<MappingEntry source="shift" target="a.offset"><LinearTransformation factor="2"/></MappingEntry>
<MappingEntry source="shift" target="a.factor" suppressUnitConversion="true"/></ParameterMapping>"""
    binding = bound('source="resources/p%20q.ssv"', '<ssd:ParameterMapping source="resources/p.ssm"/>')
    path = make(system([gain("a")], [], bindings=binding), {"resources/p q.ssv": ssv, "resources/p.ssm": ssm})
    loaded = load(path)
    assert loaded.components["a"].start == {"offset": 0.5, "factor": 250.0}
    assert loaded.notes == (f"{path}/resources/p q.ssv: left out, not in the mapping: nothing",)


def test_a_start_value_reaches_inputs_through_a_system_connector(make):
    """The start value of an unconnected system input is converted on its way."""
    bindings = inline(real("command", 250, "mm"))
    path = make(system([gain("a")], [wire("command", "a.u")], connector("command", "input", "m"), bindings))
    assert load(path).components["a"].start == {"u": 0.25}
    assert run(path, step=0.5).trace["a.y"][0] == 0.25
    assert run(path, step=0.5, set={"command": 3}).trace["a.y"][0] == 3.0


def test_a_unit_that_no_file_defines_is_read_by_its_symbol(fmus, zip_ssp):
    """A parameter with unit="bar" and no definition is 180 bar, not 180 Pa; a mass is no pressure."""
    fmu = fmus.make("gain", "pressed", units={"u": "Pa"})

    def pressed(unit):
        part = gain("a", inline(real("u", 180, unit)), "p.fmu")
        return load(zip_ssp(ssd(system([part], []), ""), {"p.fmu": fmu}))

    for unit, value in (("bar", 180e5), ("psi", 180 * 6894.757293168361), ("kPa", 180e3)):
        # rounding of one product
        assert pressed(unit).components["a"].start["u"] == pytest.approx(value, rel=1e-15), unit
    for unit in ("kg", "L/min", "-"):
        told = rf"parameter a\.u: the units cannot be converted, {unit}.* and Pa = "
        problem(partial(pressed, unit), told)


@table(__file__, "units", "base, message")
def test_a_fault_in_a_unit_is_told_where_it_is_used(make, base, message):
    """As source or as target of a value; a file that only defines it is read."""
    units = f'<ssd:Units><ssc:Unit name="odd">{base}</ssc:Unit></ssd:Units>'
    assert load(make(system([gain("a")], []), tail=units)).notes == ()
    wired = [wire("command", "a.u")], connector("command", "input", "odd")
    for whole in (system([gain("a", inline(real("u", 1, "odd")))], []), system([gain("a")], *wired)):
        place, _, text = problem(lambda whole=whole: load(make(whole, tail=units))).partition(": line ")
        assert place.endswith("SystemStructure.ssd")
        assert text.partition(": ")[2] == message


def test_parameter_files_inside_the_fmu(fmus, zip_ssp):
    """sourceBase="component" looks inside the FMU; a binding of a system has none to look into."""
    ssv = """<ParameterSet version="1.0" name="p"><Parameters>
<Parameter name="factor"><Real value="7"/></Parameter></Parameters></ParameterSet>"""
    fmu = fmus.make("gain", "carrier", extra={"resources/p.ssv": ssv})
    binding = bound('source="resources/p.ssv" sourceBase="component"')
    path = zip_ssp(ssd(system([gain("a", binding, "c.fmu")], [])), {"c.fmu": fmu})
    assert load(path).components["a"].start == {"factor": 7.0}
    path = zip_ssp(ssd(system([gain("a", source="c.fmu")], [], bindings=binding)), {"c.fmu": fmu})
    problem(lambda: load(path), "expected SSD for sourceBase, got 'component'")


def test_an_ssp_inside_an_ssp(make, zip_ssp, fmus):
    """A component that is a system structure package of its own."""
    inner = make(system([gain("a")], [wire("u", "a.u")], connector("u", "input")))
    inner = inner.rename(inner.with_name("inner.ssp"))
    part = """<ssd:Component name="sub" type="application/x-ssp-package" source="inner.ssp"/>"""
    parts = [part, gain("b", source="gain.fmu")]
    path = zip_ssp(ssd(system(parts, [wire("b.y", "sub.u")])), {"inner.ssp": inner, "gain.fmu": fmus["gain"]})
    loaded = load(path)
    assert [str(c) for c in loaded.connections] == ["b.y -> sub.a.u"]
    assert run(loaded, step=0.5, set={"b.offset": 4.0}).trace["sub.a.y"][0] == 4.0


def test_signals_pass_through_a_dictionary(make):
    """Two references to one dictionary carry a signal from one to the other."""
    left = """<ssd:SignalDictionaryReference name="left" dictionary="bus"><ssd:Connectors>
<ssd:Connector name="speed" kind="inout"/></ssd:Connectors></ssd:SignalDictionaryReference>"""
    parts = [gain("a"), gain("b"), left, left.replace("left", "right")]
    text = system(parts, [wire("a.y", "left.speed"), wire("right.speed", "b.u")])
    dictionary = '<ssd:SignalDictionaries><ssd:SignalDictionary name="bus"/></ssd:SignalDictionaries>'
    loaded = load(make(text.replace("</ssd:System>", f"{dictionary}</ssd:System>")))
    assert [str(c) for c in loaded.connections] == ["a.y -> b.u"]


def element(text):
    """An element of the table of mistakes."""
    if isinstance(text, list):
        name, *parameter = text
        return gain(name, inline(real(*parameter)))
    return text if text.startswith("<") else gain(text)


@table(__file__, "mistakes", "parts, wires, message")
def test_mistakes_in_a_system_are_told(make, parts, wires, message):
    """File, element and connector."""
    inlets = connector("command", "input") + connector("force", "input", "N")
    path = make(system([element(p) for p in parts], [wire(*w) for w in wires], inlets))
    assert str(path) in problem(lambda: load(path), message)


def test_values_of_xml_have_several_spellings(make):
    """Truth is written in four ways."""
    truths = {"true": 8.0, "1": 8.0, " true ": 8.0, "false": 0.008, "0": 0.008}
    wires = [wire("length", f"p{i}.u", extra=f'suppressUnitConversion="{t}"') for i, t in enumerate(truths)]
    parts = [gain(f"p{i}") for i in range(len(truths))]
    inputs = load(make(system(parts, wires, connector("length", "input", "mm")))).inputs
    assert [linear(8.0) for _, linear in inputs["length"].targets] == list(truths.values())


@table(__file__, "bindings", "attributes, inside, message")
def test_a_binding_without_values_is_told(make, attributes, inside, message):
    """It would be ignored, and the system would run with other values."""
    values = '<ParameterSet version="1.0" name="p"><Parameters/></ParameterSet>'
    path = make(system([gain("a", bound(attributes, inside))], []), {"p.ssv": values})
    problem(lambda: load(path), rf"SystemStructure\.ssd: line \d+: .*{message}$")


INCLUDED = '<ssd:Component name="again" type="application/x-ssp-{}" source="{}"/>'


@pytest.mark.parametrize("source", ["SystemStructure.ssd", "resources/../SystemStructure.ssd", "other.ssd"])
@pytest.mark.parametrize("folder", ["", "open"])
def test_a_file_that_includes_itself_is_told(make, tmp_path, source, folder):
    """Also with another spelling of the path, and through another file."""
    text = system([gain("a"), INCLUDED.format("definition", source)], [])
    other = ssd(system([INCLUDED.format("definition", "SystemStructure.ssd")], []))
    path = make(text, {"other.ssd": other})
    Location(path).extract(tmp_path / "open")
    with pytest.raises(Problem, match=r"line \d+: Component: again.*SystemStructure\.ssd includes itself$"):
        load(tmp_path / folder if folder else path)


@pytest.mark.parametrize("value", ['"<x/>"', '"text"', 'SYSTEM "file:///etc/hostname"'])
@pytest.mark.parametrize("place", ["<ssd:Elements>", "<ssd:Connections>"])
def test_an_entity_in_the_content_is_told(fmus, zip_ssp, value, place):
    """It is not resolved, so its content would be missing."""
    text = ssd(system([gain("a", source="g.fmu")], [wire("u", "a.u")], connector("u", "input")))
    text = text.partition("?>")[2].replace(place, f"{place}&a;", 1)
    path = zip_ssp(f"<!DOCTYPE s [<!ENTITY a {value}>]>{text}", {"g.fmu": fmus["gain"]})
    told = rf"SystemStructure\.ssd: line \d+: {place[5:-1]}: expected the content itself, got the entity &a;$"
    problem(lambda: load(path), told)


def test_an_entity_in_an_attribute_is_its_text(fmus, zip_ssp):
    """No content is lost."""
    text = ssd(system([gain("a", source="g.fmu")], [])).partition("?>")[2]
    text = '<!DOCTYPE s [<!ENTITY a "1.5">]>' + text.replace('"1.5"', '"&a;"')
    assert load(zip_ssp(text, {"g.fmu": fmus["gain"]})).stop == 1.5


@table(__file__, "xml", "old, new, told")
def test_a_fault_beside_a_prefix_that_is_not_declared_is_told(zip_ssp, old, new, told):
    """An undeclared prefix is accepted, so the message names the other fault."""
    text = ssd(system([gain("a")], [])).replace("<ssd:Connectors>", "<odd:Note/><ssd:Connectors>", 1)
    path = zip_ssp(text.replace(old, new), {})
    problem(lambda: load(path), rf"SystemStructure\.ssd: cannot be read as XML: {told}$")


def test_files_that_are_no_systems_are_told(tmp_path, zip_ssp):
    """Missing, of another type, not a zip, without or with broken SystemStructure.ssd."""
    for name, text in (("x.ssp", "no zip"), ("x.fmu", "no zip"), ("empty.fmu", ""), ("x.zip", "no zip")):
        (tmp_path / name).write_text(text)
    cases = {
        tmp_path / "no.ssp": "no such file",
        **{tmp_path / name: f"{name}: expected a zip archive" for name in ("x.ssp", "x.fmu", "empty.fmu")},
        tmp_path / "x.zip": r"expected a .ssp, .ssd or .fmu file",
        zip_ssp("<a/>", {}, "root.ssp"): "expected the element SystemStructureDescription, got a",
        zip_ssp("<a", {}, "broken.ssp"): r"cannot be read as XML: .*, line 1, column \d+$",
        zip_ssp("", {}, "empty.ssp"): "cannot be read as XML: Document is empty, line 1, column 1$",
    }
    for path, message in cases.items():
        problem(partial(load, path), message)
    problem(partial(require_system, tmp_path / "x.zip"), r"expected a .ssp, .ssd or .fmu file")  # `page` asks


@table(__file__, "kinds", "options, message")
def test_other_kinds_of_fmus_are_told(fmus, make, options, message):
    """The FMU inside the SSP is named."""
    fmu = fmus.make("gain", "other_kind", **options)
    path = make(system([gain("a", source="resources/other.fmu")], []), {"resources/other.fmu": fmu})
    problem(lambda: load(path), r"system.ssp/resources/other.fmu: " + message)


def test_an_input_of_the_system_goes_before_a_bare_name(fmus, zip_ssp):
    """With a connector `u` of the system, `u` is only what that connector feeds."""
    text = ssd(system([gain("p"), gain("q")], [wire("u", "p.u")], connector("u", "input")))
    trace = run(zip_ssp(text, {"resources/gain.fmu": fmus["gain"]}), set={"u": 3.0}, step=0.5).trace
    np.testing.assert_array_equal(trace["p.y"], 3.0)
    np.testing.assert_array_equal(trace["q.y"], 0.0)
