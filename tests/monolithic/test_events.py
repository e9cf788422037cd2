"""Events act at their time: all FMUs stop there, go through one instant, begin anew. By closed forms."""

import csv
import re
import zipfile
from dataclasses import replace
from math import log, sqrt
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from kit.any_fmu.description import Description
from kit.any_fmu.models import Workshop
from kit.mistakes import problem
from kit.properties import examples

from orchestrator import Coupling, Master, Problem, RunFailed, assemble, reference, run

from .conftest import MODELS, TIME

MASTERS = {
    "jacobi": Coupling("jacobi"),
    "jacobi of order 3": Coupling("jacobi", order=3),
    "gauss-seidel": Coupling("gauss-seidel"),
    "gauss-seidel of order 2": Coupling("gauss-seidel", order=2),
    "hermite": Coupling("hermite"),
    "interface-jacobian": Coupling("interface-jacobian"),
    "adaptive": Coupling("gauss-seidel", adaptive=1e-3),
    "adaptive hermite": Coupling("hermite", adaptive=1e-5),
}
every_master = pytest.mark.parametrize("master", MASTERS.values(), ids=[*MASTERS])
HEATED = ["room.T -> relay.y", "relay.on -> room.on"]
STEP, STOP = 0.01, 3.0
ANNOUNCES, TELLS, ASKS, RESTLESS = 0, 1, 18, 19  # `how` of stopping.c


def length(master, step=STEP):
    """The options for equal steps, or for rows at equal times."""
    return {"record_step": step} if master.adaptive else {"step": step}


def switches(stop):
    """Times at which T' = on - T from 0 reaches 0.6, 0.4, 0.6 ..."""
    times = [log(1 / 0.4)]
    while times[-1] + log(1.5) < stop:
        times.append(times[-1] + log(1.5))
    return np.array(times)


def temperature(time):
    """T between these times."""
    begins = np.append(0.0, switches(time[-1] + 1.0))
    k = np.searchsorted(begins, time, side="right") - 1
    first = np.where(k == 0, 0.0, np.where(k % 2 == 0, 0.4, 0.6))
    on = k % 2 == 0
    return on + (first - on) * np.exp(-(time - begins[k]))


@pytest.fixture(scope="module")
def each(tmp_path_factory):
    """Small FMUs for Co-Simulation."""
    return Workshop(tmp_path_factory.mktemp("each"), 3)


def held(events, name):
    """The times at which a signal changes."""
    return np.array([event.time for event in events if name in event.causes])


# ---- the time of an event


@pytest.fixture(
    params=[
        "early",
        "held",
        "at the end",
        "held, at the end",
        "back to the beginning",
        "heater",
        "exchange",
        "both",
    ]
)
def heated(request, stopping, fmu):
    """A relay and a room, the signal that switches, and the largest number of further steps for an event.

    The relay knows the slope of its input, or holds it over a step; it stops early, or asks for event mode at
    the end of the step. A heater stops by itself. Two FMUs for Model Exchange, or one of each kind.
    """
    kind = request.param
    if kind == "heater":
        fmus = {"room": stopping("heater"), "copy": stopping("copy")}
        return assemble(fmus, ["room.cold -> copy.in", "copy.out -> room.on"]), "room.cold", 1
    if kind in ("exchange", "both"):
        relay = stopping("relay") if kind == "both" else fmu("thermo", 2, rolls=True)
        fmus = {"relay": relay, "room": fmu("room", 3, rolls=True)}
        return assemble(fmus, HEATED), "relay.on", 1
    how = {"at the end": 1, "held, at the end": 1, "back to the beginning": 2}.get(kind, 0)
    without = ("y_rate",) if kind != "early" and kind != "at the end" else ()
    fmus = {"relay": stopping("relay", without), "room": stopping("room")}
    most = 1 if kind == "early" else 3  # a bisection ends with a short step before it, and one to the event
    return assemble(fmus, HEATED, {"relay.how": how}), "relay.on", most


