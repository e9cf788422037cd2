"""Clocks of FMI 3.0, and texts that they carry: against recursions and exact times.

The FMU of ticks.c refuses an access to a variable whose clock does not tick.
"""

import csv
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from kit.any_fmu.description import packed
from kit.any_fmu.models import bank_fmu, ticking_fmu
from kit.mistakes import problem
from kit.needs import needs
from kit.properties import examples
from kit.ssp import second, ssd, system, wire
from zoo.faulty import faulty

from orchestrator import Coupling, Master, RunFailed, assemble, load, run, write_ssp
from orchestrator.engine.network import Texts
from orchestrator.engine.result import Card, Event, write_events
from orchestrator.fmi.clocks import ClockCalls, Schedule
from orchestrator.fmi.description import FmuVariable
from orchestrator.ssp.system import Port
from orchestrator.studies import Factor, Output, Study, sweep

DECIMAL = 'intervalVariability="constant" intervalDecimal="{}"'
TENTH = DECIMAL.format("0.1")
COUNTER = 'intervalVariability="fixed" intervalCounter="{}" resolution="{}"'
MASTERS = [Coupling("jacobi", order=2), Coupling("gauss-seidel"), Coupling("hermite")]
ROUNDING = 1e-14  # of times of order 1, each the nearest float of an exact time or a point of the grid


@pytest.fixture
def unit(tmp_path):
    """unit('intervalVariability=...'): an FMU whose clock ticks so."""

    def made(interval=TENTH, name="unit", **changes):
        (tmp_path / name).mkdir(exist_ok=True)
        return ticking_fmu(tmp_path / name / "unit.fmu", interval, **changes)

    return made


def ticks(result, name):
    return np.array([e.time for e in result.events if name in e.causes])


def test_clocks_meet_exactly(unit):
    """0.1 s, and 3/10 s after 1/5 s: every third instant has both; steps of 0.03 s meet none of them."""
    late = COUNTER.format(3, 10) + ' shiftCounter="2"'
    pair = assemble({"a": unit(), "b": unit(late, "late")})
    result = run(pair, step=0.03, stop=1.2)
    of_a = [float(Fraction(k, 10)) for k in range(1, 12)]  # the first one is at the start
    of_b = [float(Fraction(2 + 3 * k, 10)) for k in range(4)]
    np.testing.assert_allclose(ticks(result, "a.tick"), [*of_a, 1.2], atol=ROUNDING)
    np.testing.assert_allclose(ticks(result, "b.tick"), of_b, atol=ROUNDING)
    assert len(result.events) == 12
    assert result["a.count"][-1] == 13


def test_many_ticks_do_not_drift(unit):
    """Ticks of 1/3000 s on steps of 1 ms: every third one is at a point, which needs no step of its own."""
    result = run(str(unit(COUNTER.format(1, 3000))), step=1e-3, stop=1.0)
    found = ticks(result, "unit.tick")
    np.testing.assert_allclose(found, np.arange(1, 3001) / 3000, atol=ROUNDING)
    assert result.card.steps == 3000


def sending(components, time, length):
    """A textbook master: each component steps, then sends its outputs."""
    for name, component in components.items():
        component.step(time, length)
        components.send(name)


def test_a_master_of_ones_own_leaves_clocked_wires_alone(unit):
    """The engine carries them at ticks: b sums what a sums, of ones, 1 + 2 + ... + k."""
    pair = assemble({"a": unit(), "b": unit(name="b")}, ["a.y -> b.u"], {"a.u": 1.0})
    result = run(pair, step=0.05, stop=0.5, master=Master("mine", step=sending), isolate=False)
    assert result["b.y"][::2].tolist() == [k * (k + 1) / 2 for k in range(1, 7)]


@pytest.mark.parametrize("master", MASTERS, ids=lambda c: c.method.name)
@pytest.mark.parametrize("able", ["true", "false"])
def test_a_sampled_controller(unit, once, master, able):
    """A lag x' = -x + u, u = 1 - y / 2, y the sum of samples of x: by recursion, also without rollback."""
    lag = once("bank", lambda folder: bank_fmu(folder / "bank.fmu")) / "bank.fmu"
    slow = unit(DECIMAL.format("0.05"), **{'FMUState="true" canS': f'FMUState="{able}" canS'})
    wires = [("lag.y[1]", "unit.u"), ("unit.y", "lag.u[1]", -0.5, 1.0)]
    loop = assemble({"lag": lag, "unit": slow}, wires, {"lag.n": 1, "lag.k": "1", "lag.m": "1 0"})
    result = run(loop, step=0.01, stop=1.0, master=master)
    x, s, decay = 0.0, 0.0, np.exp(-0.05)
    for k in range(20):
        assert result["lag.y[1]"][5 * k] == pytest.approx(x, abs=1e-13)  # sums of 20 terms of order 1
        u = 1.0 - 0.5 * (s + x)
        x, s = decay * x + (1 - decay) * u, s + x
    assert result["unit.count"][-1] == 21


