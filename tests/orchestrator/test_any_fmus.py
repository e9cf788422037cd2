"""Foreign FMUs: missing abilities and odd behaviour, with every master, called by C and by Python."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from kit import shards
from kit.any_fmu.models import Workshop
from kit.any_fmu.outcome import CIRCLE, HERMITE, MASTERS, NO_ROLLBACK, OPENERS, TURNS, circle
from kit.mistakes import problem
from kit.shards import thinned

from orchestrator import Trace, assemble, run
from orchestrator.fmi.instance import FmuInstance
from orchestrator.ssp.coupling import Coupling

STUCK = "hermite makes one pass per step, because q cannot restore a saved state"
DIFFERENCES = "input derivatives from differences of values, because the FMUs provide no output derivatives: "
STILL = "inputs held at their mean over a step, because the FMUs accept no input derivatives: "
STRAIGHT = "inputs linear over a step, because the FMUs accept first derivatives only: "
NONE, WARNING, DISCARD, FAULT, FATAL, NOT_A_NUMBER, ENOUGH, EARLY, EVENT, TALK = range(10)
WHERE = {"DoStep": 0, "Get": 1, "Set": 2, "GetState": 3, "SetState": 4, "GetSlope": 5, "SetSlope": 6}
PROPERLY = "terminated and freed, states left: 0"
HERE = {"step": 0.1, "stop": 1.0, "isolate": False}  # a process whose run was refused is not used again

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

BLIND = "not looked at inside of steps, because the FMUs cannot step to a time there and back: "


def expected(quirk: str, fmi: int, master: Coupling) -> list[str]:
    """The expected notes of the card."""
    order = master.extrapolation
    degree = {"jacobi": order, "gauss-seidel": order + 1, "hermite": 3}[master.master]
    notes = [STUCK] if quirk == "no rollback" and master.master == "hermite" else []
    if order == 0 and degree < 2:
        return notes  # values are all that is wanted of the FMUs
    notes += [DIFFERENCES + "q.y"] if quirk in ("no slopes", "slopes refused") else []
    notes += [STILL + "q.u"] if quirk == "no rate" else []
    straight = ["p.u"] if fmi == 3 else []
    if quirk != "no rate" and (fmi == 3 or quirk in ("first derivatives only", "one instance")):
        straight.append("q.u")
    return notes + ([STRAIGHT + ", ".join(straight)] if straight and degree > 1 else [])


PREDICTING = Coupling("interface-jacobian")  # extrapolates inputs from FMUs without directional derivatives


# half of the pairs: each ability with masters that want it and with one that does not
@pytest.mark.parametrize(("quirk", "master"), thinned(2, [*ABLE], [*MASTERS, PREDICTING]))
def test_masters_do_without(each, both, quirk, master):
    """Every master runs, called by C and by Python, with notes on missing abilities, and stays accurate."""
    result = both(circle(each, quirk.replace(" ", "_"), **ABLE[quirk]), master=master).result
    if master != PREDICTING:
        unseen = [BLIND + "q.y"] if quirk in ("no rollback", "equal steps") else []
        assert list(result.card.notes) == expected(quirk, each.fmi, master) + unseen
    error = np.abs(result.trace["q.y"] - np.sin(result.trace.time)).max()
    # the first neglected term of a polynomial of degree k - 1 is at most h^k / 2 here, where all
    # derivatives are at most 1; what holds a mean or has one pass only keeps an order of 3 at worst
    order = {"jacobi": 1, "gauss-seidel": 1, "hermite": 3, "interface-jacobian": 2}[master.master]
    assert error < 0.1 ** min(order + (master.order or 0), 3 if master.master == "hermite" else 2) / 2


def test_only_what_is_repeated_must_go_back(each, both):
    """A source and its target step once; what feeds each other is repeated, and what hears from it, too."""
    able = {"canGetAndSetFMUstate" if each.fmi == 2 else "canGetAndSetFMUState": "false"}
    pair, follows = circle(each, "circle"), each.fmi == 2
    files = {name: component.source.path for name, component in pair.components.items()}
    files["f"] = each.make("quirk", "follower", interpolates=follows, able=able)
    wave = each.make("source", "wave", interpolates=follows, able=able)
    led = assemble(files | {"s": wave}, [*CIRCLE, "s.y -> f.u"], TURNS)
    four, two = (both(system, master=HERMITE).result for system in (led, pair))
    assert not [n for n in four.card.notes if "one pass per step" in n]
    np.testing.assert_array_equal(four.trace["q.y"], two.trace["q.y"])
    notes = both(assemble(files, [*CIRCLE, "q.y -> f.u"], TURNS), master=HERMITE).result.card.notes
    assert "hermite makes one pass per step, because f cannot restore a saved state" in notes


def test_an_fmu_for_one_instance_is_not_used_twice(each):
    """Both components are named."""
    able = {"canBeInstantiatedOnlyOncePerProcess": "true"}
    fmu = each.make("gain", "hermit", able=able)
    message = problem(lambda: run(assemble({"p": fmu, "q": fmu}), **HERE))
    assert message == "p and q: expected one instance of their FMU at most, got two"
    other = each.make("gain", "other_hermit", able=able, guid="gain")
    run(assemble({"p": fmu, "q": other}), **HERE)


def lacking(workshop: Workshop, function: bytes) -> Workshop:
    """The same FMUs with a renamed function of the library."""
    assert function in workshop.library
    folder = workshop.folder / function.decode()
    folder.mkdir(exist_ok=True)
    library = workshop.library.replace(function, b"X" + function[1:])
    return replace(workshop, folder=folder, library=library, _made={})


def test_a_missing_function_matters_where_it_is_called(each, both):
    """Those for states are needed by masters with rollback, and named; differences replace slopes."""
    names = {2: ("GetFMUstate", "GetRealOutputDerivatives"), 3: ("GetFMUState", "GetOutputDerivatives")}
    save, tell = (f"fmi{each.fmi}{name}" for name in names[each.fmi])
    system = circle(lacking(each, save.encode()), "no_save")
    assert both(system, "jacobi").error == ""
    for opener in OPENERS.values():
        message = problem(partial(run, system, master="hermite", open=opener, **HERE))
        assert message.endswith(f": its binary lacks the function {save}")
    notes = both(circle(lacking(each, tell.encode()), "no_tell"), HERMITE).result.card.notes
    assert f"{DIFFERENCES}q.y, p.y" in notes


@pytest.mark.parametrize("varies", ["false", "true"])
@pytest.mark.parametrize(("step", "factor"), [(0.1, 1), (1 / 60, 3)])
def test_equal_steps_are_equal_to_the_last_bit(each, both, step, factor, varies):
    """The FMU refuses any other length; the differences of the communication points are not all the same."""
    times = {"step": step, "stop": 60 * step}
    for master in ("jacobi", "hermite"):
        able = {"canHandleVariableCommunicationStepSize": varies}
        system = circle(each, f"even_{varies}", able=able, even=1)
        outcome = both(system, Coupling(master, factors={"q": factor}), **times)
        assert outcome.error == ""
        assert outcome.result.card.steps == 60
    points = step * np.arange(61)
    assert len(set(np.diff(points))) > 1
    divided = both(circle(each, "uneven", even=1), Coupling("jacobi", adaptive=1e-3), **times)
    assert "the step is longer than the first by" in divided.error


@pytest.mark.parametrize("master", [*MASTERS, Coupling("jacobi", adaptive=1e-3)])
def test_outputs_without_feedthrough_are_read_before_inputs_are_set(fmus, both, master):
    """FMI 2.0, 4.2.4 forbids the other order without a step in between; the values are the same."""
    able = {"maxOutputDerivativeOrder": 0}  # slopes of outputs depend on inputs, which are set before
    strict = fmus.make("quirk", "strict", changes={"u_rate": {"derives": None}}, able=able)
    pair = assemble({"p": strict, "q": strict}, CIRCLE, TURNS)
    wave = Trace(np.array([0.0, 1.0]), {"u": np.array([1.0, 2.0])})
    for system, scenario in ((pair, None), (assemble({"p": strict}), wave)):
        found = [
            both(system.with_start(dict.fromkeys((f"{n}.strict" for n in system.components), value)), master,
                 step=0.1, stop=1.0, scenario=scenario)
            for value in (0, 1)
        ]  # fmt: skip
        assert [outcome.error for outcome in found] == ["", ""]
        np.testing.assert_array_equal(*(outcome.result.trace["p.y"] for outcome in found))


@pytest.mark.parametrize(
    ("depends", "reason"), [(None, "declares no dependencies of y"), (["u"], "declares that y depends on u")]
)
def test_what_an_fmu_lacks_to_be_read_in_that_order_is_told(fmus, both, depends, reason):
    """An output that may depend on an input has to be read after it."""
    fmu = fmus.make("quirk", "lacks", changes={"y": {"depends": depends}, "u_rate": {"derives": None}})
    wave = Trace(np.array([0.0, 1.0]), {"u": np.array([1.0, 2.0])})
    error = both(assemble({"p": fmu}).with_start({"p.strict": 1}), step=0.1, scenario=wave).error
    assert f"(read after inputs were set, because the FMU {reason}: FMI 2.0, 4.2.4)" in error


@pytest.mark.parametrize(("master", "factor"), [("jacobi", 7), ("hermite", 3)])
def test_steps_of_its_own_begin_where_the_last_one_ended(each, both, master, factor):
    """But for the rounding of a sum, as the FMU requires, which takes no step beyond the stop time."""
    outcome = both(circle(each, "strict"), Coupling(master, factors={"q": factor}), stop=6.0)
    assert outcome.error == ""


def test_an_fmu_for_slopes_of_states_only(each, both):
    """It refuses slopes of some outputs: these follow from differences, and a note names them."""
    idle = 'name="idle" valueReference="3" causality="output" variability="continuous"'
    more = {2: f"<ScalarVariable {idle}><Real/></ScalarVariable>", 3: f"<Float64 {idle}/>"}[each.fmi]
    fmu = each.make("quirk", "partly", interpolates=each.fmi == 2, more=more)
    files = {"p": fmu, "q": each.make("quirk", "listener", interpolates=each.fmi == 2)}
    system = assemble(files, CIRCLE, TURNS)
    wired = assemble({**files, "r": files["q"]}, [*CIRCLE, "p.idle -> r.u"])
    assert "none: " not in " ".join(both(system, master=HERMITE).result.card.notes)
    assert f"{DIFFERENCES}p.idle" in both(wired, master=HERMITE).result.card.notes


# ---- what FMUs do


@pytest.mark.parametrize(("where", "how"), thinned(3, [*WHERE], [DISCARD, FAULT, FATAL]))
def test_failures_lose_nothing(each, both, where, how):
    """In whatever call, both loops say the same; what was computed stays; states and instances are freed."""
    outcome = both(circle(each, "failing", when=0.45, how=how, where=WHERE[where]), master=HERMITE)
    if where == "SetSlope" and each.fmi == 3:  # which has no such function
        assert outcome.result.complete
        return
    word = {"DoStep": "the step"}.get(where, f"q: fmi{each.fmi}")
    status = {DISCARD: "discard", FAULT: "error", FATAL: "fatal"}[how]
    assert word in outcome.error
    assert f"with status {status}" in outcome.error
    assert not outcome.result.complete
    assert outcome.result.trace.time[-1] >= 0.4
    # of an FMU with a fatal error nothing is called any more
    mine = [] if how == FATAL else ["freed, states left: 0"] if how == FAULT else [PROPERLY]
    assert outcome.farewells == [PROPERLY, *mine]


# masters that repeat no step, and FMUs that cannot go back or take no shorter step
FINAL = [("nothing", "jacobi"), ("nothing", "gauss-seidel")]
FINAL += [("no rollback", HERMITE), ("equal steps", HERMITE)]


@pytest.mark.parametrize(("quirk", "master"), FINAL)
def test_a_step_done_in_part_ends_the_run_where_it_is_not_repeated(each, both, quirk, master):
    """The message has the time that the FMU reached."""
    options = ABLE[quirk] | {"longest": 0.03, "when": 0.25}
    outcome = both(circle(each, f"slow_{quirk[:2]}", **options), master=master)
    assert outcome.error.endswith("with status discard (the FMU reached t = 0.03 s)")
    assert outcome.result.trace.time.tolist() == [0.0]


# each way to step once: at other orders the same functions step
EACH_WAY = [MASTERS[0], MASTERS[4], HERMITE]
OR_ANY = [m if m in EACH_WAY else pytest.param(m, marks=shards.search) for m in MASTERS]


@pytest.mark.parametrize("master", OR_ANY)
def test_an_fmu_may_end_the_run(each, both, master):
    """Even before the first step: the run is complete up to the point before; a note has FMU and time."""
    outcome = both(circle(each, "enough", when=0.45, how=ENOUGH), master=master)
    assert outcome.error == ""
    assert outcome.result.complete
    assert outcome.result.trace.time[-1] == 0.5
    asked = {2: 0.5, 3: 0.6}[each.fmi]  # with a status that denies the step, or with a step that was done
    end = f"the FMU requests the end of the simulation at t = {asked} s"
    note = f"the run ends early: q: the step at t = 0.5 s is the last one: {end}"
    assert outcome.result.card.notes[-1] == note
    assert outcome.farewells == [PROPERLY] * 2
    at_once = both(circle(each, "unwilling", when=0.0, how=ENOUGH), master=master).result
    assert at_once.complete
    assert at_once.trace.time.tolist() == [0.0]


@pytest.mark.parametrize("reached", [np.inf, -np.inf, 0.7, 0.4, 1e9])
def test_a_last_successful_time_outside_of_the_step_is_none(each, monkeypatch, reached):
    """The step is that from 0.5 s to 0.6 s; the run ends with the row before it, and a note has the time."""
    end = FmuInstance.step_end

    def wrong(fmu, status):
        found = end(fmu, status)
        return replace(found, reached=reached) if found.terminate else found

    monkeypatch.setattr(FmuInstance, "step_end", wrong)
    file = circle(each, "enough").components["q"].source.path
    system = assemble({"q": file}, [], {"q.when": 0.45, "q.how": ENOUGH})
    result = run(system, step=0.1, stop=1.0, isolate=False)
    assert result.trace.time[-1] == 0.5
    got = f"at t = {reached:.9g} s, a time outside of the step from 0.5 s to 0.6 s"
    assert result.card.notes[-1].endswith(got)


def test_an_estimate_of_the_error_covers_what_there_is(each):
    """All runs end where the FMU asks for it; their common points are compared."""
    system = circle(each, "enough", when=0.45, how=ENOUGH)
    card = run(system, master="jacobi", step=0.1, stop=1.0, error_estimate=True).card
    assert [e.name for e in card.errors]
    assert card.simulated == pytest.approx(0.5)  # rounding of five steps


def test_an_early_return_is_an_error_and_a_wish_for_event_handling_a_warning(fmus3, both):
    """The former is not allowed; with the latter the values are those of an FMU without such a request."""
    outcome = both(circle(fmus3, "early", when=0.45, how=EARLY))
    assert outcome.error == "q: the step at t = 0.5 s ended early at t = 0.55 s, which was not allowed"
    wishing = both(circle(fmus3, "eventful", when=0.45, how=EVENT), master=HERMITE).result
    plain = both(circle(fmus3, "plain"), master=HERMITE).result
    message = "the FMU requests event handling by the master, which is switched off (event mode is not used)"
    assert wishing.card.warnings == (f"q: {message} (15 times, first at t = 0.5 s)",)  # in 3 passes
    assert f"warning: {wishing.card.warnings[0]}" in wishing.card.text()
    np.testing.assert_array_equal(wishing.trace["q.y"], plain.trace["q.y"])


@pytest.mark.parametrize("how", [WARNING, TALK])
def test_warnings_pass_in_every_call(each, both, how):
    """The values are those of a silent FMU; each message has its time."""
    talking = both(circle(each, "talking", when=0.05, how=how, where=-1), master=HERMITE).result
    plain = both(circle(each, "plain"), master=HERMITE).result
    np.testing.assert_array_equal(talking.trace["q.y"], plain.trace["q.y"])
    assert {m.status for m in talking.messages} == {"warning" if how == WARNING else "ok"}
    assert {round(10 * m.time) for m in talking.messages} == set(range(11))


@pytest.mark.parametrize("master", OR_ANY)
def test_a_number_that_is_none_ends_the_record(each, both, master):
    """The last point is the last one that is finite."""
    outcome = both(circle(each, "broken", when=0.45, how=NOT_A_NUMBER), master=master)
    when = "0.5000001" if master.guard_tolerance else "0.6"  # the guard has divided the step as far as it may
    assert f".y: expected a finite value, got nan at t = {when} s" in outcome.error
    assert outcome.result.trace.time[-1] == 0.5


def test_the_number_is_told_before_what_follows_from_it(each, both):
    """An FMU that fails because of NaN is not the cause."""
    files = {"q": each.make("quirk", "source_of_nan"), "f": each.make("quirk", "victim")}
    start = {"q.when": 0.25, "q.how": NOT_A_NUMBER, "f.when": 0.65, "f.how": FAULT}
    outcome = both(assemble(files, ["q.y -> f.u"], start))
    assert outcome.error == "q.y: expected a finite value, got nan at t = 0.4 s"


# ---- steps that are repeated

ADAPTIVE = [
    *(Coupling("jacobi", adaptive=1e-2), Coupling("jacobi", 2, adaptive=1e-5)),
    *(Coupling("gauss-seidel", 1, adaptive=1e-4), Coupling("hermite", adaptive=1e-5)),
]


def test_what_a_shorter_step_avoids_is_no_failure(each, both):
    """A step done in part, or not at all, is repeated in steps that the FMU can do, without a warning."""
    slow = both(circle(each, "slow", longest=0.03, when=0.25), master=HERMITE)
    tender = both(circle(each, "tender", longest=0.03, how=FAULT), master=HERMITE)
    for outcome in (slow, tender):
        assert outcome.error == ""
        assert outcome.result.card.warnings == ()
        assert outcome.farewells == [PROPERLY] * 2
    result = slow.result
    assert result.trace.time.tolist() == pytest.approx([0.1 * n for n in range(11)])
    assert result.card.steps >= 10 * 4  # at most 0.03 of 0.1 at once
    assert result.card.repeated > 0
    # with the accuracy of such steps, straight lines in FMI 3.0: h^4 / 720 a radian; else less
    np.testing.assert_allclose(result.trace["q.y"], np.sin(result.trace.time), atol=1e-7)


@pytest.mark.parametrize("longest", [0.0, 5e-3])
def test_messages_are_those_of_the_steps_that_stand(each, both, longest):
    """One for each, at its begin, where steps are rejected and where another FMU does only a part of them."""
    system = circle(each, "chatty", when=-1.0, how=TALK).with_start({"p.longest": longest})
    result = both(system, master=Coupling("jacobi", 1, adaptive=1e-4), step=0.5).result
    assert result.card.repeated > 0
    assert [m.time for m in result.messages] == result.trace.time[:-1].tolist()


@pytest.mark.parametrize(("quirk", "master"), thinned(2, [*ABLE][:-1], ADAPTIVE))
def test_adaptive_steps_do_without(each, both, quirk, master):
    """Errors stay below the tolerance, called by C and by Python, with any missing ability."""
    outcome = both(circle(each, quirk.replace(" ", "_"), **ABLE[quirk]), master=master, stop=2.0)
    assert outcome.error == ""
    trace = outcome.result.trace
    assert trace.time[-1] == 2.0
    # inputs that are off by the tolerance all the time make twice that of an integral over 2 s
    assert np.abs(trace["q.y"] - np.sin(trace.time)).max() < 2 * master.adaptive
    stands = "adaptive steps with too large an error are not repeated: q cannot restore a saved state"
    assert (stands in outcome.result.card.notes) == (quirk == "no rollback")


def test_adaptive_steps_need_fmus_that_vary_theirs(each):
    """By name."""
    system = circle(each, "equal_steps", **ABLE["equal steps"])
    told = "^adaptive steps: expected .* got q: the FMU has a fixed step$"
    problem(lambda: run(system, master=ADAPTIVE[0], **HERE), told)


@pytest.mark.parametrize(
    ("master", "how"), thinned(4, ADAPTIVE, [DISCARD, FAULT, FATAL, NOT_A_NUMBER, ENOUGH])
)
def test_adaptive_runs_end_alike(each, both, master, how):
    """Any failure inside a step has the same messages and values, called by C and by Python."""
    outcome = both(circle(each, "ending", when=0.45, how=how), master=master, stop=2.0)
    assert bool(outcome.error) == (how != ENOUGH)
    assert 0.3 < outcome.result.trace.time[-1] < 0.6


def test_an_input_that_is_only_watched_is_left_alone(each, both):
    """An input that an FMU varies by its rate input does so in all substeps."""
    files, wires = {"sum": each["drift"], "mass": each["mass_b"]}, ["mass.x -> sum.u", "mass.v -> sum.u_rate"]
    system = assemble(files, wires, {"mass.spring": 1.0})
    masters = (Coupling("jacobi", adaptive=1e-2, factors={"sum": factor}) for factor in (1, 2))
    whole, twice = (both(system, master).result.trace for master in masters)
    # the same line in one piece or in two; rounding of inner steps
    np.testing.assert_allclose(twice["sum.y"], whole["sum.y"], rtol=1e-12)