@every_master
def test_a_relay_switches_a_room_at_its_time(heated, master):
    """Times to 1e-9 s, temperature between them to 1e-6, at steps of 10 ms; few further steps."""
    system, signal, most = heated
    result = run(system, stop=STOP, **length(master), master=master, isolate=False)
    exact = switches(STOP)
    times = held(result.events, signal)
    times = times[times > 0.5]  # the room of Model Exchange is not heated before its first event
    assert len(times) == len(exact)
    # an event is up to 1e-11 s late; the solver of Model Exchange has a tolerance of 1e-8
    np.testing.assert_allclose(
        times, exact, atol=1e-7 if "thermo" in str(system.components["room"]) else 1e-9
    )
    np.testing.assert_allclose(result["room.T"], temperature(result.trace.time), atol=1e-6)
    assert len(result.trace.time) == STOP / STEP + 1
    if not master.adaptive:
        assert result.card.steps <= STOP / STEP + most * len(exact)
    assert not [note for note in result.card.notes if "late," in note or "step late" in note]


@every_master
@pytest.mark.parametrize("version", [2, 3])
def test_the_event_of_the_start_acts(fmu, master, version):
    """A relay that is on at first switches a warm room off: T' = on - T from 1 mirrors that from 0."""
    fmus = {"relay": fmu("thermo", version, rolls=True), "room": fmu("room", version, rolls=True)}
    system = assemble(fmus, HEATED, {"relay.on": True, "room.T": 1.0})
    result = run(system, stop=STOP, **length(master), master=master, isolate=False)
    np.testing.assert_array_equal(result["room.on"][:5], 0)
    # the solver of Model Exchange has a tolerance of 1e-8
    np.testing.assert_allclose(held(result.events, "relay.on"), switches(STOP), atol=1e-7)
    np.testing.assert_allclose(result["room.T"], 1.0 - temperature(result.time), atol=1e-6)


@pytest.mark.parametrize("master", [m for m in MASTERS.values() if not m.adaptive], ids=str)
@pytest.mark.parametrize("isolate", [True, False])
def test_a_relay_switches_a_room_that_declares_no_dependencies(stopping, master, isolate):
    """Without event mode: the room is in an undeclared loop, of which only the relay has a Real input."""
    able = {"hasEventMode": "false", "mightReturnEarlyFromDoStep": "false"}
    fmus = {
        "relay": stopping("relay", ["y_rate"], undeclared=True, **able),
        "room": stopping("room", undeclared=True, **able),
    }
    result = run(assemble(fmus, HEATED), stop=STOP, step=STEP, master=master, isolate=isolate)
    t, on = result["room.T"], result["room.on"]
    np.testing.assert_array_equal(result["relay.y"], t)
    # the room moves exactly while its input is held
    np.testing.assert_allclose(t[1:], on[:-1] + (t[:-1] - on[:-1]) * np.exp(-STEP), atol=1e-13)
    found = result.time[1:][np.diff(on) != 0]
    late = found - switches(STOP)[: len(found)]
    # each switch is up to two steps late, and the following ones by as much as those before
    assert len(found) >= 4
    assert (late >= 0.0).all()
    assert (np.diff(late, prepend=0.0) <= 4 * STEP).all()


def test_a_ball_bounces_alone(stopping):
    """One FMU needs no rollback: each bounce is where it stops, and the next step begins there."""
    fmu = stopping("ball", canGetAndSetFMUState="false")
    result = run(fmu, stop=2.0, step=0.1, isolate=False)
    fall, e = sqrt(2 / 9.81), 0.7
    bounces = fall + 2 * fall * np.cumsum(np.append(0.0, e ** np.arange(1, 30)))
    bounces = bounces[bounces < 2.0]
    np.testing.assert_allclose([event.time for event in result.events], bounces, rtol=1e-12)  # rounding
    k = np.searchsorted(bounces, result.time, side="right") - 1
    since = result.time - np.where(k < 0, 0.0, bounces[k])
    speed = np.where(k < 0, 0.0, 9.81 * fall * e ** (k + 1.0))
    first = np.where(k < 0, 1.0, 0.0)
    exact = first + speed * since - 9.81 / 2 * since**2
    np.testing.assert_allclose(result["ball.h"], exact, atol=1e-12)
    assert result.card.steps == 20 + len(bounces)
    assert ", 4 events" in result.card.text()


@pytest.mark.parametrize("saves", ["true", "false"])
def test_the_only_fmu_goes_on_from_its_event_inside_of_its_own_steps(stopping, saves):
    """Three steps of the ball in a step: the others begin anew at the bounce."""
    fmu = stopping("ball", canGetAndSetFMUState=saves)
    results = [run(fmu, stop=2.0, step=0.1, factors={"ball": k}, isolate=False) for k in (1, 3)]
    times = [[event.time for event in result.events] for result in results]
    # rounding; at the fourth bounce it is 1e-15 * 9.8 m/s2 * 10 ms
    np.testing.assert_allclose(*times, rtol=1e-12)
    np.testing.assert_allclose(*(result["ball.h"] for result in results), atol=1e-12)


