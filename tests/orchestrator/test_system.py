"""Systems assembled in Python: connections, units, start values, and refused ones."""

import re
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from kit.mistakes import problem, table

from orchestrator import Trace, assemble, run
from orchestrator.base.units import DeclaredUnit, LinearTransformation, conversion
from orchestrator.engine.scenario import drive


def gained(fmus, source_unit, target_unit, *linear):
    """What a gain receives from a source of constant 2.0, with these units at both ends."""
    source = fmus.make("source", "source_u", units={"y": source_unit})
    gain = fmus.make("gain", "gain_u", units={"u": target_unit})
    wire = ("s.y", "g.u", *linear)
    system = assemble({"s": source, "g": gain}, [wire], {"s.offset": 2.0, "s.amplitude": 0.0})
    return run(system, step=0.1, stop=0.2)


@table(__file__, "units", "source, target, linear, expected")
def test_units_are_converted_at_connections(fmus, source, target, linear, expected):
    """Factor and offset of BaseUnit are used in both directions, then those of the connection."""
    trace = gained(fmus, source, target, *linear).trace
    # one product, rounding only; of whole numbers there is none
    np.testing.assert_allclose(trace["g.u"], expected, rtol=0 if linear else 1e-15)


def test_different_dimensions_are_refused_and_unknown_ones_noted(fmus):
    """Both ports and units, also in base units; without definition or off by radian it passes."""
    told = r"s\.y \[bar\] -> g\.u \[N\]: the units cannot be converted, "
    problem(lambda: gained(fmus, "bar", "N"), told + r"bar = kg\.m-1\.s-2 and N = kg\.m\.s-2")
    result = gained(fmus, "odd", "N")
    assert "not both defined" in result.card.notes[0]
    assert result.card.text().count("not both defined") == 1
    assert result.trace["g.u"][0] == 2.0
    assert "differ in the radian only" in gained(fmus, "Hz", "rad/s").card.notes[0]


def test_connections_are_cut_by_the_name_of_their_target(fmus):
    """With patterns; the cut input keeps its start value, and a note says so; a wrong name is told."""
    files = {"s": fmus["source"], "p": fmus["gain"], "q": fmus["gain"]}
    whole = assemble(files, ["s.y -> p.u", "p.y -> q.u"], {"s.offset": 1.0})
    assert [str(c) for c in whole.without("q.*").connections] == ["s.y -> p.u"]
    assert whole.without("*.u").connections == ()
    assert whole.without() == whole
    assert whole.without("u").connections == ()
    told = r"cut r\.u: no connected input matches; did you mean p.u, q.u\?"
    problem(lambda: whole.without("*.u", "r.u"), told)
    result = run(whole, cut="q.u", step=0.5, stop=1.0, set={"q.u": 7.0})
    assert [str(c) for c in result.system.connections] == ["s.y -> p.u"]
    np.testing.assert_array_equal(result.trace["q.y"], 7.0)
    assert result.card.notes == ("connections removed by --cut; these inputs keep their start values: q.u",)


def test_conversions_compose():
    """There and back is the identity; maps apply in order."""
    celsius = DeclaredUnit("degC", (0, 0, 0, 0, 1, 0, 0, 0), 1.0, 273.15)
    fahrenheit = DeclaredUnit("degF", (0, 0, 0, 0, 1, 0, 0, 0), 5 / 9, 273.15 - 32 * 5 / 9)
    there, back = (conversion(*pair, "") for pair in ((celsius, fahrenheit), (fahrenheit, celsius)))
    assert there(100.0) == pytest.approx(212.0, rel=1e-13)  # a difference of numbers near 300, rounding only
    assert there.then(back)(37.0) == pytest.approx(37.0, rel=1e-13)  # as above
    assert LinearTransformation(2.0, 1.0).then(LinearTransformation(10.0, 3.0))(1.0) == 33.0


