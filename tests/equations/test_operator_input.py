"""Operator input: strokes as declared, right-hand derivatives at corners, and the program in the FMU."""

from collections.abc import Iterator

import casadi as ca
import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from kit.fmu import Fmu, driving
from kit.mistakes import problem

from fmus.composition import compose
from fmus.contract import unstack
from fmus.machine.build import data
from fmus.machine.poses import NOMINAL, POSES, pose_set
from fmus.operator_input import OPERATOR, work_cycle
from fmus.operator_input.model import AHEAD, AXES, PAYLOADS, STROKES, Stroke, sample
from fmus.operator_input.work_cycle import sample as sampled
from fmus.parameters import values
from orchestrator.base.errors import Problem

_NAMES = ("start", "command", "rise", "hold", "fall")
_TIME, _STROKE = ca.SX.sym("t"), [ca.SX.sym(n) for n in _NAMES]
_SAMPLE = ca.Function("sample", [_TIME, *_STROKE], list(sample(unstack(Stroke, _STROKE), _TIME)))
duration = st.integers(0, 3000).map(lambda ms: ms / 1000)


@st.composite
def moves(draw):
    """A stroke with corners on a grid of 1 ms; ramps and top may have zero duration."""
    times = [draw(duration) for _ in range(4)]
    return work_cycle.Move("boom", times[0], draw(st.floats(-10, 10)), *times[1:])


def at(move: work_cycle.Move, time: float) -> tuple[float, float]:
    """Command and rate of a stroke."""
    value, rate = _SAMPLE(time, *(getattr(move, n) for n in _NAMES))
    return float(value), float(rate)


@given(moves(), st.integers(0, 12_000_000))
def test_a_stroke_is_the_move_of_the_scenario(move, microseconds):
    """Between the corners, and at them the value to the right of a jump."""
    time = microseconds / 1e6
    corners = np.cumsum([move.start, move.rise, move.hold, move.fall])
    beside = np.abs(corners - time)
    if np.any((beside > 0) & (beside < 1e-9)):  # rounding decides on which side of a jump this is
        return
    # a ramp is no steeper than 10 V in 1 ms: rounding of 12 s
    assert at(move, time)[0] == pytest.approx(move.sample(np.array([time]))[0], abs=1e-10)


@given(moves(), st.integers(0, 12_000))
def test_the_rate_at_a_millisecond_leads_to_the_next(move, ms):
    """Value plus rate times 1 ms is the value just before the next jump: also one rounding below a corner."""
    now, after = ms / 1000, (ms + 1) / 1000
    for time in (now, now - 1e-12, now + 1e-12):
        value, rate = at(move, time)
        # no more than 1e4 V/s times 1e-12 s
        assert value + rate * (1e-3 - 2 * AHEAD) == pytest.approx(at(move, after - 2 * AHEAD)[0], abs=2e-8)
        assert at(move, now + 5e-4)[1] == rate  # no corner lies between milliseconds


def test_a_clock_of_an_hour_still_meets_the_corners():
    """Sums of 1 ms steps differ from an hour by rounding, in either direction, but no corner is missed."""
    clock = float(np.cumsum(np.full(3_600_000, 1e-3))[-1])
    assert clock != 3600.0
    for time in (clock, 7200.0 - clock):
        assert at(work_cycle.Move("boom", 3600.0, 5.0, 0.5, 1.0, 0.5), time)[1] == 10.0


def test_the_fmu_plays_the_work_cycle(fmu_dir):
    """At every fifth millisecond the commands and rates of the scenario."""
    time, commands = sampled(work_cycle.WORK_CYCLE, work_cycle.WORK_CYCLE_STOP)
    names = [f"{lever}_command" for lever in AXES]
    rates = np.diff(commands, axis=0) * 200  # V/s: 200 samples per second, corners on them
    names += [f"{name}_rate" for name in names]
    with driving(fmu_dir / "operator_input.fmu") as operator:
        found = [operator.get(*names)]
        found += [operator.step(1e-3, 5).get(*names) for _ in range(len(time) - 2)]
    # the clock adds up 42000 steps: 3e-11 s, at no more than 14 V/s
    np.testing.assert_allclose(found, np.hstack([commands[:-1], rates]), rtol=0, atol=1e-9)


def test_every_corner_is_a_time_event(fmu_dir, fmi3_dir):
    """In model exchange the FMU announces each corner as a time event, and none after the last one."""
    corners = {
        round(5.0 + c, 9) for m in work_cycle.WORK_CYCLE for c in np.cumsum([m.start, m.rise, m.hold, m.fall])
    }
    for folder in (fmu_dir, fmi3_dir):
        fmu = Fmu(folder / "operator_input.fmu", "me").initialise(5.0)
        times = list(events(fmu, 5.0))
        fmu.close()
        assert [round(time, 9) for time in times] == sorted(corners)


def events(fmu: Fmu, start: float) -> Iterator[float]:
    """The times of the events of an FMU whose one state is a clock, one after the other."""
    while (event := fmu.update())[4]:
        yield event[5]
        fmu.fmu.enterContinuousTimeMode()
        fmu.fmu.setTime(event[5])
        fmu.set_continuous_states(event[5] - start)
        fmu.fmu.enterEventMode()


def test_no_event_is_lost_in_a_whole():
    """Components with time events cannot be composed, because the FMU would not announce them."""
    whole, folder = {"operator_input": OPERATOR}, OPERATOR.values.parent
    with pytest.raises(Problem, match="whole: operator_input has time events"):
        compose("whole", "The operator alone", whole, (), {}, folder=folder)


def test_programs_are_the_shipped_scenarios():
    """data/scenarios contains the same moves as a scenario."""
    for name in ("work_cycle", "boom_up", "work_cycle_stems"):
        table, program = pd.read_csv(data(f"scenarios/{name}.csv")), work_cycle.PROGRAMS[name]
        time, commands = sampled(program, table["time"].iloc[-1])
        for axis, column in zip(AXES, commands.T, strict=True):
            known = np.interp(time, table["time"], table.get(f"{axis}_command", 0 * table["time"]))
            # ten digits of the file
            np.testing.assert_allclose(known, column, rtol=0, atol=1e-9)
        held = np.interp(time, table["time"], table.get("payload_mass", 0 * table["time"]))
        np.testing.assert_array_equal(held, work_cycle.payload(program, time))


def test_a_program_that_is_too_long_is_refused():
    """The message contains the lever and both numbers."""
    many = [work_cycle.Move("stick", float(n), 1.0, 0.1, 0.1, 0.1) for n in range(11)]
    problem(lambda: work_cycle.program(many), "stick lever: 11 strokes, expected at most 10")
    assert work_cycle.program(many[:10])["stick_10_start"] == 9.0
    assert len(work_cycle.program(())) == len(AXES) * len(STROKES) * 5 + len(PAYLOADS) * 3
    with pytest.raises(Problem, match="5 stems, expected at most 4"):
        work_cycle.program([work_cycle.Stem(float(n), 100.0, 0.5) for n in range(5)])


def test_the_default_sets_are_the_start_values():
    """Default pose and program of the system are the values in the FMUs."""
    assert work_cycle.program(work_cycle.PROGRAMS[work_cycle.DEFAULT]) == values(OPERATOR).p
    from fmus.machine.parts import FERIC

    for port, value in pose_set(POSES[NOMINAL]).items():
        component, name = port.split(".")
        found = values(FERIC.subsystems[component])
        # stated with nine digits
        assert ({**found.u, **found.p})[name] == pytest.approx(value, rel=1e-8)
