"""Systems of other tools: what the standards say of units, outputs, inputs passed on, variants and values."""

from functools import partial

import numpy as np
import pytest
from kit.any_fmu import description
from kit.any_fmu.description import V
from kit.mistakes import problem
from kit.ssp import UNITS, connector, gain, inline, real, second, ssd, system, wire

from orchestrator import Trace, assemble, load, run
from orchestrator.ssp.write import write_ssp

CELSIUS = """<ssd:Units><ssc:Unit name="K"><ssc:BaseUnit K="1"/></ssc:Unit>
<ssc:Unit name="degC"><ssc:BaseUnit K="1" offset="273.15"/></ssc:Unit></ssd:Units>"""
DIFFERENCE = 'relativeQuantity="true"'


def differs(workshop, name, unit, relative=DIFFERENCE):
    """A gain of temperatures in a unit, or of differences."""
    changes = {n: {"unit": unit, "more": relative} for n in ("u", "y", "offset")}
    return workshop.make("gain", name, changes=changes)


@pytest.fixture
def pair(each):
    """A gain of differences in degC, another in K."""
    return {"a": differs(each, "in_degc", "degC"), "b": differs(each, "in_kelvin", "K")}


def test_offsets_do_not_apply_to_differences(pair):
    """10 degC of difference are 10 K (FMI 2.0, 2.2.2; FMI 3.0, 2.4.4.2), also of values with a unit."""
    chain = assemble(pair, ["a.y -> b.u"])
    trace = run(chain, set={"a.u": 10.0}, step=0.5, stop=0.5).trace
    assert (trace["b.u"][0], trace["b.y"][0]) == (10.0, 10.0)
    given = {"a.u": "10 K", "b.offset": "5 degC"}
    start = chain.with_start(given).components
    assert (start["a"].start["u"], start["b"].start["offset"]) == (10.0, 5.0)


def test_differences_through_connectors_of_a_file(pair, zip_ssp):
    """Which cannot say that they are differences: their FMUs do, at inputs, outputs and in parameter sets."""
    b = gain("b", inline(real("offset", 5, "degC")), "b.fmu")
    ports = connector("u", "input", "degC") + connector("y", "output", "degC")
    inner = system([b], [wire("u", "b.u"), wire("b.y", "y")], ports, name="inner")
    wires = [wire("u", "a.u"), wire("a.y", "inner.u"), wire("inner.y", "y")]
    ports = connector("u", "input", "K") + connector("y", "output", "K")
    top = system([inner, gain("a", source="a.fmu")], wires, ports, inline(real("u", 3, "degC")))
    path = zip_ssp(ssd(top, CELSIUS), {f"{name}.fmu": fmu for name, fmu in pair.items()})
    assert run(path, step=0.5, stop=0.5).trace["y"].tolist() == [8.0, 8.0]  # sums of whole numbers
    assert run(path, step=0.5, stop=0.5, set={"u": "4 degC"}).trace["y"].tolist() == [9.0, 9.0]


def test_a_difference_does_not_become_a_temperature(each, zip_ssp):
    """FMI requires both or none; without an offset there is nothing to decide."""
    fmus = {"a": differs(each, "a_difference", "degC"), "b": differs(each, "no_difference", "K", "")}
    parts = [gain(name, source=f"{name}.fmu") for name in fmus]
    files = {f"{name}.fmu": fmu for name, fmu in fmus.items()}
    path = zip_ssp(ssd(system(parts, [wire("a.y", "b.u")]), ""), files)
    told = r"a\.y \[degC\] -> b\.u \[K\]: expected two differences or none \(relativeQuantity\), got one$"
    problem(lambda: load(path), told)
    problem(lambda: assemble(fmus, ["a.y -> b.u"]), told)
    kelvin = {"a": differs(each, "kelvin_difference", "K"), "b": fmus["b"]}
    assert run(assemble(kelvin, ["a.y -> b.u"]), set={"a.u": 2.0}, step=0.5, stop=0.5).trace["b.y"][0] == 2.0


@pytest.mark.parametrize("units", [("odd", "m"), ("m", "odd"), ("odd", "Pa")])
def test_without_a_base_unit_values_are_passed_unchanged(each, units, monkeypatch):
    """Whatever the name looks like: here that of an hour; with a note."""
    for name in ("h", "%", "C", "g"):
        monkeypatch.setitem(description.BASE, name, {})
        both = [name if u == "odd" else u for u in units]
        made = [each.make("gain", f"u{k}", units=dict.fromkeys("uy", u)) for k, u in enumerate(both)]
        pair = assemble(dict(zip("ab", made, strict=True)), ["a.y -> b.u"])
        result = run(pair, set={"a.u": 21.0}, step=0.5, stop=0.5)
        assert result.trace["b.y"][0] == 21.0
        assert "[{}] and [{}] are not both defined".format(*both) in " ".join(result.card.notes)