def test_intervals_that_change(unit):
    """0.2 s after an odd tick, 0.1 s after an even one; a countdown ends when the FMU tells no more.

    Intervals and shifts of these clocks in a description are none.
    """
    expected = [0.1, 0.3, 0.4, 0.6, 0.7, 0.9, 1.0]
    for name, declared in {"first": "", "other": ' intervalDecimal="0.3" shiftDecimal="0.5"'}.items():
        changing = run(str(unit(f'intervalVariability="changing"{declared}', name)), step=0.04, stop=1.0)
        np.testing.assert_allclose(ticks(changing, "unit.tick"), expected, atol=ROUNDING)
    down = unit('intervalVariability="countdown" intervalDecimal="0.3"', "down")
    counted = run(str(down), step=0.04, stop=1.0, set={"unit.most": 4})
    np.testing.assert_allclose(ticks(counted, "unit.tick"), [0.1, 0.3, 0.4, 0.6], atol=ROUNDING)
    at_once = run(str(down), step=0.04, stop=0.2, set={"unit.most": 3, "unit.period": 0.0})
    assert at_once["unit.count"].tolist() == [3.0] * 6  # three ticks at the start, one after the other
    asked = run(
        str(unit('intervalVariability="fixed"', "asked")), step=0.05, stop=0.5, set={"unit.period": 0.25}
    )
    np.testing.assert_allclose(ticks(asked, "unit.tick"), [0.25, 0.5], atol=ROUNDING)


def test_a_million_ticks_do_not_drift():
    """Tick k is exactly at shift + k interval, in the last fifty thousand, its time the nearest float."""
    shift, interval = Fraction(1, 7), Fraction(1, 3000)
    schedule, constant = Schedule(0.0), {"intervalVariability": "constant", "intervalDecimal": "1"}
    clock = FmuVariable(name="tick", causality="input", attributes=constant)
    schedule.add("tick", ClockCalls(None, "unit"), clock)
    schedule.resume([[str(interval), str(shift + 950_000 * interval)]])
    for _ in range(50_000):
        schedule.begin(schedule.next, 1e-11)
        schedule.finish()
    assert schedule.saved() == [[str(interval), str(shift + 1_000_000 * interval)]]
    assert schedule.next == float(shift + 1_000_000 * interval)


@dataclass
class Node:
    """A node of a random bus: a clock, as it is declared, exactly, and what it has counted.

    source   the node whose frames, and whose count, it receives; None: none
    """

    declared: str
    interval: Fraction
    shift: Fraction
    every: int
    passes: int
    source: int | None
    count: int = 0
    got: int = 0
    heard: int = 0
    total: int = 0
    fired: bool = False


@st.composite
def nodes(draw):
    """Clocks of a few periods that meet, each as a fraction or as a decimal number of 11 to 17 digits."""
    found = []
    for k in range(draw(st.integers(2, 4))):
        interval = Fraction(draw(st.integers(1, 3)), draw(st.sampled_from([12, 14, 15, 21, 30])))
        shift = draw(st.sampled_from([Fraction(0), interval, Fraction(1, 7)]))
        digits = draw(st.sampled_from([0, 11, 12, 13, 15, 17]))
        numbers = interval, shift
        if digits:
            texts = [f"{float(number):.{digits}f}" for number in numbers]
            numbers = tuple(map(Fraction, texts))
            declared = f'intervalVariability="fixed" intervalDecimal="{texts[0]}" shiftDecimal="{texts[1]}"'
        else:
            r = interval.denominator * shift.denominator
            counters = f'intervalCounter="{interval * r}" shiftCounter="{shift * r}" resolution="{r}"'
            exact = draw(st.sampled_from(["", ' supportsFraction="true" intervalDecimal="0.9"']))
            declared = f'intervalVariability="fixed" {counters}{exact}'
        source = draw(st.sampled_from([None, *range(k)]))
        found.append(Node(declared, *numbers, draw(st.integers(1, 3)), draw(st.integers(0, 1)), source))
    return found


