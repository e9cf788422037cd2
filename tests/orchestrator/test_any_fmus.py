"""FMUs from elsewhere: what they lack and what they do, under every master, in C and in Python alike."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from any_fmu.models import WIDTHS, Workshop

from orchestrator import Problem, System, Trace, assemble, run
from orchestrator.coupling.settings import Coupling
from orchestrator.runs import native
from orchestrator.runs.march import March
from orchestrator.runs.simulation import Result, RunFailed, open_slave
from orchestrator.slaves.slave import Slave

NO_ROLLBACK = {"canGetAndSetFMUstate": "false", "canGetAndSetFMUState": "false"}
STUCK = "hermite computes every step once: q cannot go back to a saved state"
SILENT = "slopes from differences of values, because the FMUs tell none: q.y"
STILL = "inputs held at their mean over a step, because the FMUs take no slopes: "
STRAIGHT = "inputs moved at straight lines, because the FMUs take no curves: "
NONE, WARNING, DISCARD, FAULT, FATAL, NOT_A_NUMBER, ENOUGH, EARLY, EVENT, TALK = range(10)
WHERE = {"DoStep": 0, "Get": 1, "Set": 2, "GetState": 3, "SetState": 4, "GetSlope": 5, "SetSlope": 6}
HERMITE = Coupling("hermite", tolerance=1e-9)  # never content with one pass here
PROPERLY = "terminated and freed, states left: 0"
MASTERS = [
    *(Coupling("jacobi", 0), Coupling("jacobi", 1), Coupling("jacobi", 2)),
    *(Coupling("gauss-seidel", 0), Coupling("gauss-seidel", 1), HERMITE),
]


@dataclass
class Outcome:
    """What a run left: its result, its error, and the slaves that it used."""

    result: Result
    error: str
    slaves: dict[str, Slave]

    @property
    def farewells(self) -> list[str]:
        """What the test FMUs say when they are freed: whether they had been terminated, and their states."""
        found = (m.text for slave in self.slaves.values() for m in slave.log.messages)
        return [text for text in found if "freed" in text]


def once(system: System, in_c: bool, **options) -> Outcome:
    """One run, whether it fails or not."""
    slaves = {}

    def opened(component):
        slaves[component.name] = open_slave(component)
        return slaves[component.name]

    try:
        return Outcome(run(system, open=opened, native=in_c, **options), "", slaves)
    except RunFailed as failed:
        return Outcome(failed.result, str(failed), slaves)


@pytest.fixture
def both(monkeypatch):
    """Runs a system in both loops and compares all that they leave."""
    assert not isinstance(native.library(), str)

    def run_both(system, master="gauss-seidel", step=0.1, stop=1.0, **options) -> Outcome:
        options |= {"master": master, "step": step, "stop": stop}
        with monkeypatch.context() as patch:
            patch.setattr(March, "block", None)  # it is the loop in Python
            fast = once(system, True, **options)
        slow = once(system, False, **options)
        compare(fast, slow)
        return fast

    return run_both


def compare(fast: Outcome, slow: Outcome) -> None:
    """Numbers to the last bit, and words."""
    assert fast.error == slow.error
    assert fast.result.complete == slow.result.complete
    np.testing.assert_array_equal(fast.result.trace.time, slow.result.trace.time)
    for name, values in slow.result.trace.signals.items():
        np.testing.assert_array_equal(fast.result.trace[name], values, err_msg=name)
    assert fast.result.card.notes == slow.result.card.notes
    assert fast.result.card.warnings == slow.result.card.warnings
    assert fast.result.card.steps == slow.result.card.steps
    assert fast.result.messages == slow.result.messages
    assert fast.farewells == slow.farewells


def circle(workshop: Workshop, quirk: str = "plain", able=None, changes=None, **start) -> System:
    """p' = q and q' = 1 - p, from rest at 0, so q = sin t; the component q is the one with the quirk."""
    curved = workshop.fmi == 2 and not (changes or {}).get("u_rate")
    known = {
        k: v for k, v in (able or {}).items() if k not in NO_ROLLBACK or ("Us" in k) == (workshop.fmi == 2)
    }
    name = f"quirk_{quirk}"
    files = {
        "p": workshop.make("quirk", "quirk_p", interpolates=workshop.fmi == 2),
        "q": workshop.make("quirk", name, interpolates=curved, able=known, changes=changes),
    }
    values = {"q.push": 1.0, "q.gain": -1.0} | {f"q.{k}": v for k, v in start.items()}
    return assemble(files, ["p.y -> q.u", "q.y -> p.u"], values)


# ---- what FMUs lack

ABLE = {
    "nothing": {},
    "no rollback": {"able": NO_ROLLBACK},
    "no slopes": {"able": {"maxOutputDerivativeOrder": 0}},
    "slopes refused": {"mute": 1},
    "no rate": {"changes": {"u_rate": {"derives": None}}},
    "first derivatives only": {"highest": 1},
    "one instance": {"able": {"canBeInstantiatedOnlyOncePerProcess": "true"}},
    "equal steps": {"able": {"canHandleVariableCommunicationStepSize": "false"}, "even": 1},
}


def expected(quirk: str, fmi: int, master: Coupling) -> list[str]:
    """What the card is to say."""
    order = master.extrapolation
    degree = {"jacobi": order, "gauss-seidel": order + 1, "hermite": 3}[master.master]
    notes = [STUCK] if quirk == "no rollback" and master.master == "hermite" else []
    if order == 0 and degree < 2:
        return notes  # values are all that is wanted of the FMUs
    notes += [SILENT] if quirk in ("no slopes", "slopes refused") else []
    notes += [STILL + "q.u"] if quirk == "no rate" else []
    limited = (
        [] if quirk == "no rate" else ["q.u"] if quirk in ("first derivatives only", "one instance") else []
    )
    straight = [*(["p.u"] if fmi == 3 else []), *(["q.u"] if fmi == 3 and quirk != "no rate" else limited)]
    return notes + ([STRAIGHT + ", ".join(straight)] if straight and degree > 1 else [])


@pytest.mark.parametrize("quirk", ABLE)
def test_masters_do_without(each, both, quirk):
    """Every master gets along, in both loops alike, says what it had to do without, and stays accurate."""
    for master in MASTERS:
        result = both(circle(each, quirk.replace(" ", "_"), **ABLE[quirk]), master=master).result
        assert list(result.card.notes) == expected(quirk, each.fmi, master), master.text
        error = np.abs(result.trace["q.y"] - np.sin(result.trace.time)).max()
        # the first neglected term of a polynomial of degree k - 1 is at most h^k / 2 here, where all
        # derivatives are at most 1; what holds a mean or has one pass only keeps an order of 3 at worst
        order = {"jacobi": 1, "gauss-seidel": 1, "hermite": 3}[master.master] + (master.order or 0)
        assert error < 0.1 ** min(order, 2 if master.master != "hermite" else 3) / 2, master.text


def without_rollback(workshop: Workshop, model: str, name: str) -> Path:
    """An FMU that cannot go back."""
    able = {"canGetAndSetFMUstate" if workshop.fmi == 2 else "canGetAndSetFMUState": "false"}
    return workshop.make(model, name, interpolates=workshop.fmi == 2, able=able)


def test_only_what_is_repeated_must_go_back(each, both):
    """A source and what hears from it alone step once; two that hear from each other are repeated."""
    pair = circle(each, "circle")
    files = {"s": without_rollback(each, "source", "wave"), "f": without_rollback(each, "quirk", "follower")}
    files |= {name: component.source.path for name, component in pair.components.items()}
    wires = [*map(str, pair.connections), "s.y -> f.u"]
    four = both(assemble(files, wires, {"q.push": 1.0, "q.gain": -1.0}), master=HERMITE).result
    two = both(pair, master=HERMITE).result
    assert not [n for n in four.card.notes if "every step once" in n]
    np.testing.assert_array_equal(four.trace["q.y"], two.trace["q.y"])


def test_what_hears_from_what_is_repeated_is_repeated_too(each, both):
    """It works with other inputs in the second pass, so it has to go back."""
    pair = circle(each, "circle")
    files = {"l": without_rollback(each, "quirk", "listener")}
    files |= {name: component.source.path for name, component in pair.components.items()}
    start = {"q.push": 1.0, "q.gain": -1.0}
    result = both(assemble(files, [*map(str, pair.connections), "q.y -> l.u"], start), master=HERMITE).result
    assert "hermite computes every step once: l cannot go back to a saved state" in result.card.notes


def test_an_fmu_for_one_instance_is_not_used_twice(each):
    """Both components are named."""
    able = {"canBeInstantiatedOnlyOncePerProcess": "true"}
    fmu = each.make("gain", "hermit", able=able)
    with pytest.raises(
        Problem, match=r"^p and q: expected one instance, their FMU can have no more, got two$"
    ):
        run(assemble({"p": fmu, "q": fmu}), step=0.1, stop=0.2)
    other = each.make("gain", "other_hermit", able=able, guid="gain")
    run(assemble({"p": fmu, "q": other}), step=0.1, stop=0.2)


@pytest.mark.parametrize("factor", [1, 3])
@pytest.mark.parametrize("step", [0.1, 1 / 60])
def test_equal_steps_are_equal_to_the_last_bit(each, both, step, factor):
    """The FMU refuses any other length; the differences of the communication points are not all the same."""
    able = {"canHandleVariableCommunicationStepSize": "false"}
    for master in ("jacobi", "hermite"):
        system = circle(each, "even", able=able, even=1)
        outcome = both(system, master=Coupling(master, factors={"q": factor}), step=step, stop=60 * step)
        assert outcome.error == ""
        assert outcome.result.card.steps == 60
    points = step * np.arange(61)
    assert len(set(np.diff(points))) > 1
    varied = both(circle(each, "uneven", even=1), step=step, stop=60 * step)
    assert "the step is longer than the first by" in varied.error


@pytest.mark.parametrize("factor", [3, 7])
@pytest.mark.parametrize("master", ["jacobi", "hermite"])
def test_steps_of_its_own_begin_where_the_last_one_ended(each, both, master, factor):
    """To the last bit: the FMU asks for it."""
    outcome = both(circle(each, "strict"), Coupling(master, factors={"q": factor}), stop=6.0)
    assert outcome.error == ""


def test_an_fmu_for_slopes_of_states_only(each, both):
    """It refuses those of other outputs: these follow from differences, the others are told."""
    more = {"fmi2": "Real", "fmi3": "Float64"}[f"fmi{each.fmi}"]
    alias = 'name="idle" valueReference="0" causality="output" variability="continuous"'
    extra = f"<{more} {alias}/>" if each.fmi == 3 else f"<ScalarVariable {alias}><Real/></ScalarVariable>"
    fmu = each.make("quirk", "partly", interpolates=each.fmi == 2, more=extra.replace('"0"', '"3"'))
    files = {"p": fmu, "q": each.make("quirk", "listener", interpolates=each.fmi == 2)}
    system = assemble(files, ["p.y -> q.u", "q.y -> p.u"], {"q.push": 1.0, "q.gain": -1.0})
    wired = assemble({**files, "r": files["q"]}, ["p.y -> q.u", "q.y -> p.u", "p.idle -> r.u"])
    assert "none: " not in " ".join(both(system, master=HERMITE).result.card.notes)
    notes = both(wired, master=HERMITE).result.card.notes
    assert "slopes from differences of values, because the FMUs tell none: p.idle" in notes


# ---- what FMUs do


@pytest.mark.parametrize("how", [DISCARD, FAULT, FATAL])
@pytest.mark.parametrize("where", WHERE)
def test_failures_lose_nothing(each, both, where, how):
    """In whatever call, both loops say the same; what was computed stays; states and instances are freed.

    Of an FMU with a fatal error nothing is called any more.
    """
    if where == "SetSlope" and each.fmi == 3:
        return  # has no such function
    outcome = both(circle(each, "failing", when=0.45, how=how, where=WHERE[where]), master=HERMITE)
    word = {"DoStep": "the step"}.get(where, f"q: fmi{each.fmi}")
    status = {DISCARD: "discard", FAULT: "error", FATAL: "fatal"}[how]
    assert word in outcome.error
    assert f"with status {status}" in outcome.error
    assert not outcome.result.complete
    assert outcome.result.trace.time[-1] >= 0.4
    mine = [] if how == FATAL else ["freed, states left: 0"] if how == FAULT else [PROPERLY]
    assert outcome.farewells == [PROPERLY, *mine]


@pytest.mark.parametrize("master", ["jacobi", "gauss-seidel"])
def test_a_step_done_in_part_is_told(each, both, master):
    """Masters that cannot go back stop there, and tell how far the FMU got."""
    outcome = both(circle(each, "slow", longest=0.03, when=0.25), master=master)
    assert outcome.error.endswith("with status discard (the FMU got as far as t = 0.03 s)")
    assert outcome.result.trace.time.tolist() == [0.0]


@pytest.mark.parametrize("master", MASTERS, ids=lambda m: m.text)
def test_an_fmu_may_end_the_run(each, both, master):
    """The run is complete up to the communication point before; a note names the FMU and the time."""
    outcome = both(circle(each, "enough", when=0.45, how=ENOUGH), master=master)
    assert outcome.error == ""
    assert outcome.result.complete
    assert outcome.result.trace.time[-1] == 0.5
    asked = {2: 0.5, 3: 0.6}[each.fmi]  # with a status that denies the step, or with a step that was done
    note = f"the FMU asks to end the simulation at t = {asked} s"
    assert (
        outcome.result.card.notes[-1] == f"the run ends early: q: the step at t = 0.5 s is the last: {note}"
    )
    assert outcome.farewells == [PROPERLY] * 2


def test_an_end_before_the_first_step_is_an_end_too(each, both):
    """The record has the start, which is what there is."""
    outcome = both(circle(each, "unwilling", when=0.0, how=ENOUGH))
    assert outcome.result.complete
    assert outcome.result.trace.time.tolist() == [0.0]


def test_a_return_that_was_not_allowed_is_an_error(fmus3, both):
    """Early return is off."""
    outcome = both(circle(fmus3, "early", when=0.45, how=EARLY))
    assert outcome.error == "q: the step at t = 0.5 s ended early at t = 0.55 s, which was not allowed"


def test_a_wish_for_event_handling_passes(fmus3, both):
    """As a warning; the numbers are those of an FMU without wishes."""
    wishing = both(circle(fmus3, "eventful", when=0.45, how=EVENT), master=HERMITE).result
    plain = both(circle(fmus3, "plain"), master=HERMITE).result
    assert "q: the FMU asks for event handling, which it was told to do itself" in wishing.card.warnings[0]
    np.testing.assert_array_equal(wishing.trace["q.y"], plain.trace["q.y"])


@pytest.mark.parametrize("how", [WARNING, TALK])
def test_warnings_pass_in_every_call(each, both, how):
    """With the numbers of an FMU that is silent; each message has the time at which it came."""
    talking = both(circle(each, "talking", when=0.05, how=how, where=-1), master=HERMITE).result
    plain = both(circle(each, "plain"), master=HERMITE).result
    np.testing.assert_array_equal(talking.trace["q.y"], plain.trace["q.y"])
    assert {m.status for m in talking.messages} == {"warning" if how == WARNING else "ok"}
    assert {round(10 * m.time) for m in talking.messages} == set(range(11))


def test_a_message_inside_a_step_has_the_time_of_the_step(each, both):
    """Its beginning, in the order of the steps."""
    told = both(circle(each, "chatty", when=0.25, how=TALK), master="jacobi", step=0.125).result.messages
    assert [m.time for m in told] == [0.25, 0.375, 0.5, 0.625, 0.75, 0.875]


@pytest.mark.parametrize("master", MASTERS, ids=lambda m: m.text)
def test_a_number_that_is_none_ends_the_record(each, both, master):
    """The last point is the last one that is finite."""
    outcome = both(circle(each, "broken", when=0.45, how=NOT_A_NUMBER), master=master)
    assert ".y: expected a finite value, got nan at t = 0.6 s" in outcome.error
    assert outcome.result.trace.time[-1] == 0.5


def test_the_number_is_told_before_what_follows_from_it(each, both):
    """An FMU that fails on what is no number is not the cause."""
    files = {"q": each.make("quirk", "source_of_nan"), "f": each.make("quirk", "victim")}
    start = {"q.when": 0.25, "q.how": NOT_A_NUMBER, "f.when": 0.65, "f.how": FAULT}
    outcome = both(assemble(files, ["q.y -> f.u"], start))
    assert outcome.error == "q.y: expected a finite value, got nan at t = 0.4 s"


# ---- kinds of variables


@pytest.mark.parametrize("master", MASTERS, ids=lambda m: m.text)
def test_all_kinds_pass_on_wires_and_from_scenarios(each, both, master):
    """Real, whole, true or false, one of a list; a text keeps its start value."""
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
    with pytest.raises(Problem, match=r"variables of type String and String cannot be connected"):
        assemble(
            {"p": each["types"], "q": each.make("types", "heard", more=text_input(each))}, ["p.echo -> q.ear"]
        )


def text_input(workshop: Workshop) -> str:
    """One more variable."""
    if workshop.fmi == 2:
        common = 'name="ear" valueReference="3" causality="input" variability="discrete"'
        return f'<ScalarVariable {common}><String start="hush"/></ScalarVariable>'
    common = 'name="ear" valueReference="203" causality="input" variability="discrete"'
    return f'<String {common}><Start value="hush"/></String>'


def test_a_text_as_input_is_left_alone(each, both):
    """It is neither recorded nor driven, and can be given at the start."""
    fmu = each.make("types", "eared", more=text_input(each))
    result = both(assemble({"p": fmu}), set={"p.ear": "listen"}).result
    assert "p.ear" not in result.trace.signals
    with pytest.raises(Problem, match=r"column 'p.ear': expected an input, got a String input"):
        run(assemble({"p": fmu}), Trace(np.array([0.0, 1.0]), {"p.ear": np.zeros(2)}), step=0.1)


LIMITS = {
    f"{u}Int{n}": (0, 2**n - 1) if u else (-(2 ** (n - 1)), 2 ** (n - 1) - 1)
    for u in ("", "U")
    for n in (8, 16, 32, 64)
}
SMALL, LARGE = -(2**31), 2**31 - 1  # what a run keeps of whole numbers


@pytest.mark.parametrize("kind", WIDTHS)
def test_whole_numbers_pass_up_to_their_limits(fmus3, both, kind):
    """From a scenario into an FMU, over a wire, and to the record; what does not fit is refused by name."""
    name, (low, high) = kind.lower(), LIMITS[kind]
    system = assemble({"p": fmus3["wide"], "q": fmus3["wide"]}, [f"p.int64_out -> q.{name}_in"])
    ends = np.array([max(low, -LARGE), min(high, LARGE)], float)
    moved = both(system, scenario=Trace(np.array([0.0, 1.0]), {"p.int64_in": ends}), step=0.5).result.trace
    np.testing.assert_array_equal(moved[f"q.{name}_out"], ends[[0, 0, 1]])
    for value in {low - 1, high + 1}:
        if SMALL < value <= LARGE:
            jump = Trace(np.array([0.0, 1.0]), {"p.int64_in": np.array([1.0, value])})
            outcome = both(system, scenario=jump, step=0.5)
            assert outcome.error == f"{name}_in: {value} does not fit into {name}"
            assert outcome.result.trace.time[-1] == 0.5


@pytest.mark.parametrize("kind", ["UInt32", "Int64", "UInt64"])
def test_whole_numbers_beyond_32_bits_are_refused(fmus3, both, kind):
    """By name, on their way out of an FMU and in a scenario; never cut."""
    name, (_, high) = kind.lower(), LIMITS[kind]
    outcome = both(assemble({"p": fmus3["wide"]}), set={f"p.{name}_in": high})
    assert outcome.error == f"{name}_out: {high} does not fit into int32"
    far = Trace(np.array([0.0, 1.0]), {f"p.{name}_in": np.array([0.0, 2.0**31])})
    with pytest.raises(
        Problem, match=rf"column 'p.{name}_in': expected whole numbers up to {LARGE}, got {2**31}$"
    ):
        run(assemble({"p": fmus3["wide"]}), far, step=0.5)


def test_wires_of_whole_numbers_keep_whole_numbers(each, both):
    """A factor that is none is refused."""
    files = {"p": each["types"], "q": each["types"]}
    doubled = assemble(files, [("p.int_out", "q.int_in", 2, -3)], {"p.int_in": 4})
    np.testing.assert_array_equal(both(doubled).result.trace["q.int_in"], 7)
    with pytest.raises(
        Problem, match=r"p.int_out -> q.int_in: expected whole factor and offset, got 0.5 and 0"
    ):
        assemble(files, [("p.int_out", "q.int_in", 0.5, 0)])


@pytest.mark.parametrize("master", MASTERS, ids=lambda m: m.text)
def test_single_precision_passes(fmus3, both, master):
    """FMUs without any double; also beside doubles in one FMU, and with rates of another type."""
    single = fmus3.make("single", "single", guid="quirk")
    changes = {"u_rate": {"kind": "Real"}}
    mixed = fmus3.make("single", "mixed_widths", guid="quirk", changes=changes)
    start = {"q.push": 1.0, "q.gain": -1.0}
    wires = ["p.y -> q.u", "q.y -> p.u"]
    outcome = both(assemble({"p": single, "q": single}, wires, start), master)
    doubles = both(circle(fmus3, "plain"), master)
    # seven digits, and as many steps
    np.testing.assert_allclose(outcome.result.trace["q.y"], doubles.result.trace["q.y"], atol=1e-6)
    other = both(assemble({"p": mixed, "q": single}, wires, start), master)
    np.testing.assert_allclose(other.result.trace["q.y"], doubles.result.trace["q.y"], atol=1e-6)


def test_what_is_too_large_for_single_precision_is_infinite(fmus3, both):
    """In both loops, without a word from NumPy; the record refuses it."""
    ramp = Trace(np.array([0.0, 1.0]), {"p.float32_in": np.array([0.0, 1e300])})
    outcome = both(assemble({"p": fmus3["wide"]}), scenario=ramp, step=0.5)
    assert outcome.error == "p.float32_out: expected a finite value, got inf at t = 0.5 s"


def test_two_names_of_one_variable_go_side_by_side(each, both):
    """The same value under both, on a wire and in the record."""
    other = 'name="same" valueReference="1" causality="output" variability="continuous"'
    more = f"<ScalarVariable {other}><Real/></ScalarVariable>" if each.fmi == 2 else ""
    aliases = {"y": "same"} if each.fmi == 3 else None
    fmu = each.make("quirk", "two_names", interpolates=each.fmi == 2, more=more, aliases=aliases)
    start = {"q.push": 1.0, "q.gain": -1.0}
    named = both(assemble({"p": fmu, "q": fmu}, ["p.same -> q.u", "q.y -> p.u"], start), master=HERMITE)
    plain = both(circle(each, "plain"), master=HERMITE)
    np.testing.assert_array_equal(named.result.trace["q.y"], plain.result.trace["q.y"])


@pytest.mark.parametrize("master", MASTERS, ids=lambda m: m.text)
def test_inputs_that_do_not_move_take_the_newest_value(each, both, master):
    """Held over a step: at its first value with jacobi, at its last with masters that step in turn."""
    changes = {"u": {"steady": "discrete"}, "u_rate": {"derives": None}}
    fmu = each.make("quirk", "steady", interpolates=each.fmi == 2, changes=changes)
    system = assemble({"s": each["source"], "q": fmu}, ["s.y -> q.u"])
    trace = both(system, master, step=0.25).result.trace
    held = trace["s.y"][:-1] if master.master == "jacobi" else trace["s.y"][1:]
    np.testing.assert_allclose(
        trace["q.y"], [0, *0.25 * np.cumsum(held)], rtol=1e-12
    )  # rounding of inner steps
    assert "q.u" not in " ".join(both(system, master).result.card.notes)


def test_inputs_cannot_be_tunable(each):
    """The standard has no such inputs; a description with one is refused by name."""
    with pytest.raises(Problem, match=r'Variable "u" .* illegal combination .*causality="input".*"tunable"'):
        assemble({"q": each.make("quirk", "tunable", changes={"u": {"steady": "tunable"}})})


@pytest.mark.parametrize("master", ["jacobi", "hermite"])
def test_scenarios_hold_what_does_not_move(each, both, master):
    """A column gives its last sample, not a line between samples, to an input that is not continuous."""
    changes = {"u": {"steady": "discrete"}, "u_rate": {"derives": None}}
    fmu = each.make(
        "quirk", "driven_steadily", interpolates=each.fmi == 2, changes=changes, units={"u": "bar"}
    )
    stairs = Trace(np.array([0.0, 0.5, 1.0]), {"q.u": np.array([1.0, 3.0, 7.0])})
    trace = both(assemble({"q": fmu}), master, scenario=stairs, step=0.25).result.trace
    np.testing.assert_array_equal(trace["q.u"], [1, 1, 3, 3, 7])
    np.testing.assert_allclose(trace["q.y"], [0, 0.25, 0.5, 1.25, 2.0], rtol=1e-12)  # rounding of inner steps


# ---- steps that are repeated

ADAPTIVE = [
    *(Coupling("jacobi", adaptive=1e-2), Coupling("jacobi", 2, adaptive=1e-5)),
    *(Coupling("gauss-seidel", 1, adaptive=1e-4), Coupling("hermite", adaptive=1e-5)),
]


def test_a_step_done_in_part_is_repeated_where_all_go_back(each, both):
    """In steps that the FMU can do, with the accuracy of steps of that length and without a warning."""
    outcome = both(circle(each, "slow", longest=0.03, when=0.25), master=HERMITE)
    assert outcome.error == ""
    result = outcome.result
    assert result.trace.time.tolist() == pytest.approx([0.1 * n for n in range(11)])
    assert result.card.steps >= 10 * 4  # at most 0.03 of 0.1 at once
    assert result.card.repeated > 0
    assert result.card.warnings == ()
    # straight lines in FMI 3.0: h^4 / 720 a radian; else less
    np.testing.assert_allclose(result.trace["q.y"], np.sin(result.trace.time), atol=1e-7)


@pytest.mark.parametrize("quirk", ["no rollback", "equal steps"])
def test_a_step_done_in_part_ends_the_run_where_one_cannot_repeat_it(each, both, quirk):
    """An FMU that cannot go back, or one that takes no shorter step."""
    options = ABLE[quirk] | {"longest": 0.03, "when": 0.25}
    outcome = both(circle(each, f"slow_{quirk[:2]}", **options), master=HERMITE)
    assert "with status discard (the FMU got as far as t = 0.03 s)" in outcome.error


def test_an_error_that_a_shorter_step_avoids_is_none(each, both):
    """The FMU is terminated properly in the end, and what it said is not told."""
    outcome = both(circle(each, "tender", longest=0.03, how=FAULT), master=HERMITE)
    assert outcome.error == ""
    assert outcome.result.card.warnings == ()
    assert outcome.farewells == [PROPERLY] * 2


@pytest.mark.parametrize("quirk", [quirk for quirk in ABLE if quirk != "equal steps"])
def test_adaptive_steps_do_without(each, both, quirk):
    """Errors stay at what is asked for, in both loops alike, whatever the FMUs lack."""
    for master in ADAPTIVE:
        system = circle(each, quirk.replace(" ", "_"), **ABLE[quirk])
        outcome = both(system, master=master, stop=2.0)
        assert outcome.error == "", master.text
        trace = outcome.result.trace
        assert trace.time[-1] == 2.0
        # inputs that are off by the tolerance all the time make twice that of an integral over 2 s
        assert np.abs(trace["q.y"] - np.sin(trace.time)).max() < 2 * master.adaptive, master.text
        stands = "adaptive steps with too large an error stand: q cannot go back to a saved state"
        assert (stands in outcome.result.card.notes) == (quirk == "no rollback")


def test_adaptive_steps_need_fmus_that_vary_theirs(each):
    """By name."""
    system = circle(each, "equal_steps", **ABLE["equal steps"])
    with pytest.raises(
        Problem, match=r"^adaptive steps: expected .* got q: the FMU takes steps of one length only$"
    ):
        run(system, step=0.1, stop=1.0, master=ADAPTIVE[0])


@pytest.mark.parametrize("master", ADAPTIVE, ids=lambda m: f"{m.text} {m.adaptive}")
@pytest.mark.parametrize("how", [DISCARD, FAULT, FATAL, NOT_A_NUMBER, ENOUGH])
def test_adaptive_runs_end_alike(each, both, master, how):
    """Whatever an FMU does in the middle of one: the same words, numbers and farewells in both loops."""
    outcome = both(circle(each, "ending", when=0.45, how=how), master=master, stop=2.0)
    assert bool(outcome.error) == (how != ENOUGH)
    assert 0.3 < outcome.result.trace.time[-1] < 0.6


def test_an_input_that_is_only_watched_is_left_alone(each, both):
    """One that an FMU moves at its rate input goes on so through all steps of its own."""
    files, wires = {"sum": each["drift"], "mass": each["mass_b"]}, ["mass.x -> sum.u", "mass.v -> sum.u_rate"]
    system = assemble(files, wires, {"mass.spring": 1.0})
    whole, twice = (
        both(system, Coupling("jacobi", adaptive=1e-2, factors={"sum": factor})).result.trace
        for factor in (1, 2)
    )
    # the same line in one piece or in two; rounding of inner steps
    np.testing.assert_allclose(twice["sum.y"], whole["sum.y"], rtol=1e-12)
