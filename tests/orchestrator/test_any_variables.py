"""Variables of all types, in connections and scenarios, with every master, called by C and by Python."""

from dataclasses import replace

import numpy as np
import pytest
from kit.any_fmu.models import WIDTHS
from kit.any_fmu.outcome import CIRCLE, HERMITE, MASTERS, TURNS, circle
from kit.mistakes import problem

from orchestrator import Trace, assemble, run
from orchestrator.base.units import LinearTransformation
from orchestrator.engine.job import Job
from orchestrator.engine.options import RunOptions
from orchestrator.ssp.coupling import Coupling
from orchestrator.ssp.system import Connection


@pytest.mark.parametrize("master", MASTERS)
def test_all_kinds_pass_on_wires_and_from_scenarios(each, both, master):
    """Real, Integer, Boolean, Enumeration; a String keeps its start value."""
    kinds = ("real", "int", "bool", "enum")
    system = assemble({"p": each["types"], "q": each["types"]}, [f"p.{k}_out -> q.{k}_in" for k in kinds])
    columns = {"real_in": [0.0, 1.0], "int_in": [3, 4], "bool_in": [0, 1], "enum_in": [1, 2]}
    scenario = Trace(np.array([0.0, 0.5]), {f"p.{k}": np.array(v, float) for k, v in columns.items()})
    trace = both(system, master, scenario=scenario, set={"p.label": "crane"}).result.trace
    late = trace.time >= 0.5
    np.testing.assert_allclose(trace["q.real_out"], np.minimum(2 * trace.time, 1), atol=1e-15)  # rounding
    np.testing.assert_array_equal(trace["q.int_out"], np.where(late, 6, 5))
    np.testing.assert_array_equal(trace["q.bool_out"], late)
    np.testing.assert_array_equal(trace["q.enum_out"], np.where(late, 2, 1))


def test_a_text_as_input_is_no_number(each, both):
    """It is neither recorded nor driven, but can have a start value, and the text of another FMU."""
    common = 'name="ear" causality="input" variability="discrete" valueReference='
    string = {
        2: f'<ScalarVariable {common}"3"><String start="hush"/></ScalarVariable>',
        3: f'<String {common}"203"><Start value="hush"/></String>',
    }
    fmu = each.make("types", "eared", more=string[each.fmi])
    result = both(assemble({"p": fmu}), set={"p.ear": "listen"}).result
    assert "p.ear" not in result.trace.signals
    wired = run(assemble({"p": each["types"], "q": fmu}, ["p.echo -> q.ear"]), step=0.1, stop=0.2)
    assert ("p.echo", "hello") in [(name, text[:5]) for _, name, text in wired.texts]
    message = problem(lambda: assemble({"p": each["types"], "q": fmu}, ["p.int_out -> q.ear"]))
    assert "variables of type Integer and String cannot be connected" in message
    column = Trace(np.array([0.0, 1.0]), {"p.ear": np.zeros(2)})
    message = problem(lambda: run(assemble({"p": fmu}), column, step=0.1))
    assert "column 'p.ear': expected an input or a tunable parameter, got a String input" in message


LARGE = 2**53  # whole numbers that a trace keeps


@pytest.mark.parametrize("kind", WIDTHS)
def test_whole_numbers_pass_up_to_their_limits(fmus3, both, kind):
    """From a scenario, along a connection, to the record; a value that does not fit is refused by name."""
    name, (low, high) = kind.lower(), (np.iinfo(kind.lower()).min, np.iinfo(kind.lower()).max)
    system = assemble({"p": fmus3["wide"], "q": fmus3["wide"]}, [f"p.int64_out -> q.{name}_in"])
    ends = np.array([max(low, -LARGE), min(high, LARGE)], float)
    moved = both(system, scenario=Trace(np.array([0.0, 1.0]), {"p.int64_in": ends}), step=0.5).result.trace
    np.testing.assert_array_equal(moved[f"q.{name}_out"], ends[[0, 0, 1]])
    for value in {low - 1, high + 1}:
        if abs(value) <= LARGE:
            jump = Trace(np.array([0.0, 1.0]), {"p.int64_in": np.array([1.0, value])})
            outcome = both(system, scenario=jump, step=0.5)
            assert outcome.error == f"{name}_in: expected a value in the range of {name}, got {value}"
            assert outcome.result.trace.time[-1] == 0.5