TOLERANCE = Fraction(1, 10**11)  # of the time of an instant [s]


def simulated(bus, stop):
    """The ticks and frames of a bus until a time, by exact arithmetic: (time, nodes that tick, that fire)."""
    next_ticks, instants = [node.shift for node in bus], []
    while (first := min(next_ticks)) <= stop:
        assume(all(tick - first != TOLERANCE for tick in next_ticks))  # which rounding would decide
        due = [k for k, tick in enumerate(next_ticks) if tick - first < TOLERANCE]
        for k, node in enumerate(bus):
            source = None if node.source is None else bus[node.source]
            node.count += k in due
            if k in due and source:
                node.total += source.count
            come = source is not None and source.fired
            node.got += come
            node.heard = source.count if come else node.heard
            node.fired = (k in due and node.count % node.every == 0) or (come and bool(node.passes))
        instants.append((float(first), due, [k for k, node in enumerate(bus) if node.fired]))
        next_ticks = [t + bus[k].interval * (k in due) for k, t in enumerate(next_ticks)]
    return instants


@given(bus=nodes(), master=st.sampled_from(MASTERS), step=st.sampled_from([0.033, 0.045]), able=st.booleans())
@examples(12)
def test_a_random_bus_is_that_of_exact_arithmetic(once, bus, master, step, able):
    """Ticks, frames and sums of samples of nodes whose clocks meet exactly, nearly, or not."""
    stop, files = 0.99, dict[str, object]()
    for k, node in enumerate(bus):
        home = once(f"n{node.declared}{able}".replace('"', "").replace(" ", ""), lambda _: None)
        files[f"n{k}"] = ticking_fmu(home / "unit.fmu", node.declared, **{} if able else STATELESS)
    wires = [
        f"n{node.source}.{out} -> n{k}.{to}"
        for k, node in enumerate(bus)
        if node.source is not None
        for out, to in (("fired", "come"), ("frame", "data"), ("count", "u"))
    ]
    start = {f"n{k}.{name}": getattr(n, name) for k, n in enumerate(bus) for name in ("every", "passes")}
    result = run(assemble(files, wires, start), step=step, stop=stop, master=master, isolate=False)
    instants = simulated(bus, Fraction(stop))
    later = [(t, due) for t, due, _ in instants if t > 0]
    ticked = [e for e in result.events if any(c.endswith(".tick") for c in e.causes)]
    assert [[k for k in range(len(bus)) if f"n{k}.tick" in e.causes] for e in ticked] == [d for _, d in later]
    # a tick may be at a point or an instant that is less than 1e-11 s away
    np.testing.assert_allclose([e.time for e in ticked], [t for t, _ in later], atol=1.1e-11, rtol=0)
    sent = [name for _, name, _ in result.texts if name.endswith(".frame")]
    assert sorted(sent) == sorted(f"n{k}.frame" for *_, fired in instants for k in fired)
    for k, node in enumerate(bus):
        found = [result[f"n{k}.{name}"][-1] for name in ("count", "got", "heard")]
        assert found == [node.count, node.got, node.heard]
        if node.source is not None:
            assert result[f"n{k}.y"][-1] == node.total


STATELESS = {'FMUState="true" canS': 'FMUState="false" canS'}
FRACTIONS = 'intervalVariability="{}" supportsFraction="true"'


def test_a_first_tick_that_the_fmu_tells(unit):
    """Interval and shift of the FMU where the description has none; a shift below 0 is refused."""
    given = {"unit.period": 0.2, "unit.delay": 0.15}
    found = ticks(run(str(unit('intervalVariability="fixed"')), step=0.05, stop=1.0, set=given), "unit.tick")
    np.testing.assert_allclose(found, [0.15, 0.35, 0.55, 0.75, 0.95], atol=ROUNDING)
    declared = unit('intervalVariability="tunable" shiftDecimal="0.5"', "declared")
    found = ticks(run(str(declared), step=0.05, stop=1.0, set=given), "unit.tick")
    np.testing.assert_allclose(found, [0.5, 0.9], atol=ROUNDING)  # after a tick 0.2 (1 + 1)
    both = unit('intervalVariability="tunable" intervalDecimal="0.3" shiftDecimal="0.5"', "both")
    found = ticks(run(str(both), step=0.05, stop=1.5, set=given), "unit.tick")
    np.testing.assert_allclose(found, [0.5, 0.9, 1.1, 1.5], atol=ROUNDING)
    told = problem(
        lambda: run(str(unit('intervalVariability="fixed"')), stop=1.0, step=0.1, set={"unit.delay": -1})
    )
    assert told == "unit.tick: expected a shift of 0 s or more, got -1 s"