@pytest.mark.parametrize("how", [ASKS, RESTLESS])
def test_events_at_the_ends_of_own_steps_need_no_further_step(stopping, how):
    """An FMU that cannot go back asks for them at the end of each quarter; its count is that of the ticks."""
    fmus = {"t": stopping("ticker", canGetAndSetFMUState="false"), "s": stopping("sum")}
    system = assemble(fmus, ["t.level -> s.u"], {"t.how": how, "t.period": 0.13})
    result = run(system, stop=1.2, step=0.1, factors={"t": 4}, isolate=False)
    np.testing.assert_array_equal(result["t.count"], np.floor(result.time / 0.13))
    ends = np.ceil(np.arange(0.13, 1.2, 0.13) / 0.1) * 0.1  # where its ticks act
    # rounding
    np.testing.assert_allclose(
        result["s.s"], np.maximum(np.subtract.outer(result.time, ends), 0.0).sum(1), atol=1e-12
    )


def test_events_of_the_run_are_those_of_the_reference(fmu):
    """A ball in Model Exchange beside an FMU that its height drives: the same events, with their times."""
    fmus = {"ball": fmu("ball", 2, rolls=True), "lag": fmu("lag", 3, rolls=True)}
    system = assemble(fmus, ["ball.h -> lag.u"])
    truth = reference(system, stop=1.6, record_step=0.1)
    result = run(system, stop=1.6, step=0.02, record_step=0.1, master="hermite", isolate=False)
    assert len(truth.events) == 3
    times = [[event.time for event in found.events] for found in (result, truth)]
    np.testing.assert_allclose(*times, atol=1e-9)
    # hermite at 20 ms with slopes by differences, which begin anew at each event: 4e-6 measured
    np.testing.assert_allclose(result["lag.x"], truth["lag.x"], atol=1e-5)


periods = st.floats(0.05, 0.9).map(lambda x: round(x, 3))


@every_master
@given(periods=st.tuples(periods, periods), step=st.sampled_from([0.1, 0.25]))
def test_announced_events_act_at_their_time(stopping, master, periods, step):
    """s1' = level of a ticker, s2' = level of another, at any step: a sum over the ticks until then."""
    fmus = {
        "a": stopping("ticker"),
        "b": stopping("ticker"),
        "first": stopping("sum"),
        "second": stopping("sum"),
    }
    wires = ["a.level -> first.u", "b.level -> second.u"]
    system = assemble(fmus, wires, {"a.period": periods[0], "b.period": periods[1]})
    result = run(system, stop=2.0, **length(master, step), master=master, isolate=False)
    for name, period in zip(("first.s", "second.s"), periods, strict=True):
        ticks = period * np.arange(1, int(2.0 / period) + 2)
        exact = np.maximum(np.subtract.outer(result.time, ticks), 0.0).sum(axis=1)
        np.testing.assert_allclose(result[name], exact, atol=1e-9)  # a tick is up to 1e-9 s early: the FMU
    ticked = [k * period for period in periods for k in range(1, 1 + int((2.0 + 1e-9) / period))]
    for tick in ticked:
        assert min(abs(event.time - tick) for event in result.events) < 1e-9


def test_events_at_one_time_are_one_instant(stopping):
    """Two FMUs tick at 0.5 s; a third takes both; in the file next to the trace."""
    fmus = {"a": stopping("ticker"), "b": stopping("ticker"), "s": stopping("sum")}
    system = assemble(fmus, ["a.level -> s.u"], {"a.period": 0.5, "b.period": 0.25})
    events = run(system, stop=0.6, step=0.2).events
    assert [event.time for event in events] == [0.25, 0.5]
    assert [set(event.causes) for event in events] == [{"b"}, {"a", "b", "a.level"}]


@pytest.mark.parametrize("isolate", [True, False])
def test_the_events_are_in_a_file(stopping, tmp_path, isolate):
    """One line each; a later run without events takes it away, but no other file of that name."""
    system = assemble({"relay": stopping("relay"), "room": stopping("room")}, HEATED)
    result = run(system, stop=1.5, step=0.1, isolate=isolate)
    file = result.write(tmp_path / "trace.csv").with_suffix(".events.csv")
    with file.open() as lines:
        rows = list(csv.DictReader(lines))
    assert [float(row["time"]) for row in rows] == [event.time for event in result.events]
    assert [row["causes"] for row in rows] == ["relay relay.on"] * 2
    assert len(result.time) == 16, "those of the steps"
    quiet = run(system, stop=0.5, step=0.1, isolate=isolate)
    quiet.write(tmp_path / "trace.csv")
    assert not file.exists()
    file.write_text("time,force\n0,1\n")
    quiet.write(tmp_path / "trace.csv")
    assert file.exists()