@pytest.mark.parametrize("kind", ["Int64", "UInt64"])
def test_wires_keep_all_64_bits(fmus3, both, kind):
    """2^53 + 1, which no float64 is, arrives; results say what they round, and a scenario is refused."""
    name, wide = kind.lower(), fmus3["wide"]
    system = assemble({"p": wide, "q": wide}, [(f"p.{name}_out", "q.int64_in", 1, -(2**53))])
    result = both(system, set={f"p.{name}_in": 2**53 + 1}).result
    np.testing.assert_array_equal(result.trace["q.int64_in"], 1)
    note = "whole numbers above 2^53 may be rounded where they are recorded"
    assert f"p.{name}_in, p.{name}_out: {note}" in result.card.notes
    far = Trace(np.array([0.0, 1.0]), {f"p.{name}_in": np.array([0.0, 2.0**54])})
    message = problem(lambda: run(assemble({"p": wide}), far, step=0.5))
    got = f"got {2**54} in row 2, at 1 s"
    assert message.endswith(f"column 'p.{name}_in': expected whole numbers up to {LARGE}, {got}")


def test_a_transformation_of_whole_numbers_keeps_all_64_bits(fmus3):
    """Also where Python computes it: at the initialisation, and in Model Exchange."""
    system = assemble({"p": fmus3["wide"]})
    wide, real = (system.variable(system.port(f"p.{name}_in")) for name in ("int64", "float32"))
    wire = LinearTransformation(1.0, -(2.0**53), table=((7.0, 2.0**53),))
    connection = Connection(system.port("p.int64_out"), system.port("p.int64_in"), wire)
    assert [connection.carried(value, wide) for value in (2**53 + 1, 7, True)] == [1, 2**53, 1 - 2**53]
    assert replace(connection, map=LinearTransformation(0.5, 1.0)).carried(3, real) == 2.5


@pytest.mark.parametrize("master", MASTERS)
def test_narrower_types_feed_wider_ones(each, both, master):
    """Boolean to Integer and Real, Integer and Enumeration to Real, with a transformation."""
    wires = [("p.int_out", "q.real_in", 0.5, 1.0), ("p.bool_out", "q.int_in", 3, -1)]
    wires += [("p.enum_out", "r.real_in", 2.0, 0.0), ("p.bool_out", "r.int_in")]
    system = assemble({"p": each["types"], "q": each["types"], "r": each["types"]}, wires)
    moved = {"p.int_in": [3.0, 7, 7], "p.bool_in": [0.0, 1, 1], "p.enum_in": [1.0, 1, 2]}
    rows = Trace(np.array([0.0, 0.5, 1.0]), {n: np.array(v) for n, v in moved.items()})
    trace = both(system, master, scenario=rows, step=0.5).result.trace
    sent = {"q.real_in": 0.5 * trace["p.int_out"] + 1, "q.int_in": 3 * trace["p.bool_out"] - 1}
    sent |= {"r.real_in": 2 * trace["p.enum_out"], "r.int_in": trace["p.bool_out"]}
    for name, values in sent.items():
        np.testing.assert_array_equal(trace[name], values)
        assert np.ptp(values) > 0


def test_wires_of_whole_numbers_keep_whole_numbers(each, both):
    """A factor that is not an integer is refused."""
    files = {"p": each["types"], "q": each["types"]}
    doubled = assemble(files, [("p.int_out", "q.int_in", 2, -3)], {"p.int_in": 4})
    np.testing.assert_array_equal(both(doubled).result.trace["q.int_in"], 7)
    message = problem(lambda: assemble(files, [("p.int_out", "q.int_in", 0.5, 0)]))
    assert "p.int_out -> q.int_in: expected integer factor and offset, got 0.5 and 0" in message