def test_a_connector_does_not_hide_the_definition_of_the_fmu(fmus, zip_ssp):
    """A file that names a unit without defining it means that of the variable."""
    made = {n: fmus.make("gain", f"in_{u}", units={"u": u, "y": u}) for n, u in (("a", "bar"), ("b", "Pa"))}
    parts = [
        gain(n, source=f"{n}.fmu").replace(f'<ssd:Connector name="{p}" kind="{k}"/>', connector(p, k, u))
        for n, u, p, k in (("a", "bar", "y", "output"), ("b", "Pa", "u", "input"))
    ]
    path = zip_ssp(ssd(system(parts, [wire("a.y", "b.u")]), ""), {f"{n}.fmu": f for n, f in made.items()})
    assert run(path, set={"a.u": 3.0}, step=0.5, stop=0.5).trace["b.u"][0] == 3e5


@pytest.fixture
def around(fmus, zip_ssp):
    """An .ssp around g.fmu, a gain, from the arguments of `system` and what follows it."""

    def write(*inside, tail=UNITS):
        return zip_ssp(ssd(system(*inside), tail), {"g.fmu": fmus["gain"]})

    return write


# ---- outputs


def test_outputs_that_feed_nothing_are_recorded(fmus):
    """Two sources with one name of their outputs; a source beside a gain that has this name, too."""
    files = {"a": fmus["source"], "b": fmus["source"]}
    assert {"a.y", "b.y"} <= set(run(assemble(files), step=0.5, stop=0.5).trace.signals)
    three = assemble(files | {"g": fmus["gain"]}, ["a.y -> g.u"], {"b.offset": 2.0})
    np.testing.assert_array_equal(run(three, step=0.5, stop=0.5).trace["b.y"], 2 + np.sin([0.0, 0.5]))
    replaced = run(three, {"time": [0.0, 1.0], "g.u": [0.0, 1.0]}, step=0.5).trace
    assert {"a.y", "b.y", "g.y"} <= set(replaced.signals)  # `y` is no input


def test_an_output_of_the_system_may_be_a_local_variable(fmus, zip_ssp):
    """It is recorded with it."""
    hidden = {"y": {"causality": "local", "depends": ()}}
    fmu = fmus.make("gain", "inside", changes=hidden, also=[V("z", "output")])
    local = gain("a", source="g.fmu").replace("output", "local")
    path = zip_ssp(ssd(system([local], [wire("a.y", "y")], connector("y", "output"))), {"g.fmu": fmu})
    assert run(path, set={"a.u": 3.0}, step=0.5, stop=1.0).trace["y"].tolist() == [3.0, 3.0]


@pytest.mark.parametrize("beside", [True, False])
def test_an_input_of_the_system_is_passed_to_an_output(around, beside):
    """From a scenario, a start value, a set value and a set; with and without a component that it feeds."""
    doubled = wire("x", "z", '<ssc:LinearTransformation factor="2" offset="1"/>')
    ports = connector("x", "input", "m") + connector("z", "output", "mm")
    parts = [gain("a", source="g.fmu")], [doubled] + [wire("x", "a.u")] * beside, ports
    ramp = Trace(np.array([0.5, 1.5]), {"x": np.array([0.0, 1.0])})
    z = run(around(*parts), ramp, step=0.25).trace["z"]
    np.testing.assert_allclose(z, [1, 501, 1001, 1501, 2001], rtol=1e-15)  # m become mm, then 2 x + 1
    bound_to_4 = around(*parts, inline(real("x", 4)))
    assert run(bound_to_4, step=0.5).trace["z"].tolist() == [8001.0] * 3
    assert run(bound_to_4, step=0.5, set={"x": "5 mm"}).trace["z"].tolist() == [11.0] * 3
    again = write_ssp(load(bound_to_4), bound_to_4.with_name("again.ssp"))
    assert run(again, step=0.5).trace["z"].tolist() == [8001.0] * 3
    started = run(around(*parts), step=0.5).trace
    assert started["z"].tolist() == [1.0] * 3 if beside else "z" not in started


def test_steps_are_passed_on_as_steps(around):
    """A whole number and a truth hold the last sample, through the connectors of a system inside."""
    kinds = {"n": "input", "m": "output", "b": "input", "c": "output"}
    ports = "".join(connector(n, k, type_="Integer" if n in "nm" else "Boolean") for n, k in kinds.items())
    inner = system([], [wire("n", "m"), wire("b", "c")], ports, name="inner")
    wires = [wire("n", "inner.n"), wire("b", "inner.b"), wire("inner.m", "m"), wire("inner.c", "c")]
    path = around([inner, gain("a", source="g.fmu")], wires, ports, tail="")
    samples = {"time": [0.0, 1.0, 2.0], "n": [1.0, 3.0, 2.0], "b": [0.0, 1.0, 0.0]}
    trace = run(path, samples, step=0.5).trace
    assert (trace["m"].tolist(), trace["c"].tolist()) == ([1, 1, 3, 3, 2], [0, 0, 1, 1, 0])
    single = run(path, samples, step=0.5, isolate=False, master="jacobi").trace
    assert single["m"].tolist() == [1, 1, 3, 3, 2]