@pytest.mark.parametrize("isolate", [True, False])
def test_events_after_the_end_are_not_told(stopping, isolate):
    """A run that ends at a condition has the events until then, although its last steps went on."""
    system = assemble({"relay": stopping("relay"), "room": stopping("room")}, HEATED)
    early = run(system, stop=STOP, step=0.1, isolate=isolate, until="room.T > 0.5")
    assert early.time[-1] < switches(STOP)[0]
    assert not early.events
    assert " event" not in early.card.text()
    ended = run(system, stop=STOP, step=0.1, isolate=isolate, until=lambda t, _: t > 1.0)
    assert [event.time for event in ended.events] == pytest.approx(switches(STOP)[:1])


@pytest.mark.parametrize(
    ("master", "limit"),
    [
        (Coupling("jacobi", order=2), 1.5e-4),
        (Coupling("jacobi", order=3), 1.5e-4),
        (Coupling("hermite"), 1e-6),
    ],
)
def test_histories_begin_anew(stopping, each, master, limit):
    """An integrator of the temperature, whose slope jumps at each event.

    A first step without slope is off by up to h^2 / 4 = 2.5e-5, at 7 beginnings. With a history over the
    events the errors are 2.7e-4, 1.1e-3 and 1.6e-5.
    """
    fmus = {"relay": stopping("relay"), "room": stopping("room"), "drift": each["drift"]}
    result = run(
        assemble(fmus, [*HEATED, "room.T -> drift.u"]), stop=STOP, step=STEP, master=master, isolate=False
    )
    t = np.linspace(0.0, STOP, 300001)
    means = 0.5 * (temperature(t)[1:] + temperature(t)[:-1])
    exact = np.interp(result.time, t, np.append(0.0, np.cumsum(np.diff(t) * means)))
    assert np.abs(result["drift.y"] - exact).max() < limit


# ---- where not all can go back


def test_without_rollback_events_act_at_the_end_of_the_step(stopping):
    """Then the FMU goes through them alone, at their times, and the card names the component."""
    room = stopping("room", canGetAndSetFMUState="false")
    system = assemble({"relay": stopping("relay"), "room": room}, HEATED)
    result = run(system, stop=STOP, step=STEP, isolate=False, error_estimate=True)
    late = "effects of events not announced by room, relay on other FMUs may come up to a step late"
    assert any(
        n.startswith(late) and n.endswith("because room cannot restore a saved state")
        for n in result.card.notes
    )
    told = "no error estimate: effects of events not announced by room"
    assert any(note.startswith(told) for note in result.card.notes)
    ends = np.array([event.time for event in result.events]) / STEP
    np.testing.assert_allclose(ends, ends.round(), atol=1e-9)  # rounding of times
    # two steps late at each event, which moves the next ones
    assert np.abs(result["room.T"] - temperature(result.time)).max() < 6 * 2 * STEP
    even = stopping("room", canHandleVariableCommunicationStepSize="false")
    notes = run(assemble({"relay": stopping("relay"), "room": even}, HEATED), stop=0.1, step=STEP).card.notes
    assert any(note.endswith("because room has a fixed step") for note in notes)


@pytest.mark.parametrize("own", [False, True])
def test_an_fmu_that_goes_back_to_the_beginning_gets_shorter_steps(stopping, own):
    """Where others cannot repeat a step: its events are found by steps of it alone."""
    room = stopping("room", canGetAndSetFMUState="false")
    system = assemble({"relay": stopping("relay"), "room": room}, HEATED, {"relay.how": 2})
    master = Master("own", step=in_turn) if own else "gauss-seidel"
    result = run(system, stop=STOP, step=STEP, master=master, isolate=False)
    # two steps late at each event, which moves the next ones
    assert np.abs(result["room.T"] - temperature(result.time)).max() < 6 * 2 * STEP
    assert len(held(result.events, "relay.on")) >= 5


def in_turn(components, time, length):
    """A master of one's own."""
    for name in components:
        components[name].step(time, length)