METRE = DeclaredUnit("m", (0, 1, 0, 0, 0, 0, 0, 0))


def test_factors_that_are_none_convert_nothing():
    """As source and as target, also a ratio that no number holds; a value never becomes 0 or NaN."""
    told = "expected a finite factor other than 0"
    small, large = (DeclaredUnit("far", METRE.exponents, f) for f in (1e-200, 1e200))
    for factor in (0.0, float("nan"), float("inf")):
        odd = DeclaredUnit("odd", METRE.exponents, factor)
        for pair in ((METRE, odd), (odd, METRE)):
            message = problem(partial(conversion, *pair, "x"))
            assert re.match(rf"x: \[odd\]: {told} .*, got factor {factor:g}", message), factor
    for pair in ((small, large), (large, small)):
        problem(partial(conversion, *pair, "x"), rf"^x: .* are too far apart: {told}, got (0|inf)")


@table(__file__, "connections", "wires, message")
def test_wrong_connections_are_refused(fmus, wires, message):
    """Unknown ports come with close matches; an input is fed once."""
    files = {"a": fmus["mass_a"], "b": fmus["mass_b"]}
    problem(lambda: assemble(files, wires), message)


@table(__file__, "start", "values, message")
def test_wrong_start_values_are_refused(oscillator, values, message):
    """Name, expected, got."""
    problem(lambda: run(oscillator, set=values), message)


@pytest.fixture
def chatter(each):
    """Two FMUs that pass variables of every type."""
    wires = [f"p.{kind}_out -> q.{kind}_in" for kind in ("real", "int", "bool", "enum")]
    return assemble({"p": each["types"], "q": each["types"]}, wires)


def test_all_types_pass_over_connections(chatter):
    """Integers count up, booleans flip twice, enumerations stay; strings are parameters."""
    values = {"real_in": "1.5", "int_in": 5, "bool_in": "true", "enum_in": "green", "label": "crane"}
    start = {f"p.{name}": value for name, value in values.items()}
    trace = run(chatter, step=0.1, stop=0.2, set=start).trace
    last = {name: trace[f"q.{name}_out"][-1] for name in ("real", "int", "bool", "enum")}
    assert last == {"real": 1.5, "int": 7.0, "bool": 1.0, "enum": 2.0}
    assert trace["p.bool_out"][-1] == 0.0


@table(__file__, "types", "values, message")
def test_values_must_fit_the_type(chatter, values, message):
    """The choice of an enumeration is listed."""
    problem(lambda: run(chatter, set=values), message)


def test_types_match_at_connections(each):
    """No silent rounding; no Boolean for an enumeration, which need not have an item 0."""
    files = {"p": each["types"], "q": each["types"]}
    told = "variables of type {} cannot be connected"
    problem(lambda: assemble(files, ["p.real_out -> q.int_in"]), told.format("Real and Integer"))
    problem(lambda: assemble(files, ["p.bool_out -> q.enum_in"]), told.format("Boolean and Enumeration"))


@table(__file__, "columns", "column, message")
def test_wrong_columns_of_a_scenario_are_refused(oscillator, column, message):
    """The label, the column, and close matches."""
    problem(lambda: run(oscillator, Trace(np.array([0.0, 1.0]), {column: np.zeros(2)})), message)


@table(__file__, "samples", "column, values, message")
def test_samples_that_do_not_fit_the_input_are_refused(chatter, column, values, message):
    """As `--set` refuses them: no rounding."""
    problem(lambda: run(chatter, Trace(np.array([0.0, 0.25, 1.0]), {column: np.array(values)})), message)


def test_a_unit_on_an_input_that_has_none_is_told(chatter):
    """The values are taken as they are in the trace, in SI units."""
    trace = Trace(np.array([0.0, 1.0]), {"p.real_in": np.array([0.0, 1e5])}, {"p.real_in": "Pa"})
    told = "scenario: column p.real_in: no unit of p.real_in is defined; its values are taken in Pa."
    result = run(chatter, trace, stop=1.0, record=["p.real_in"])
    assert (result["p.real_in"][-1], told in result.card.warnings) == (1e5, True)