@pytest.mark.parametrize("master", MASTERS)
def test_single_precision_passes(fmus3, both, master):
    """FMUs without any double; also beside doubles in one FMU, and with rates of another type."""
    single = fmus3.make("single", "single", guid="quirk")
    changes = {"u_rate": {"kind": "Real"}}
    mixed = fmus3.make("single", "mixed_widths", guid="quirk", changes=changes)
    doubles = both(circle(fmus3, "plain"), master).result.trace["q.y"]
    for p in (single, mixed):
        found = both(assemble({"p": p, "q": single}, CIRCLE, TURNS), master).result.trace["q.y"]
        np.testing.assert_allclose(found, doubles, atol=1e-6)  # seven digits, and as many steps


def test_what_no_type_of_the_record_holds_is_refused(fmus3, both):
    """By name, never truncated; in Float32 it is infinite, by C and by Python, without a warning of NumPy."""
    outcome = both(assemble({"p": fmus3["wide"]}), set={"p.uint64_in": 2**63})
    assert outcome.error == f"uint64_out: expected a value in the range of int64, got {2**63}"
    ramp = Trace(np.array([0.0, 1.0]), {"p.float32_in": np.array([0.0, 1e300])})
    outcome = both(assemble({"p": fmus3["wide"]}), scenario=ramp, step=0.5)
    assert outcome.error == "p.float32_out: expected a finite value, got inf at t = 0.5 s"


def test_two_names_of_one_variable_go_side_by_side(each, both):
    """Both names give the same value, in a connection and in the record."""
    other = 'name="same" valueReference="1" causality="output" variability="continuous"'
    more = f"<ScalarVariable {other}><Real/></ScalarVariable>" if each.fmi == 2 else ""
    aliases = {"y": "same"} if each.fmi == 3 else None
    fmu = each.make("quirk", "two_names", interpolates=each.fmi == 2, more=more, aliases=aliases)
    named = both(assemble({"p": fmu, "q": fmu}, ["p.same -> q.u", CIRCLE[1]], TURNS), master=HERMITE)
    plain = both(circle(each, "plain"), master=HERMITE)
    np.testing.assert_array_equal(named.result.trace["q.y"], plain.result.trace["q.y"])


HELD = {"u": {"steady": "discrete"}, "u_rate": {"derives": None}}  # an input that holds its value


@pytest.mark.parametrize("master", MASTERS)
def test_inputs_that_do_not_move_have_the_value_of_the_beginning(each, both, master):
    """Held over a step by every master at the value of its source at its communication point."""
    fmu = each.make("quirk", "steady", interpolates=each.fmi == 2, changes=HELD)
    system = assemble({"s": each["source"], "q": fmu}, ["s.y -> q.u"])
    trace = both(system, master, step=0.25).result.trace
    # rounding of inner steps
    np.testing.assert_allclose(trace["q.y"], [0, *0.25 * np.cumsum(trace["s.y"][:-1])], rtol=1e-12)
    assert "q.u" not in " ".join(both(system, master).result.card.notes)


STAIRS = np.array([0.0, 0.5, 1.0]), np.array([1.0, 3.0, 7.0])
TUNABLE = {"gain": {"steady": "tunable"}}


@pytest.mark.parametrize("master", ["jacobi", "hermite"])
@pytest.mark.parametrize(("name", "changes"), [("q.gain", TUNABLE), ("gain", TUNABLE), ("q.u", HELD)])
def test_scenarios_hold_what_does_not_move(each, both, master, name, changes):
    """A row, not a line between rows, is the value of a tunable parameter and of an input that is held."""
    fmu = each.make("quirk", "stairs", interpolates=each.fmi == 2, changes=changes)
    system, other = assemble({"q": fmu}), {"q.gain": 1.0} if name == "q.u" else {"q.u": 1.0}
    rows = Trace(STAIRS[0], {name: STAIRS[1]})
    trace = both(system.with_start(other), master, scenario=rows, step=0.25).result.trace
    np.testing.assert_array_equal(trace[f"q.{name.removeprefix('q.')}"], [1, 1, 3, 3, 7])
    np.testing.assert_allclose(trace["q.y"], [0, 0.25, 0.5, 1.25, 2.0], rtol=1e-12)  # rounding of inner steps