def test_a_master_of_ones_own_has_events_at_the_end_of_its_steps(stopping):
    """Announced ones are ends of steps, those inside of a step wait; all FMUs are in one instant."""
    own = Master("own", step=in_turn)
    system = assemble({"relay": stopping("relay"), "room": stopping("room")}, HEATED)
    result = run(system, stop=STOP, step=STEP, master=own)
    assert np.abs(result["room.T"] - temperature(result.time)).max() < 6 * 2 * STEP
    found = held(result.events, "relay.on")
    np.testing.assert_allclose(found, switches(STOP)[: len(found)], atol=6 * 2 * STEP)
    assert len(found) >= 5  # the sixth may be late
    ticking = assemble(
        {"a": stopping("ticker"), "s": stopping("sum")}, ["a.level -> s.u"], {"a.period": 0.25}
    )
    exact = run(ticking, stop=1.0, step=0.1, master=own)
    np.testing.assert_allclose([e.time for e in exact.events], [0.25, 0.5, 0.75, 1.0], atol=1e-9)
    assert exact["s.s"][-1] == pytest.approx(0.25 + 0.5 + 0.75, abs=1e-9)
    told = problem(lambda: run(system, stop=2.0, step=0.13, set={"relay.how": 8}, master=own))
    assert re.fullmatch(r"relay: the step at t = \S+ s ended early at t = nan s, expected its time", told)


def test_a_signal_that_is_nan_is_no_event(stopping):
    """NaN differs from itself, but has not changed."""
    fmus = {"a": stopping("ticker"), "s": stopping("sum")}
    system = assemble(fmus, [("a.level", "s.u", float("nan"))], {"a.period": 0.5})
    events = run(system, stop=1.1, step=0.1, record=["a.count"]).events
    np.testing.assert_allclose([event.time for event in events], [0.5, 1.0], atol=1e-9)


tickers = st.tuples(
    st.integers(6, 30).map(lambda k: k / 21.0),
    st.sampled_from([ANNOUNCES, TELLS, ASKS, RESTLESS]),
    st.booleans(),
)


def acts(ticker, step, announced, located, divides):
    """The times at which the changes of a ticker act on others."""
    period, how, _ = ticker
    at = np.arange(1, int(STOP / period + 1e-9) + 1) * period
    if (divides and how in (ANNOUNCES, TELLS)) or (located and how == ASKS):
        return at
    ends = np.sort(np.append(np.arange(0.0, STOP + step, step), announced))
    return ends[np.searchsorted(ends, at - 1e-9)]


@examples(20)
@given(
    every=st.lists(tickers, min_size=1, max_size=3),
    step=st.sampled_from([0.02, 0.05, 0.1]),
    able=st.tuples(st.booleans(), st.booleans(), st.booleans()),
    name=st.sampled_from([*filter(lambda name: "adaptive" not in name, MASTERS), "own"]),
)
def test_announced_and_asked_events_beside_fixed_steps(stopping, every, step, able, name):
    """Levels that count, in integrators with or without event mode, saved state, variable step.

    Announced events are ends of steps unless an FMU has a fixed step, others if all can go back.
    """
    saves, varies, event_mode = ("true" if can else "false" for can in able)
    sums = stopping(
        "sum",
        canGetAndSetFMUState=saves,
        canHandleVariableCommunicationStepSize=varies,
        hasEventMode=event_mode,
    )
    fmus, wires, given_, divides = dict[str, Path](), list[str](), dict[str, float](), able[1]
    # without event mode an FMU decides if an event at a point, or at that of another one, is before it
    every = [(period + 1.23e-3 * (k + (not divides)), *others) for k, (period, *others) in enumerate(every)]
    for k, (period, how, can) in enumerate(every):
        fmus |= {f"t{k}": stopping("ticker", canGetAndSetFMUState="true" if can else "false"), f"s{k}": sums}
        wires.append(f"t{k}.level -> s{k}.u")
        given_ |= {f"t{k}.period": period, f"t{k}.how": how}
    located = divides and able[0] and all(can for *_, can in every) and name != "own"
    master = Master("own", step=in_turn) if name == "own" else MASTERS[name]
    result = run(assemble(fmus, wires, given_), stop=STOP, step=step, master=master, isolate=False)
    times = [acts(ticker, step, [], located, divides) for ticker in every]
    exact = [
        t for t, (_, how, _) in zip(times, every, strict=True) if how < ASKS or (located and how == ASKS)
    ]
    for k, ticker in enumerate(every):
        at = acts(ticker, step, np.concatenate(exact) if exact and divides else [], located, divides)
        area = np.maximum(np.subtract.outer(result.time, at), 0.0).sum(1)
        # an event that is asked for may be 1e-5 of a step from its end
        np.testing.assert_allclose(result[f"s{k}.s"], area, atol=3e-5 * step, err_msg=f"{k}: {ticker}")


