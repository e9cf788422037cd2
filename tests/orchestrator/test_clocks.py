"""Clocks of FMI 3.0, and texts that they carry: against recursions and exact times.

The FMU of ticks.c refuses an access to a variable whose clock does not tick.
"""

from fractions import Fraction

import numpy as np
import pytest
from kit.any_fmu.models import bank_fmu, ticking_fmu
from kit.mistakes import problem
from zoo.faulty import faulty

from orchestrator import Coupling, RunFailed, assemble, load, run

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
    """0.2 s after an odd tick, 0.1 s after an even one; a countdown ends when the FMU tells no more."""
    changing = run(str(unit('intervalVariability="changing" intervalDecimal="0.3"')), step=0.04, stop=1.0)
    np.testing.assert_allclose(ticks(changing, "unit.tick"), [0.2, 0.3, 0.5, 0.6, 0.8, 0.9], atol=ROUNDING)
    down = unit('intervalVariability="countdown"', "down")
    counted = run(str(down), step=0.04, stop=1.0, set={"unit.most": 4})
    np.testing.assert_allclose(ticks(counted, "unit.tick"), [0.1, 0.3, 0.4, 0.6], atol=ROUNDING)
    at_once = run(str(down), step=0.04, stop=0.2, set={"unit.most": 3, "unit.period": 0.0})
    assert at_once["unit.count"].tolist() == [3.0] * 6  # three ticks at the start, one after the other
    asked = run(
        str(unit('intervalVariability="fixed"', "asked")), step=0.05, stop=0.5, set={"unit.period": 0.25}
    )
    np.testing.assert_allclose(ticks(asked, "unit.tick"), [0.25, 0.5], atol=ROUNDING)


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
    assert lines[3].endswith(',a.text,"n3"')  # after those of c, which fires at the start


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


@pytest.mark.parametrize(
    ("interval", "given", "message"),
    [
        (DECIMAL.format("0"), {}, "unit.tick: expected an interval above 0 s, got 0 s"),
        (DECIMAL.format("-1"), {}, "expected interval and shift of a clock in seconds, got '-1'"),
        (DECIMAL.format("x"), {}, "expected interval and shift of a clock in seconds, got "),
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