LATE = [("changing", 3), ("countdown", 3), ("countdown", 4)]


@pytest.mark.parametrize(
    ("kind", "odd", "first"),
    [("tunable", 1, [0.15, 0.55, 0.75]), *((kind, odd, [0.2, 0.6, 0.8]) for kind, odd in LATE)],
)
def test_an_interval_that_is_told_at_another_time(unit, kind, odd, first):
    """A tunable one again at each instant, as changed; aperiodic ones in event mode only."""
    pair = assemble({"unit": unit(f'intervalVariability="{kind}"'), "other": unit(name="other")})
    given = {"unit.period": 0.2, "unit.delay": 0.15, "unit.odd": odd}
    result = run(pair, step=0.05, stop=0.99, set=given)
    np.testing.assert_allclose(ticks(result, "unit.tick"), first, atol=ROUNDING)


@pytest.mark.parametrize("more", ["", ' supportsFraction="true"'])
@pytest.mark.parametrize(("kind", "odd"), [("fixed", 2), ("fixed", 3), ("tunable", 2), ("tunable", 3)])
def test_a_period_that_is_not_known_is_refused(unit, kind, odd, more):
    """Also if the FMU writes none, as a decimal number or a fraction."""
    alone = unit(f'intervalVariability="{kind}"{more}')
    told = problem(lambda: run(str(alone), step=0.1, stop=0.5, set={"unit.odd": odd}))
    assert told == "unit.tick: expected an interval in initialisation mode, got not yet known"


def test_clocks_of_a_third_and_a_seventh_meet_at_whole_seconds(unit):
    """Their intervals are no decimal numbers: both in one instant at 1 s, 2 s and 3 s, and nowhere else."""
    files = {"a": unit(FRACTIONS.format("fixed")), "b": unit(FRACTIONS.format("fixed"), "b")}
    system = assemble(files, [], {"a.period": 1 / 3, "b.period": 1 / 7, "b.delay": 1 / 7})
    result = run(system, step=0.1, stop=3.0)
    np.testing.assert_allclose(ticks(result, "a.tick"), np.arange(1, 10) / 3, atol=ROUNDING)
    np.testing.assert_allclose(ticks(result, "b.tick"), np.arange(1, 22) / 7, atol=ROUNDING)
    assert [e.time for e in result.events if {"a.tick", "b.tick"} <= {*e.causes}] == [1.0, 2.0, 3.0]


COUNT = 'name="count" valueReference="10" causality="output" clocks="1"'


def test_variables_of_an_output_clock_need_no_wire(unit):
    """`count` belongs to `fired`, which ticks at every second tick: read there, held in between."""
    alone = unit(**{COUNT: COUNT.replace('clocks="1"', 'clocks="2"')})
    result = run(str(alone), step=0.05, stop=0.5, set={"unit.every": 2})
    assert result["unit.count"].tolist() == [0, 0, 2, 2, 2, 2, 4, 4, 4, 4, 6]


Y = 'name="y" valueReference="21" causality="output" variability="discrete" clocks="1"'
TEXT = 'name="text" valueReference="30" causality="output" clocks="2"'
OUTPUTS = '<Output valueReference="10" dependencies=""/>'


def test_values_before_the_first_tick(unit, once):
    """Those of the start, also where wires lead; a local variable is read, too."""
    lag = once("bank", lambda folder: bank_fmu(folder / "bank.fmu")) / "bank.fmu"
    local = {COUNT: COUNT.replace("output", "local"), OUTPUTS: "", Y: f'{Y} initial="exact" start="7"'}
    late = unit(DECIMAL.format("0.1") + ' shiftDecimal="0.35"', **local)
    pair = assemble({"late": late, "lag": lag}, ["late.y -> lag.u[1]"], {"late.u": 2.0})
    names = ["late.y", "late.u", "late.count", "lag.u[1]"]
    result = run(pair, step=0.05, stop=0.5, record=names)
    assert result["late.y"].tolist() == result["lag.u[1]"].tolist() == [7.0] * 7 + [2.0, 2.0, 4.0, 4.0]
    assert result["late.u"].tolist() == [2.0] * 11
    assert result["late.count"].tolist() == [0] * 7 + [1, 1, 2, 2]