def test_events_at_the_ends_of_steps_cost_two_steps(stopping):
    """Asked for within 1e-9 s of the end: a step is repeated once, then steps are divided before it."""
    system = assemble(
        {"t": stopping("ticker"), "s": stopping("sum")}, ["t.level -> s.u"], {"t.how": ASKS, "t.period": 1e-3}
    )
    result = run(system, stop=0.1, step=1e-3, isolate=False)
    assert len(result.events) == 100
    assert result.card.repeated <= 2
    assert result.card.steps <= 200
    np.testing.assert_allclose(
        [e.time for e in result.events], 1e-3 * np.arange(1, 101), atol=1e-15
    )  # points


def test_an_fmu_that_asks_after_each_step_has_its_events_there(stopping):
    """The card says that it does; others have theirs at their times."""
    restless = run(
        stopping("ticker"), stop=1.0, step=0.1, set={"ticker.how": RESTLESS, "ticker.period": 0.25}
    )
    assert len(restless.events) == 10
    assert restless["ticker.count"].tolist() == [0, 0, 0, 1, 1, 2, 2, 2, 3, 3, 4]
    assert any(note.startswith("ticker: asks for event mode after each step") for note in restless.card.notes)
    fmus = {"t": stopping("ticker"), "room": stopping("room"), "relay": stopping("relay")}
    result = run(
        assemble(fmus, HEATED, {"t.how": RESTLESS, "relay.how": TELLS}), stop=STOP, step=STEP, isolate=False
    )
    assert np.abs(result["room.T"] - temperature(result.time)).max() < 1e-9
    np.testing.assert_allclose(held(result.events, "relay.on"), switches(STOP), atol=1e-9)


@every_master
def test_an_event_that_is_asked_for_is_not_at_one_that_another_announces(stopping, master):
    """Every 0.17 s, beside announced ones every 0.13 s and the bounces of a ball: these events only."""
    system = assemble(
        {"ball": stopping("ball"), **{name: stopping("ticker") for name in "ab"}, "s": stopping("sum")},
        ["b.level -> s.u"],
        {"a.period": 0.13, "b.period": 0.17, "b.how": ASKS},
    )
    result = run(system, stop=1.0, **length(master, 0.1), master=master, isolate=False)
    at, fall = np.arange(0.17, 1.0, 0.17), sqrt(2 / 9.81)
    area = np.maximum(np.subtract.outer(result.time, at), 0.0).sum(1)
    # each event is told up to 1e-9 s late, and acts up to 1e-9 s later
    np.testing.assert_allclose(result["s.s"], area, atol=2e-9 * len(at))
    every = np.sort([*at, *np.arange(0.13, 1.0, 0.13), fall])
    np.testing.assert_allclose([event.time for event in result.events], every, atol=2e-9)
    assert not result.card.notes


def test_adaptive_steps_grow_beside_an_fmu_that_asks_after_each(stopping):
    """It cannot go back, so that steps after an event are short; those after it grow."""
    fmus = {"t": stopping("ticker", canGetAndSetFMUState="false"), "s": stopping("sum")}
    system = assemble(fmus, ["t.level -> s.u"], {"t.how": RESTLESS})
    master = Coupling("gauss-seidel", adaptive=1e-3)
    result = run(system, stop=2.0, record_step=0.1, master=master, isolate=False)
    assert result.card.steps < 100


def test_an_fmu_that_refuses_event_mode_runs_without(stopping):
    """Its events are inside of it, and a note quotes its reason."""
    result = run(stopping("shy"), {"time": [0, 0.5, 0.5, 1], "u": [0, 0, 1, 1]}, stop=1.0, step=0.1)
    assert result["shy.s"][-1] == pytest.approx(0.5, abs=1e-12)  # a sum of five steps
    told = "shy: the FMU declares event mode and refuses to be instantiated with it: its events are inside"
    assert result.card.notes == (f"{told} of steps; it says: no event mode here",)
    assert not result.messages


