"""Jumps and signals that are not continuous act at their time, or at the communication point that follows.

Two integrators, y1' = u and y2' = y1, and FMUs for Model Exchange, against closed forms.
"""

import re
import zipfile

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from kit.any_fmu.models import Workshop, ticking_fmu

from orchestrator import Coupling, Master, System, Trace, assemble, reference, run

STEP, STOP = 0.25, 2.0
FIXED = {"able": {"canHandleVariableCommunicationStepSize": "false"}}
HEATED = ["room.T -> thermo.y", "thermo.on -> room.on"]


def in_turn(components, time, length):
    """A master of one's own."""
    for name in components:
        components[name].step(time, length)
        components.send(name)


MASTERS = {
    "jacobi": Coupling("jacobi"),
    "gauss-seidel": Coupling("gauss-seidel"),
    "gauss-seidel of order 2": Coupling("gauss-seidel", order=2),
    "hermite": Coupling("hermite"),
    "hermite with a guard": Coupling("hermite", guard=1e-3),
    "interface-jacobian": Coupling("interface-jacobian"),
    "adaptive": Coupling("gauss-seidel", adaptive=1e-3),
    "own": Master("own", step=in_turn),
}
every_master = pytest.mark.parametrize("master", MASTERS.values(), ids=[*MASTERS])
# inside of steps, and at communication points
times = st.one_of(st.floats(0.01, STOP - 0.01), st.integers(1, 7).map(lambda n: n * STEP))
jumps = st.dictionaries(times, st.floats(-3, 3).map(lambda x: round(x, 3)), min_size=1, max_size=4).filter(
    lambda jumps: all(b - a > 1e-3 for a, b in zip(sorted(jumps), sorted(jumps)[1:], strict=False))
)


def two_rows(name: str, jumps: dict[float, float]) -> Trace:
    """A scenario whose values are held, with two rows at each jump, as a file has them."""
    at, values = sorted(jumps), [0.0, *(jumps[t] for t in sorted(jumps))]
    time = np.array([0.0, *np.repeat(at, 2), STOP])
    return Trace(time - 1e-6 * (np.diff(time, append=np.inf) == 0), {name: np.repeat(values, 2)})


def integral(t, jumps, power=1):
    """The value, or its first or second integral, at times t."""
    changes = np.diff([0.0, *(jumps[s] for s in sorted(jumps))])
    since = np.maximum(np.subtract.outer(t, sorted(jumps)), 0.0)
    return (since**power / (1, 1, 2)[power]) @ changes


@pytest.fixture(scope="module", params=[2, 3])
def each(request, tmp_path_factory) -> Workshop:
    """Small FMUs for Co-Simulation of one version of FMI after the other."""
    return Workshop(tmp_path_factory.mktemp("each"), request.param)


@pytest.fixture(scope="module")
def pair(tmp_path_factory) -> System:
    """Two integrators of FMI 3.0: without a function for derivatives of inputs they follow a rate."""
    drift = Workshop(tmp_path_factory.mktemp("pair"), 3)["drift"]
    return assemble({"first": drift, "second": drift}, ["first.y -> second.u"])


@every_master
@given(jumps=jumps)
def test_an_input_jumps_at_its_time(pair, master, jumps):
    """The first integral to rounding at every row; the second, where its input follows a line, too."""
    step = {} if getattr(master, "adaptive", None) else {"step": STEP}
    result = run(pair, two_rows("first.u", jumps), master=master, record_step=STEP, isolate=False, **step)
    t = result.trace.time
    # rounding of sums; the integrators take steps of 0.25 ms
    np.testing.assert_allclose(result["first.y"], integral(t, jumps), atol=1e-9)
    before = [s for s in jumps if round(s / STEP) * STEP == s]
    at_points = np.isin(t, before)
    np.testing.assert_allclose(result["first.u"][at_points], [jumps[s] for s in t[at_points]], rtol=1e-15)
    if master in (MASTERS["jacobi"], MASTERS["own"]):
        points = np.unique([*np.arange(0, STOP + STEP / 2, STEP), *jumps])
        held = integral(points, jumps)[:-1] if master is MASTERS["jacobi"] else integral(points, jumps)[1:]
        exact = np.append(0.0, np.cumsum(np.diff(points) * held))[np.isin(points, t)]
    else:
        exact = integral(t, jumps, 2)
    np.testing.assert_allclose(result["second.y"], exact, atol=1e-9)