def test_tunable_parameters_count_from_the_point_of_a_row_on(each, both):
    """FMI 2.0.5, 2.2.7: also in outputs that are read there."""
    fmu = each.make("gain", "tuned_gain", changes={"factor": {"steady": "tunable"}})
    system, rows = assemble({"g": fmu}).with_start({"g.u": 2.0}), Trace(STAIRS[0], {"factor": STAIRS[1]})
    trace = both(system, scenario=rows, step=0.25).result.trace
    np.testing.assert_array_equal(trace["g.y"], [2, 2, 6, 6, 14])


@pytest.mark.parametrize(("step", "at"), [(0.3, 0.9), (1 / 3, 0.3333333), (0.1, 0.30000000000000004 - 1e-16)])
def test_a_row_is_at_the_communication_point_that_it_equals_but_for_rounding(each, both, step, at):
    """The sum 0.3 + 0.3 + 0.3 is below 0.9, and a file has seven digits of 1/3: the input comes in time."""
    fmu = each.make("quirk", "in_time", changes=HELD)
    n = round(at / step)
    assert n * step != at
    row = Trace(np.array([0.0, at]), {"u": np.array([1.0, 5.0])})
    trace = both(assemble({"q": fmu}), scenario=row, step=step, stop=6 * step).result.trace
    np.testing.assert_array_equal(trace.time, np.arange(7) * step)
    np.testing.assert_array_equal(trace["q.u"], np.where(np.arange(7) < n, 1.0, 5.0))


def test_a_held_input_is_driven_in_its_own_unit(fmus, both):
    """An input of the system, in degC, feeds one in degC and one in K."""
    files = {
        unit: fmus.make("quirk", f"held_{unit}", changes=HELD | {"u": {**HELD["u"], "unit": unit}})
        for unit in ("degC", "K")
    }
    system = assemble(files, inputs={"warm": ["degC.u", "K.u"]})
    rows = Trace(np.array([0.0, 0.5, 1.0]), {"warm": np.array([20.0, 45.0, -5.0])})
    trace = both(system, scenario=rows, step=0.5).result.trace
    np.testing.assert_array_equal(trace["degC.u"], [20, 45, -5])
    np.testing.assert_array_equal(trace["K.u"], np.array([20, 45, -5]) + 273.15)


def test_a_ramp_of_a_microsecond_is_a_jump_at_its_end(fmus):
    """Between communication points too, where every master has one; a longer ramp has two corners."""
    time = np.array([0.0, 1.2, 1.2 + 2e-9, 2.0 - 1e-6, 2.0, 2.2, 2.3, 3.0])
    rows = Trace(time, {"u": np.array([1.0, 1, 4, 4, 0, 0, 1, 1])})
    trace = run(str(fmus["drift"]), rows, step=1.0, record=["drift.u"]).trace
    np.testing.assert_array_equal(trace["drift.u"], [1, 1, 0, 1])
    assert Job.of(str(fmus["drift"]), rows, RunOptions(step=1.0)).times.divided == (1.2 + 2e-9,)
    adaptive = RunOptions(coupling=Coupling("jacobi", adaptive=1e-3), record_step=1.0)
    times = Job.of(str(fmus["drift"]), rows, adaptive).times
    assert times.divided == (1.2 + 2e-9, 2.2, 2.3)


def test_inputs_cannot_be_tunable(each):
    """The standard has no such inputs; a description with one is refused by name."""
    fmu = each.make("quirk", "tunable", changes={"u": {"steady": "tunable"}})
    problem(lambda: assemble({"q": fmu}), "u: causality input with variability tunable is not allowed$")