@pytest.mark.parametrize("start", ["first", ""])
def test_a_text_of_a_clock_at_an_input_without_one(unit, start):
    """The latest text, from the one of the start on."""
    with_start = {f"<String {TEXT}/>": f'<String {TEXT} initial="exact"><Start value="{start}"/></String>'}
    files = {"a": unit(**(with_start if start else {})), "b": unit(DECIMAL.format("9"), "b")}
    result = run(assemble(files, ["a.text -> b.note"], {"a.every": 3}), step=0.05, stop=1.0)
    assert result["b.noted"].tolist() == [len(start)] * 4 + [2] * 17  # n3 at 0.2 s, n6, n9
    assert [text for _, name, text in result.texts if name == "a.text"] == [
        *([start] if start else []),
        *("n3", "n6", "n9"),
    ]


CHAIN = [
    "a.fired -> b.come",
    "a.text -> b.word",
    "a.frame -> b.data",
    "b.fired -> c.come",
    "b.frame -> c.data",
]


def chain(unit):
    slow = DECIMAL.format("10")
    files = {"a": unit(), "b": unit(slow + ' shiftDecimal="5"', "b"), "c": unit(slow, "c")}
    return assemble(files, CHAIN, {"a.every": 3, "b.passes": 1})


def test_equal_frames_are_kept_at_each_tick(unit, tmp_path):
    """b passes on what a sends; its own clock does not tick, so that its frame is 0000 each time."""
    result = run(chain(unit), step=0.03, stop=0.99)
    for name, value in (("b.frame", "0000"), ("b.text", "n0")):
        sent = [(round(t, 9), v) for t, n, v in result.texts if n == name]
        assert sent == [(0.2, value), (0.5, value), (0.8, value)]
    result.write(tmp_path / "run.csv")
    assert (tmp_path / "run.texts.csv").read_text().count("b.frame,0000") == 3


@pytest.mark.parametrize("strict", [("b",), ("a", "b", "c"), ("c",)])
def test_an_input_is_set_once_and_before_outputs_are_read(unit, strict):
    """A repeater may refuse anything else in an instant (FMI-LS-BUS); no source is copied unread."""
    result = run(chain(unit), step=0.03, stop=0.99, set={f"{name}.odd": 5 for name in strict})
    assert (result["b.got"][-1], result["c.got"][-1]) == (3, 3)
    assert [v for _, n, v in result.texts if n == "a.frame"] == ["0003", "0006", "0009"]
    sampled = assemble({"a": unit(), "b": unit(name="b")}, [("a.y", "b.u", 2.0, 1.0)], {"a.u": 1.0})
    sums = run(sampled, step=0.05, stop=0.5, set={f"{name}.odd": 5 for name in "ab"})
    assert sums["b.y"][::2].tolist() == [k + k * (k + 1) for k in range(1, 7)]  # sum of 2 k + 1


FRAME = 'name="frame" valueReference="40" causality="output" clocks="{}"'
SENDS = {FRAME.format(2): FRAME.format(1)}


@pytest.mark.parametrize("kind", ["constant", "changing", "countdown"])
def test_a_clock_that_ticks_by_time_sends(unit, kind):
    """To a triggered one, both inputs: in the same instant, with the frame of the first (FMI-LS-BUS)."""
    interval = TENTH if kind == "constant" else f'intervalVariability="{kind}"'
    files = {"a": unit(interval, **SENDS), "b": unit(DECIMAL.format("7") + ' shiftDecimal="6"', "b")}
    result = run(assemble(files, ["a.tick -> b.come", "a.frame -> b.data"]), step=0.05, stop=0.95)
    sent = [round(t, 9) for t, name, _ in result.texts if name == "a.frame"]
    exact = [k / 10 for k in range(10)] if kind == "constant" else [0.1, 0.3, 0.4, 0.6, 0.7, 0.9]
    assert sent == [round(t, 9) for t in exact]
    assert result["b.got"][-1] == len(exact) == result["b.heard"][-1]
    alone = run(assemble(files, ["a.frame -> b.data"]), step=0.05, stop=0.95)
    never = "its clock b.come never ticks, because nothing is connected to it"
    assert alone.card.notes == (f"b.data keeps its start value: {never}",)
    assert "expected an output and an input, got input" in problem(
        lambda: assemble(files, ["a.come -> b.come"])
    )