@given(jumps=jumps)
def test_a_master_that_exchanges_at_the_beginning_of_a_step_sees_the_jump_there(each, jumps):
    """The values after it, as the engine has them; so do halves with an exchange in the middle."""

    def exchanging(components, time, length):
        for begin in (time, time + length / 2):
            components.exchange(begin)
            components["drift"].step(begin, length / 2)

    master = Master("exchanging", step=exchanging)
    result = run(each["drift"], two_rows("u", jumps), master=master, step=STEP)
    # rounding of sums
    np.testing.assert_allclose(result["drift.y"], integral(result.trace.time, jumps), atol=1e-9)


@pytest.mark.parametrize("after", [5e-5, 2e-3, 0.3])
def test_a_jump_next_to_a_point_stays_where_it_is(each, after):
    """Just behind the start and before the stop of a long adaptive run, where a sample is nearer to them."""
    stop = 1000.0
    jumps = {after: 2.0, stop - after: -1.0}
    time = np.array([0.0, *np.repeat([*jumps], 2), stop]) - [0, 1e-6, 0, 1e-6, 0, 0]
    scenario = Trace(time, {"u": np.array([0, 0, 2, 2, -1, -1.0])})
    result = run(each["drift"], scenario, master=MASTERS["adaptive"], largest=100.0, isolate=False)
    # rounding: the FMU adds up 4e6 steps; a shift by 5e-5 s would be 1e-4
    assert result["drift.y"][-1] == pytest.approx(2 * (stop - 2 * after) - after, abs=1e-6)


def test_a_column_drives_inputs_that_follow_it_and_inputs_that_hold_it(each):
    """What is not continuous takes no line from what is."""
    held = {"u": {"steady": "discrete", "unit": "m"}, "u_rate": {"derives": None}}
    fmus = {"follows": each["drift"], "holds": each.make("quirk", "holds_m", changes=held)}
    ramp = Trace(np.array([0.0, 1.0, 2.0]), {"u": np.array([0.0, 1.0, 3.0])})
    result = run(assemble(fmus, []), ramp, step=STEP, isolate=False)
    assert result["follows.y"][-1] == pytest.approx(0.5 + 2.0, abs=1e-9)
    assert result["holds.y"][-1] == pytest.approx(1.0, abs=1e-9)


@given(jumps=jumps)
def test_the_reference_jumps_at_the_same_time(fmu, jumps):
    """x' = u - x of an FMU for Model Exchange: the sum of the answers to all steps."""
    for solve, more in ((reference, {}), (run, {"step": STEP, "isolate": False})):
        result = solve(fmu("lag", 2), two_rows("u", jumps), record_step=STEP, **more)
        since = np.maximum(np.subtract.outer(result.trace.time, sorted(jumps)), 0.0)
        changes = np.diff([0.0, *(jumps[s] for s in sorted(jumps))])
        # the tolerance of the solvers
        np.testing.assert_allclose(result["lag2.x"], (1 - np.exp(-since)) @ changes, atol=1e-7)


def test_a_run_that_begins_at_a_jump_has_the_value_after_it(fmu):
    """In its first row, too."""
    for solve, more in ((reference, {}), (run, {"step": STEP, "isolate": False})):
        result = solve(fmu("lag", 2), two_rows("u", {0.5: 2.0}), start=0.5, record_step=STEP, **more)
        assert result["lag2.u"].tolist() == [2.0] * len(result.trace.time)