def test_a_jump_of_a_continuous_input_is_an_event(stopping):
    """The relay switches at the jump, in the row of its time; the cause is the input."""
    for at in (0.5, 0.512345):
        jump = {"time": [0, at, at, 1], "y": [0.5, 0.5, 0.7, 0.7]}
        result = run(stopping("relay"), jump, stop=1.0, step=0.1, record=["relay.y", "relay.on"])
        (event,) = result.events
        assert event.time == at
        assert event.causes == ("relay.y",)
        assert result["relay.on"].tolist() == [1] * (5 if at == 0.5 else 6) + [0] * (6 if at == 0.5 else 5)
    steady = run(stopping("relay"), {"time": [0, 0.5, 1], "y": [0.5, 0.55, 0.5]}, stop=1.0, step=0.1)
    assert steady.events == ()


def test_one_instant_is_one_event(fmu, tmp_path):
    """Inputs of two types that jump together, in Model Exchange."""
    text = MODELS["room"]
    power = [replace(v, causality="input", steady="discrete") if v.name == "power" else v for v in text]
    xml = Description("room", [TIME, *power], {"ModelExchange": {}}, initial=False).text(3)
    with zipfile.ZipFile(fmu("room", 3)) as source, zipfile.ZipFile(tmp_path / "room.fmu", "w") as target:
        for name in source.namelist():
            target.writestr(name, xml if name == "modelDescription.xml" else source.read(name))
    jumps = {"time": [0, 0.5, 0.5, 1], "on": [0, 0, 1, 1], "power": [1, 1, 2, 2]}
    result = run(tmp_path / "room.fmu", jumps, stop=1.0, step=0.25)
    (event,) = result.events
    assert event.time == 0.5
    assert {*event.causes} == {"room.on", "room.power"}
    assert result["room.T"][-1] == pytest.approx(
        2 * (1 - np.exp(-0.5)), abs=1e-7
    )  # the tolerance of the solver


# ---- what is claimed


def test_the_estimate_holds_with_events_at_their_times(stopping):
    """Halving the step changes as little as the truth is off; in another place the search claims nothing."""
    system = assemble({"relay": stopping("relay"), "room": stopping("room")}, HEATED)
    result = run(system, stop=STOP, step=STEP, error_estimate=True, isolate=False)
    (error,) = (e for e in result.card.errors if e.name == "room.T")
    true = np.abs(result["room.T"] - temperature(result.time)).max()
    assert error.change < 1e-9
    assert true < 1e-9
    notes = run(system, stop=1.0, accuracy=1e-3, isolate=False).card.notes
    told = (
        "accuracy 0.001 of room.T: not known, because of events of room, events of relay; without: estimated"
    )
    assert any(note.startswith(told) for note in notes), notes


# ---- mistakes: one line, and the rows until then


WRONG = {
    3: (
        "relay: t = 0.510000001 s: expected time to pass between events, got 200 events without progress",
        0.5,
    ),
    5: (
        "t = 0.916290732 s: expected at most 100 event iterations, got more: the discrete states do not",
        0.9,
    ),
    6: ("relay: the step failed at t = 0.55 s with status discard", 0.5),
    8: ("relay: the step at t = 0.5 s ended early at t = nan s, expected its time", 0.5),
    9: ("relay: the step at t = 0.5 s ended early at t = -0.5 s, a time outside of the step from 0.5 s", 0.5),
    10: ("relay: the step at t = 0.5 s ended early at t = 0.53 s, a time outside of the step from", 0.5),
    11: ("relay: expected the next event after t = 0.916290732 s, got nan s", 0.9),
}


@pytest.mark.parametrize("how", WRONG)
def test_misuse_of_events_ends_the_run_with_its_rows(stopping, how):
    """An FMU that stops for ever, whose states never settle, that discards for ever."""
    system = assemble({"relay": stopping("relay"), "room": stopping("room")}, HEATED, {"relay.how": how})
    with pytest.raises(RunFailed) as failed:
        run(system, stop=1.0, step=STEP, isolate=False)
    message, last = WRONG[how]
    assert message in str(failed.value), failed.value
    assert "\n" not in str(failed.value)
    assert failed.value.result.trace.time[-1] >= last - 1e-9