def test_inputs_without_effect_are_told(around):
    """A column and a value for an input of the system that feeds nothing; an output that nothing feeds."""
    inner = system([], [wire("p", "q")], connector("p", "input") + connector("q", "output"), name="inner")
    ports = connector("x", "input") + connector("z", "output")
    path = around([inner, gain("a", source="g.fmu")], [wire("inner.q", "z")], ports)
    result = run(path, {"time": [0.0, 1.0], "x": [0.0, 1.0]}, step=0.5)
    assert result.card.notes[-2:] == ("z is not recorded: nothing feeds inner.p",
                                      "x has no effect: this input of the system feeds nothing")  # fmt: skip


# ---- values


def test_a_column_cannot_drive_a_parameter_of_a_component(around):
    """By the name of a connector of the system neither; a value at the start can (FMI 2.0, 2.2.7)."""
    ports = connector("k", "parameter") + connector("u", "input")
    path = around([gain("g", source="g.fmu")], [wire("k", "g.factor"), wire("u", "g.u")], ports)
    steps = {"time": [0.0, 0.5], "k": [1.0, 3.0]}
    told = r"column 'k': expected an input or a tunable parameter, got a Real parameter g\.factor$"
    problem(lambda: run(path, steps, step=0.25), told)
    assert run(path, step=0.5, set={"k": 3.0, "u": 2.0}).trace["g.y"][0] == 6.0


def test_values_of_ssp_2(fmus3, zip_ssp):
    """Text by an element; what no FMU here has may be of any type (SSP 2.0, 6.2)."""
    part = '<ssd:Component name="t" source="t.fmu">{}</ssd:Component>'

    def start(*rows):
        path = zip_ssp(second(ssd(system([part.format(inline(*rows))], []))), {"t.fmu": fmus3["types"]})
        loaded = load(path)
        return loaded.components["t"].start, [note.rpartition(": ")[2] for note in loaded.notes]

    label = '<ssv:String><ssv:Value value="a b"/></ssv:String>'
    colour = '<ssv:Enumeration><ssv:Value value="green"/></ssv:Enumeration>'
    picture, wide = '<ssv:Binary value="ff00"/>', '<ssv:Float64 value="1 2 3"/><ssc:Dimension size="3"/>'
    given = start(("label", label), ("enum_in", colour), ("picture", picture), ("table", wide))
    missing = [f"parameter {n!r} of t does not match a variable" for n in ("picture", "table")]
    assert given == ({"label": "a b", "enum_in": 2}, missing)
    many = "<ssv:String>" + '<ssv:Value value="x"/>' * 2 + "</ssv:String>"
    wrong = (("gain", wide, "3 values"), ("label", many, "2 values"))
    for name, value, got in wrong:
        told = f"'{name}': expected a scalar number or text, got {got}, not supported$"
        problem(partial(start, (name, value)), told)
    problem(partial(start, ("gain", picture)), r"t\.gain: expected a value of type Real, got 'ff00'$")
    problem(partial(start, ("label", "<ssv:String/>")), "'label': expected a value, got none$")
    problem(partial(start, ("gain", label), ("gain", label)), "'gain': expected a unique name, got it twice$")


# ---- files


def test_a_variant_in_a_package(fmus, zip_ssp):
    """By the fragment of the source, which may be quoted; without one it is SystemStructure.ssd."""
    first, other = (ssd(system([gain("g", inline(real("offset", k)), "g.fmu")], []), "") for k in (2, 5))
    inner = zip_ssp(first, {"Var B.ssd": other, "g.fmu": fmus["gain"]}, "i.ssp")
    sources = {"plain": "i.ssp", "other": "i.ssp#Var%20B.ssd", "named": "i.ssp#SystemStructure.ssd"}
    form = '<ssd:Component name="{}" type="application/x-ssp-package" source="{}"/>'
    parts = [form.format(*pair) for pair in sources.items()]
    trace = run(zip_ssp(ssd(system(parts, []), ""), {"i.ssp": inner}), step=0.5, stop=0.5).trace
    assert [trace[f"{n}.g.y"][0] for n in sources] == [2.0, 5.0, 2.0]
    gone = parts[1].replace("Var%20B", "Var")
    problem(lambda: load(zip_ssp(ssd(system([gone], [])), {"i.ssp": inner})), r"Var\.ssd is missing")


def test_what_is_odd_but_allowed_gets_a_note(around, fmus):
    """An element of no SSP outside of annotations; a wire to a parameter, which may be meant for an input."""
    inside = "<ssd:Annotations><ssc:Annotation type='x'><a/></ssc:Annotation></ssd:Annotations>"
    odd = gain("a", source="g.fmu").replace("<ssd:Connectors>", "<ssd:Banana/><ssd:Connectors>")
    (note,) = load(around([odd], [], "", inside)).notes
    assert note.endswith("SystemStructure.ssd: line 8: Banana: left out, no element of SSP")
    parts = {"a": fmus["gain"], "b": fmus["gain"]}
    assert assemble(parts, ["a.y -> b.u"]).notes == ()
    (note,) = assemble(parts, ["a.y -> b.factor"]).notes
    assert note == "a.y -> b.factor: expected an input, got a fixed parameter, which is set like one"