@every_master
def test_fmus_with_a_fixed_step_get_a_jump_at_the_next_point(each, master):
    """And the card says so."""
    if getattr(master, "adaptive", None):
        return
    fmu = each.make("drift", "even", **FIXED)
    system = assemble({"first": fmu, "second": fmu}, ["first.y -> second.u"])
    result = run(system, two_rows("first.u", {0.6: 1.0, 1.0: 3.0}), master=master, step=STEP, isolate=False)
    np.testing.assert_allclose(result["first.y"][[2, 3, 4, 5]], [0, 0, 0.25, 1.0], atol=1e-12)
    late = "first, second: the FMU has a fixed step: jumps inside of a step act at its end"
    assert late in result.card.notes
    # a ramp, which the other column has also in the microsecond of the jump, stays one
    jump = two_rows("first.u", {0.6: 1.0, 1.7: 0.0})
    both = Trace(jump.time, {**jump.signals, "second.u": jump.time})
    alone = assemble({"first": fmu, "second": fmu}, [])
    for stop, noted in ((STOP, True), (0.5, False)):
        found = run(alone, both, master=master, step=STEP, stop=stop, isolate=False)
        if master is not MASTERS["own"]:  # which holds its inputs
            # a foot of the jump is 1e-6 s long
            np.testing.assert_allclose(found["second.y"], found.trace.time**2 / 2, atol=1e-6)
        assert (late in found.card.notes) == noted


def test_an_adaptive_step_that_cannot_be_repeated_is_short_after_a_jump(each):
    """As the first one of the run: a thousandth of the step that is asked for."""
    never = {"able": dict.fromkeys(("canGetAndSetFMUstate", "canGetAndSetFMUState"), "false")}
    fmu = each.make("drift", "onward", **never)
    system = assemble({"first": fmu, "second": fmu}, ["first.y -> second.u"])
    adaptive = Coupling("gauss-seidel", adaptive=1e-3)
    t = run(system, two_rows("first.u", {0.6: 1.0}), master=adaptive, step=0.1, isolate=False).trace.time
    first, before, after = (np.diff(t)[k] for k in (0, np.searchsorted(t, 0.6) - 1, np.searchsorted(t, 0.6)))
    assert first == pytest.approx(1e-4, rel=1e-9)
    assert after == pytest.approx(first, rel=1e-6)  # a difference of rounded times
    assert before > 10 * after


# ---- signals that are not continuous


@every_master
@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("at", [0.3, 0.5, 1.0, 1.77])
def test_a_boolean_takes_a_value_at_its_time(fmu, version, at, master):
    """T' = 1 - T from a time on, of a scenario and of a fault."""
    name = f"room{version}"
    step = {} if getattr(master, "adaptive", None) else {"step": STEP}
    column = two_rows(f"{name}.on", {at: 1.0})
    sampled = Trace(np.array([0.0, at, STOP]), {f"{name}.on": np.array([0.0, 1.0, 1.0])})
    fault = {"fault": {f"{name}.on": f"true@{at}"}, "stop": STOP}
    for drives in ({"scenario": column}, {"scenario": sampled}, fault):
        result = run(fmu("room", version), **drives, **step, record_step=STEP, master=master, isolate=False)
        exact = 1 - np.exp(-np.maximum(result.trace.time - at, 0.0))
        np.testing.assert_allclose(result[f"{name}.T"], exact, atol=1e-7)  # the tolerance of the solver


@every_master
@pytest.mark.parametrize("step", [0.25, 0.4])
def test_an_announced_event_acts_at_its_time_without_saved_states(fmu, each, step, master):
    """A level that changes at each second, in Model Exchange, drives an integrator that holds its input."""
    if getattr(master, "adaptive", None):
        return
    held = {"u": {"steady": "discrete"}, "u_rate": {"derives": None}}
    fmus = {"s": fmu("counter", 2), "d": each.make("quirk", "holds", changes=held)}
    result = run(assemble(fmus, ["s.level -> d.u"]), stop=4.0, step=step, master=master, isolate=False)
    t = result.trace.time
    exact = np.maximum(np.subtract.outer(t, np.arange(1, 5)), 0.0).sum(axis=1)
    np.testing.assert_allclose(result["d.y"], exact, atol=1e-9)  # of the solver in Model Exchange
    effects = "effects of events not announced by s on other FMUs may come up to a step late"
    why = ", because s cannot restore a saved state" * (master is not MASTERS["own"])
    assert effects + why in result.card.notes


ticks = st.tuples(st.integers(1, 30), st.integers(0, 20))  # interval and shift of a clock [s / 21]


@pytest.fixture(scope="module")
def ticking(tmp_path_factory):
    """An FMU whose clock has an interval and a shift in 21ths of a second, which it tells itself."""
    interval = 'intervalVariability="fixed" supportsFraction="true"'
    return ticking_fmu(tmp_path_factory.mktemp("ticking") / "unit.fmu", interval)