def test_texts_go_with_their_clocks(unit, tmp_path):
    """Every third tick fires through two FMUs in one instant; the file has changes only."""
    result = run(chain(unit), step=0.03, stop=0.99)
    np.testing.assert_allclose(ticks(result, "c.come"), [0.2, 0.5, 0.8], atol=ROUNDING)
    assert (result["b.got"][-1], result["c.got"][-1]) == (3, 3)
    assert result["b.heard"][-1] == len("n9") + 9
    found = [(text, value) for _, text, value in result.texts if text in ("a.text", "a.frame")]
    assert found == [
        (name, v.format(k)) for k in (3, 6, 9) for name, v in (("a.text", "n{}"), ("a.frame", "000{}"))
    ]
    result.write(tmp_path / "run.csv")
    lines = (tmp_path / "run.texts.csv").read_text().splitlines()
    assert lines[0] == "time,signal,text"
    assert lines[3].endswith(",a.text,n3")  # after those of c, which fires at the start


BUS = [
    f"{a}.{out} -> {b}.{to}" for a, b in ("pq", "qp") for out, to in (("fired", "come"), ("frame", "data"))
]


@pytest.mark.parametrize("master", MASTERS, ids=lambda c: c.method.name)
def test_two_nodes_of_a_bus_send_each_other_frames(unit, master):
    """Both ways, at 1/10 s and 3/20 s, together at each 3/10 s: each frame arrives at its time."""
    sends = {'valueReference="2" dependencies="1 3"': 'valueReference="2" dependencies="1"'}
    nodes = {"p": unit(**sends), "q": unit(DECIMAL.format("0.15"), "q", **sends)}
    result = run(assemble(nodes, BUS), step=0.05, stop=1.2, master=master)
    frames = [(round(1200 * t), name, text) for t, name, text in result.texts if name.endswith("frame")]
    exact = [(120 * k, "p.frame", f"00{k + 1:02x}") for k in range(13)]
    exact += [(180 * k, "q.frame", f"00{k + 1:02x}") for k in range(9)]
    assert sorted(frames) == sorted(exact)
    points = np.arange(25)  # of 0.05 s
    for receiver, every in (("q", 2), ("p", 3)):
        assert result[f"{receiver}.got"].tolist() == (1 + points // every).tolist()
        assert result[f"{receiver}.heard"].tolist() == result[f"{receiver}.got"].tolist()  # the last byte


UNTOLD = {f' dependencies="{known}"': "" for known in ("1 3", "", "31 41", "20")}


def test_strict_nodes_that_declare_no_dependencies_send_both_ways(unit):
    """Rounds of an instant repeat until nothing changes, without setting the same value again."""
    nodes = {"p": unit(**UNTOLD), "q": unit(TENTH + ' shiftDecimal="0.05"', "q", **UNTOLD)}
    both = [f"{a}.y -> {b}.u" for a, b in ("pq", "qp")]
    result = run(assemble(nodes, [*BUS, *both], {"p.odd": 5, "q.odd": 5}), step=0.025, stop=0.975)
    assert [result[name][-1] for name in ("p.got", "q.got", "p.heard", "q.heard")] == [10, 10, 10, 10]
    assert len([text for *_, text in result.texts if text == "0003"]) == 2


def test_variables_of_an_output_clock_are_read(unit):
    """Also if it feeds no other clock: every second count, held in between."""
    of_fired = {'"10" causality="output" clocks="1"': '"10" causality="output" clocks="2"'}
    result = run(str(unit(**of_fired)), step=0.05, stop=0.5, set={"unit.every": 2})
    assert result["unit.count"].tolist() == [0, 0, 2, 2, 2, 2, 4, 4, 4, 4, 6]
    assert [text for *_, text in result.texts] == [v for k in (2, 4, 6) for v in (f"n{k}", f"000{k}")]


def test_a_step_that_is_repeated_changes_no_text(unit):
    """Its changes are forgotten, and an output has the value before them, or none."""
    wires = ["a.text -> b.word", "a.frame -> b.data", "b.text -> a.word", "b.frame -> a.data"]
    texts = Texts(assemble({"a": unit(), "b": unit(name="b")}, wires), {})
    for k, name in enumerate(["text", "text", "frame", "text"]):
        texts.store(Port("a", name), f"{k}", 0.1 * k)
    texts.withdraw(0.0)
    assert (texts.last, texts.changes) == ({Port("a", "text"): "0"}, [(0.0, "a.text", "0")])


def test_names_and_texts_of_all_letters_are_in_the_files(tmp_path):
    """Commas, quotes and line ends, as readers of CSV take them."""
    cause, text = "a.y[1,2]", 'a"b,\n1'
    card = Card(master="x", step=0.1, events=(Event(0.1, (cause,)),), texts=((0.1, cause, text),))
    write_events(card, tmp_path / "x.csv")
    for kind, row in (("events", ["0.1", cause]), ("texts", ["0.1", cause, text])):
        with (tmp_path / f"x.{kind}.csv").open(newline="") as file:
            assert [*csv.reader(file)][1] == row


def typed(kind, *names):
    """Connectors of inputs (names that end in >) or outputs of one type."""
    way = {True: "input", False: "output"}
    return "".join(
        f'<ssd:Connector name="{n.rstrip(">")}" kind="{way[n.endswith(">")]}"><ssc:{kind}/></ssd:Connector>'
        for n in names
    )


def test_clocks_in_a_file(unit, tmp_path):
    """SSP 2.0 has wires of clocks and binaries and start values of binaries; SSP 1.0 has not, in a line."""
    given = {"c.note": "abc", "c.word": "ab", "a.data": "00ff"}
    whole, file = chain(unit).with_start(given), tmp_path / "chain.ssp"
    told = problem(lambda: write_ssp(whole, file, version="1.0"))
    expected = "expected a number or a text in SSP 1.0, got a Clock; version 2.0 has it"
    assert told == f"system: a.fired: {expected}"
    again = load(write_ssp(whole, file))
    assert {*map(str, again.connections)} == {*map(str, whole.connections)}
    assert all(again.components[n].start == whole.components[n].start for n in "abc")
    found, direct = (run(system, step=0.03, stop=0.99) for system in (again, whole))
    assert (found.texts, found["c.heard"].tolist()) == (direct.texts, direct["c.heard"].tolist())
    alone = load(unit())
    told = problem(lambda: write_ssp(alone.with_start({"unit.data": "00ff"}), file, version="1.0"))
    assert told == f"unit: unit.data: {expected.replace('Clock', 'Binary')}"
    old = run(load(write_ssp(alone, file, version="1.0")), step=0.05, stop=0.5)
    assert old["unit.count"][-1] == 6


def test_a_bus_through_systems_of_a_file(unit, tmp_path):
    """Connectors of an inner system and of the whole one; nothing ticks a clock at an input of the system."""
    parts = {
        name: f'<ssd:Component name="{name}" source="unit.fmu"><ssd:Connectors>{ends}</ssd:Connectors>'
        "</ssd:Component>"
        for name, ends in {
            "p": typed("Clock", "fired") + typed("Binary", "frame"),
            "q": typed("Clock", "come>", "fired") + typed("Binary", "data>", "frame"),
        }.items()
    }
    ends = typed("Clock", "c") + typed("Binary", "d")
    inner = system([parts["p"]], [wire("p.fired", "c"), wire("p.frame", "d")], ends, name="left")
    outer = typed("Clock", "sent", "idle>") + typed("Binary", "frames", "from>")
    notes = ("idle: left out, a clock at an input of the system, where nothing ticks",)
    tells = [wire("q.fired", "sent"), wire("q.frame", "frames")]
    silent = f"{notes[0]}|q.data keeps its start value: its clock q.come never ticks"
    for wires, got, told in (
        ([wire("q.come", "left.c"), wire("left.d", "q.data")], 11, notes[0]),  # either direction
        ([wire("idle", "q.come"), wire("from", "q.data")], 0, silent),
    ):
        text = second(ssd(system([inner, parts["q"]], [*wires, *tells], outer)))
        members = {"SystemStructure.ssd": text, "unit.fmu": unit().read_bytes()}
        result = run(load(packed(tmp_path / "bus.ssp", members)), step=0.05)  # from 0.5 s to 1.5 s
        assert result["q.got"][-1] == got
        assert [word in note for word, note in zip(told.split("|"), result.card.notes, strict=False)]
        assert len(result.card.notes) == len(told.split("|"))


def test_a_study_and_real_time_take_a_bus_from_a_file(unit, tmp_path):
    """Every second or third tick of 0.1 s sends a frame, from 0 s on: 5 or 3 in 1 s."""
    write_ssp(chain(unit), tmp_path / "bus.ssp")
    factor = Factor("a.every", "values", {"values": (2.0, 3.0)})
    output = Output("got", "b.got", "final")
    timed = {"stop": 0.95, "step": 0.05}
    study = Study("bus", str(tmp_path / "bus.ssp"), "grid", factors=(factor,), outputs=(output,), **timed)
    assert sweep(study, tmp_path / "out", workers=1).table["output:got"].tolist() == [5.0, 3.0]


def test_ticks_of_a_run_in_parts(unit, tmp_path):
    """Clocks, their variables, texts and events: the halves are the whole."""
    system = chain(unit)
    whole = run(system, step=0.03, stop=1.2)
    run(system, step=0.03, stop=0.6, save_state=tmp_path / "half.state")
    rest = run(system, step=0.03, stop=1.2, resume=tmp_path / "half.state", isolate=False)
    assert all(np.array_equal(rest[name], whole[name][-len(rest.time) :]) for name in whole)
    assert (rest.events, rest.texts) == (whole.events, whole.texts)


def test_ticks_are_kept_when_the_process_dies(unit, tmp_path):
    """Another FMU crashes at 0.5 s: the events until then, as its rows."""
    system = assemble({"unit": unit(), "lag": faulty(tmp_path, "segfault").fmu})
    with pytest.raises(RunFailed) as failed:
        run(system, stop=1.0, step=0.05)
    np.testing.assert_allclose(ticks(failed.value.result, "unit.tick"), np.arange(1, 6) / 10, atol=ROUNDING)


@needs("x86-64", "the FMU switches on traps of SSE")
@pytest.mark.parametrize("how", [1, 2])
def test_traps_that_an_fmu_switches_on_in_an_instant_end_nothing(unit, how):
    """In each call of a clock, of its variables and of event mode; and if getters of these round upwards.

    The run goes on as without, with a warning.
    """
    wires = ["a.fired -> b.come", ("a.y", "b.u", 0.3, 0.1)]
    pair = assemble({"a": unit(), "b": unit(name="b")}, wires, {"a.u": 0.1})
    calm, trapping = (run(pair, set={"a.traps": traps}, step=0.03, stop=1.0) for traps in (0, how))
    assert all(np.array_equal(calm[name], trapping[name]) for name in calm)
    (warning,) = trapping.card.warnings
    assert warning.startswith("a at t = 0 s: the FMU changed the floating-point environment")


@pytest.mark.parametrize(
    ("interval", "given", "message"),
    [
        (DECIMAL.format("0"), {}, "unit.tick: expected an interval above 0 s, got 0 s"),
        (DECIMAL.format("-1"), {}, "interval and shift of a clock [s]: expected 0 s or more, got '-1'"),
        (DECIMAL.format("x"), {}, "interval and shift of a clock [s]: expected a number, got "),
        (
            DECIMAL.format("1e999999999"),
            {},
            ": tick: interval and shift of a clock [s]: expected a finite number",
        ),
        (
            'intervalVariability="fixed"',
            {"period": -2.0},
            "unit.tick: expected an interval above 0 s, got -2 s",
        ),
        ('intervalVariability="countdown"', {"period": -1.0}, "expected an interval 0 s or more, got -1 s"),
        (
            'intervalVariability="countdown"',
            {"period": 0.0},
            "unit.tick: t = 0 s: expected time to pass between",
        ),
        (
            'intervalVariability="changing" intervalDecimal="1"',
            {"period": float("nan")},
            "expected an interval in",
        ),
    ],
)
def test_intervals_that_cannot_be_are_told(unit, interval, given, message):
    """In one line with the clock and what was expected."""
    start = {f"unit.{name}": value for name, value in given.items()}
    told = problem(lambda: run(str(unit(interval)), step=0.1, stop=0.5, set=start, isolate=False))
    assert message in told
    assert "\n" not in told


def test_wires_of_clocks_that_cannot_be_are_told(unit):
    """A clock that ticks by time, a number at one end, a cycle, no event mode."""
    files = {"a": unit(), "b": unit(name="b")}
    told = problem(lambda: assemble(files, ["a.fired -> b.tick"]))
    expected = "expected a triggered clock at the end, got the constant b.tick, which ticks by time"
    assert told == f"a.fired -> b.tick: {expected}"
    assert "variables of type Clock and Integer cannot" in problem(
        lambda: assemble(files, ["a.fired -> b.every"])
    )
    circle = assemble(files, ["a.fired -> b.come", "b.fired -> a.come"])
    told = problem(lambda: run(circle, step=0.1, stop=0.5))
    assert "algebraic loop a.fired -> b.come, b.fired -> a.come" in told
    plain = unit(name="plain", **{'hasEventMode="true"': ""})
    told = problem(lambda: load(plain))
    assert told.endswith("tick has a clock: expected Co-Simulation with event mode, got an FMU without")