def test_a_scenario_without_columns_is_refused(chatter):
    """It has times only."""
    told = "scenario: expected a column for each input to drive, got none besides 'time'"
    problem(lambda: run(chatter, {"time": [0.0, 1.0]}), told)


def test_a_boolean_column_holds_its_value_beside_a_fault(chatter):
    """A fault adds rows between those of the scenario: a truth is held there, not a half."""
    trace = Trace(np.array([0.0, 1.0]), {"p.bool_in": np.array([0.0, 1.0])})
    result = run(chatter, trace, step=0.1, fault={"p.real_in": "2@0.75"})
    np.testing.assert_array_equal(result["p.bool_in"], np.append(np.zeros(10), 1.0))
    assert result["p.real_in"][[0, -1]].tolist() == [0.0, 2.0]


def test_a_bare_name_means_every_input_of_that_name(fmus):
    """In start values and scenarios, all in one unit; `component.variable` means that one alone."""
    files = {"p": fmus["gain"], "q": fmus["gain"]}
    system = assemble(files)
    trace = run(system, step=0.5, stop=1.0, set={"u": 7.0, "q.u": 8.0}).trace
    np.testing.assert_array_equal(trace["p.y"], 7.0)
    np.testing.assert_array_equal(trace["q.y"], 8.0)
    ramp = Trace(np.array([0.0, 1.0]), {"u": np.array([0.0, 1.0])})
    trace = run(system, ramp, step=0.5).trace
    for name in ("p.y", "q.y"):
        np.testing.assert_array_equal(trace[name], [0.0, 0.5, 1.0])
    mixed = {n: fmus.make("gain", f"gain_{u}", units={"u": u}) for n, u in (("p", "Pa"), ("q", "bar"))}
    told = r"u: expected inputs with one unit, got p\.u \[Pa\], q\.u \[bar\]"
    problem(lambda: run(assemble(mixed), set={"u": 1.0}), told)


def test_a_column_silences_a_component_without_inputs(fmus):
    """Such a component is a scenario itself: its other targets keep their start values."""
    files = {"s": fmus["source"], "p": fmus["gain"], "q": fmus["gain"]}
    system = assemble(files, ["s.y -> p.u", "s.y -> q.u"], {"s.offset": 1.0})
    ramp = Trace(np.array([0.0, 1.0]), {"p.u": np.array([0.0, 1.0])})
    result = run(system, ramp, step=0.5, set={})
    np.testing.assert_array_equal(result.trace["p.u"], [0.0, 0.5, 1.0])
    np.testing.assert_array_equal(result.trace["q.u"], 0.0)
    told = "the scenario replaces s; inputs that are not in the scenario keep their start values: q.u"
    assert result.card.notes == (told,)


def test_the_slope_of_a_driven_input_is_not_lost(fmus):
    """It follows from the column: the note names it only where the run gives no slopes, and it is lost."""
    source = fmus.make("source", "source_bare", units={"y": None})
    ramp = Trace(np.array([0.0, 1.0]), {"d.u": np.array([0.0, 1.0])})
    system = assemble({"s": source, "d": fmus["drift"]}, ["s.y -> d.u", "s.y -> d.u_rate"])
    assert run(system, ramp, step=0.5).card.notes == ("the scenario replaces s",)
    component = system.components["d"]
    lost = "the scenario replaces s; inputs that are not in the scenario keep their start values: d.u_rate"
    for interpolates, note in ((True, "the scenario replaces s"), (False, lost)):
        face = replace(component.interface, rate_inputs={}, can_interpolate_inputs=interpolates)
        known = {**system.components, "d": replace(component, interface=face)}
        whole = replace(system, components=known)
        assert drive(whole, ramp).released(whole).notes == (note,)