@pytest.mark.parametrize("master", [Coupling("jacobi"), Coupling("hermite")], ids=["jacobi", "hermite"])
def test_misuse_at_random_ends_in_one_line(stopping, master):
    """Forty runs whose FMU stops, asks and announces as it likes: rows in order, and at most one line."""
    system, ends = assemble({"relay": stopping("relay"), "room": stopping("room")}, HEATED), set()
    for seed, step in enumerate((0.01, 0.07, 0.13, 0.5) * 10, 100):
        given, message = {"relay.how": seed}, ""
        try:
            result = run(system, stop=2.0, step=step, set=given, master=master, isolate=False)
        except RunFailed as failed:
            result, message = failed.result, str(failed)
        assert "\n" not in message
        ends.add(re.sub(r"-?\d\S*", "", message))
        assert (np.diff(result.trace.time) > 0).all()
        assert np.isfinite(result["room.T"]).all()
    assert len(ends) > 2, ends


def test_an_event_in_the_past_is_refused(stopping):
    """One that is now, too: no time would pass."""
    system = assemble(
        {"t": stopping("ticker"), "s": stopping("sum")}, ["t.level -> s.u"], {"t.how": 4, "t.period": 0.2}
    )
    with pytest.raises(
        RunFailed, match=r"^t: expected the next event after t = 0\.6 s, got 0\.5 s$"
    ) as failed:
        run(system, stop=1.0, step=0.1, isolate=False)
    assert failed.value.result.trace.time[-1] == pytest.approx(0.5)
    system = assemble({"t": stopping("ticker"), "s": stopping("sum")}, ["t.level -> s.u"], {"t.period": 0.0})
    with pytest.raises(Problem, match=r"the discrete states do not settle: t\.level"):
        run(system, stop=1.0, step=0.1, isolate=False)


def test_chattering_is_named_with_its_signals(stopping, fmu):
    """A relay without hysteresis: each event brings the next one about, with or without time between them."""
    level = {"relay.low": 0.5, "relay.high": 0.5}
    system = assemble({"relay": stopping("relay"), "room": stopping("room")}, HEATED, level)
    text = r"relay\.on: t = 0\.69\d* s: expected time to pass between events, got 200 events without progress"
    with pytest.raises(RunFailed, match=text) as failed:
        run(system, stop=1.0, step=STEP, isolate=False)
    assert failed.value.result.trace.time[-1] == pytest.approx(0.69)
    exchange = {"relay": fmu("thermo", 3, rolls=True), "room": fmu("room", 3, rolls=True)}
    with pytest.raises(RunFailed, match=r"t = 0\.69\d* s: .* do not settle: relay\.on"):
        run(assemble(exchange, HEATED, level), stop=1.0, step=STEP, isolate=False)


def test_a_loop_of_discrete_signals_that_does_not_settle_is_named(stopping):
    """Two copies in a circle settle; if one of them turns its input round they never do."""
    fmus = {"a": stopping("copy"), "b": stopping("copy"), "t": stopping("ticker"), "s": stopping("sum")}
    wires = ["a.out -> b.in", "b.out -> a.in", "t.level -> s.u"]
    assert run(assemble(fmus, wires), stop=0.1, step=0.1, isolate=False).complete
    system = assemble(fmus, wires, {"b.not": True})
    text = r"at most 100 event iterations, got more: the discrete states do not settle: [ab]\.out"
    problem(lambda: run(system, stop=0.1, step=0.1, isolate=False), text)


def test_an_fmu_may_end_the_run_at_an_event(stopping):
    """At its time."""
    result = run(
        assemble({"t": stopping("ticker")}, [], {"t.how": 7, "t.period": 0.25}),
        stop=1.0,
        step=0.1,
        isolate=False,
    )
    assert result.complete
    assert result.time[-1] == 0.25


@pytest.mark.parametrize(("how", "last"), [(15, 3), (16, 2), (17, 0)])
@pytest.mark.parametrize("period", [0.2, 0.21])
def test_the_row_of_the_event_that_ends_a_run_is_kept(stopping, period, how, last):
    """In event mode, at a point or between two: the values after it, of all FMUs, are the last row.

    Also at a second event of the same time, and in the first instant.
    """
    system = assemble({"t": stopping("ticker"), "s": stopping("sum")}, ["t.level -> s.u"])
    given = {"t.how": how, "t.period": period}
    result = run(system, set=given, stop=1.0, step=0.1, isolate=False)
    assert result.time[-1] == pytest.approx(last * period, abs=1e-9)
    assert (result["t.count"][-1], result["t.level"][-1]) == (last, last if how < 16 else 99.0)
    assert result["s.s"][-1] == pytest.approx(sum(range(last)) * period, abs=1e-9)
    assert (np.diff(result.time) > 1e-9).all()
    if last:
        assert result.events[-1].time == pytest.approx(last * period, abs=1e-9)
        assert result.events[-1].causes == ("t", "t.level")