levels = st.tuples(st.floats(0.1, 0.4), st.floats(0.02, 0.5)).map(lambda pair: (pair[0], pair[0] + pair[1]))


@every_master
@settings(max_examples=10)
@given(jumps=jumps, levels=levels, step=st.sampled_from([0.05, 0.1, 0.25]), ticks=ticks)
def test_jumps_and_events_act_at_their_times(stopping, ticking, master, jumps, levels, step, ticks):
    """A relay switches a room, a scenario drives an integrator in event mode, and a clock another one."""
    fmus = {"relay": stopping("relay"), "room": stopping("room"), "sum": stopping("sum")}
    low, high = levels
    wires, given = ["room.T -> relay.y", "relay.on -> room.on"], {"relay.low": low, "relay.high": high}
    if master is not MASTERS["own"]:
        fmus |= {"unit": ticking, "total": stopping("sum")}
        wires += ["unit.y -> total.u"]
        given |= {"unit.u": 1.0, "unit.period": ticks[0] / 21, "unit.delay": ticks[1] / 21}
    system = assemble(fmus, wires, given)
    length = {} if getattr(master, "adaptive", None) else {"step": step}
    scenario = two_rows("sum.u", jumps)
    result = run(system, scenario, record_step=step, master=master, isolate=False, **length)
    t = result.trace.time
    np.testing.assert_allclose(result["sum.s"], integral(t, jumps), atol=1e-9)  # rounding of sums
    if master is MASTERS["own"]:  # without event mode
        return
    times = np.arange(ticks[1], 21 * (STOP + 1), ticks[0]) / 21  # y = 1, 2, 3 ... from a tick on
    total = np.maximum(np.subtract.outer(t, times), 0.0).sum(1)
    np.testing.assert_allclose(result["total.s"], total, atol=1e-9)  # a tick is at most 1e-11 s late
    begins, starts = [0.0, -np.log(1 - high)], [0.0, high]
    while begins[-1] < STOP:
        rises = len(begins) % 2 == 0
        begins.append(begins[-1] + np.log(high / low if rises else (1 - low) / (1 - high)))
        starts.append(low if rises else high)
    k = np.searchsorted(begins, t, side="right") - 1
    on = k % 2 == 0
    exact = on + (np.array(starts)[k] - on) * np.exp(-(t - np.array(begins)[k]))
    # up to 50 events, each up to 1e-11 s late
    np.testing.assert_allclose(result["room.T"], exact, atol=1e-9)


def test_an_array_of_event_indicators(fmu, tmp_path):
    """One variable with two of them in FMI 3.0: the thermostat gives the same number to both."""
    plain, double = fmu("thermo", 3), tmp_path / "thermo.fmu"
    scalar = re.compile(rb'(<Float64 name="z"[^>]*>)')

    def run_of(thermostat):
        system = assemble({"room": fmu("room", 3), "thermo": thermostat}, HEATED)
        return run(system, stop=2.0, step=0.01, isolate=False)["room.T"]

    with zipfile.ZipFile(plain) as source, zipfile.ZipFile(double, "w") as target:
        for name in source.namelist():
            text, count = scalar.subn(rb'\1<Dimension start="2"/>', source.read(name))
            assert count == (name == "modelDescription.xml")
            target.writestr(name, text)
    np.testing.assert_array_equal(run_of(double), run_of(plain))


@pytest.mark.parametrize("kind", ["events", "wire"])
def test_no_error_is_estimated_where_effects_may_be_late(fmu, kind):
    """Two runs may have them late by the same time: the card has the reason in place of a number."""
    fmus = {"room": fmu("room", 2), "thermo": fmu("thermo", 2)}
    system = assemble(fmus, HEATED)
    if kind == "events":
        system = assemble({"ball": fmu("ball", 2), "lag": fmu("lag", 2)}, ["ball.h -> lag.u"])
    late = f"events not announced by {'ball' if kind == 'events' else 'room, thermo'}"
    card = run(system, stop=2.0, step=0.01, error_estimate=True, isolate=False).card
    assert card.errors == ()
    told = f"no error estimate: effects of {late} may come up to a step late, also in a run at half the step"
    assert told in card.notes
