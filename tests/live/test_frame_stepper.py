"""The loop in frames beside `run`: the same bits; mistakes; memory."""

import gc
import tracemalloc
from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest
from kit.mistakes import problem

from orchestrator import Coupling, Trace, run
from orchestrator.realtime.setup import Axis, Setup
from orchestrator.realtime.stepping import FrameStepper
from orchestrator.ssp import load as loading

from .conftest import DETAILED

COMMANDS = tuple(Axis(f"{name}_command", 10.0, 100.0) for name in ("swing", "boom", "stick"))
SHOWN = ("manipulator.swing_angle", "manipulator.stick_angle", "swing.swing_pressure_a")
SHOWN += ("boom_stick.boom_head_pressure", "boom_stick.boom_command")


def played(setup: Setup, frames: int, wanted) -> Trace:
    """A live run; wanted: values of the axes by number of the frame."""
    with closing(FrameStepper(setup)) as live:
        rows = [(live.t, live.axes.copy(), live.values.copy())]
        for n in range(frames):
            live.advance(wanted(n))
            rows.append((live.t, live.axes.copy(), live.values.copy()))
    times, axes, values = (np.array(column) for column in zip(*rows, strict=True))
    table = {axis.name: axes[:, i] for i, axis in enumerate(setup.axes)}
    return Trace(times, table | {name: values[:, i] for i, name in enumerate(setup.signals)})


def same_as_run(setup: Setup, live: Trace, system=None) -> None:
    """`run` with what drove the live machine as its scenario gives the same numbers."""
    scenario = live.select([axis.name for axis in setup.axes])
    as_set = {"swap": setup.swap, "set": setup.set, "step": setup.step}
    result = run(system or setup.system, scenario, **as_set, record=setup.signals, record_step=setup.frame)
    assert result.complete
    np.testing.assert_array_equal(result.trace.time, live.time)
    for name in setup.signals:
        np.testing.assert_array_equal(result.trace[name], live[name], err_msg=name)


def random_walk(seed: int, size: int, limit: float = 6.0):
    """Commands that change in each frame, or jump."""
    rng = np.random.default_rng(seed)
    rows = np.clip(np.cumsum(rng.normal(0, 0.5, (1000, size)), axis=0), -limit, limit)
    rows[400:] = rng.uniform(-limit, limit, (600, size))
    return rows.__getitem__


@pytest.mark.parametrize("swap", [{}, DETAILED], ids=["lumped", "detailed"])
def test_the_machine_is_the_one_of_run(fmu_dir, swap):
    """Half a second of random commands, to the last bit, with a pose that is set."""
    pose = {"manipulator.initial_boom_angle": 0.3}
    setup = Setup(str(fmu_dir / "harvester.ssp"), COMMANDS, SHOWN, swap, set=pose)
    live = played(setup, 50, random_walk(1, 3))
    assert np.ptp(live["manipulator.swing_angle"]) > 1e-3
    same_as_run(setup, live)


MASTERS = {
    "jacobi": Coupling("jacobi"),
    "third order": Coupling("gauss-seidel", 3),
    "hermite": Coupling("hermite"),  # with a guard that divides steps
    "interface-jacobian": Coupling("interface-jacobian"),
    "adaptive": Coupling("hermite", adaptive=1e-4),
}


@pytest.mark.parametrize("label", MASTERS)
def test_masters_that_a_system_suggests(system, monkeypatch, label):
    """A quarter of a second under each of them, steps of their own choice included."""
    suggested = system.coupled(MASTERS[label])
    monkeypatch.setattr(loading, "load", lambda _: suggested)
    setup = Setup("suggested", COMMANDS, SHOWN, step=2e-3)
    live = played(setup, 25, random_walk(2, 3))
    same_as_run(setup, live, suggested)


def test_inputs_that_are_no_reals(fmus):
    """Whole numbers and truth values are held, as in a scenario."""
    limits = {"real": 5, "int": 7, "bool": 1}
    axes = tuple(Axis(f"types.{kind}_in", limit, 1000.0) for kind, limit in limits.items())
    outs = ("types.real_out", "types.int_out", "types.bool_out", "types.real_in")
    setup = Setup(str(fmus["types"]), axes, outs)
    rng = np.random.default_rng(3)
    rows = np.column_stack([rng.normal(size=40), rng.integers(-7, 8, 40), rng.integers(0, 2, 40)])
    live = played(setup, 40, rows.__getitem__)
    assert len(np.unique(live["types.int_out"])) > 5
    same_as_run(setup, live)


def test_without_axes_and_without_signals(fmus):
    """A machine that is only watched, and one that is only driven."""
    setup = Setup(str(fmus["source"]), (), ("source.y",))
    live = played(setup, 10, lambda _: np.zeros(0))
    # one FMU without inputs: its output is the sine itself at the communication points
    np.testing.assert_allclose(live["source.y"], np.sin(live.time), atol=1e-12)
    unseen = Setup(str(fmus["drift"]), (Axis("u", 1, 1),), ())
    assert played(unseen, 3, lambda _: np.ones(1)).time[-1] == pytest.approx(0.03)


def test_units_of_axes_and_signals(drift):
    """As the FMUs declare them; what has none is not named."""
    live = FrameStepper(replace(drift, signals=("drift.y", "drift.u_rate")))
    live.close()
    assert live.units == {"u": "m", "drift.u_rate": "m/s"}


MISTAKES = {
    "axes: column 'w' is not an input of the system; inputs: u, u_rate": {"axes": (Axis("w", 1, 1),)},
    "unknown variable 'drift.z'; did you mean drift.y, drift.u, drift.u_rate?": {"signals": ("drift.z",)},
    "frame: expected a multiple of the step 0.003 s, got 0.01 s": {"step": 3e-3},
    "step: expected a positive time, got -1 s": {"step": -1.0},
    "step: expected at least 9.09e-15 s, got 1e-300 s": {"step": 1e-300},
    "step: expected at least 9.09e-15 s, got 9.99989e-321 s": {"step": 1e-320},
    "none.fmu: no such file": {"system": "none.fmu"},
    "fault u: expected an input that nobody drives here": {"fault": {"u": "1@1s"}},
}


@pytest.mark.parametrize("message", MISTAKES)
def test_mistakes_are_told_in_one_line(drift, message):
    """Names and times that do not fit."""
    assert problem(lambda: FrameStepper(replace(drift, **MISTAKES[message]))) == message


def test_an_input_takes_a_value_at_a_time(drift):
    """Behind the axes, within a frame: no motion before, and then as if an axis had been moved."""
    axis = Axis("u", 2.0, 1e3)
    with (
        closing(FrameStepper(replace(drift, axes=(), fault={"u": "1@0.04s"}))) as given,
        closing(FrameStepper(replace(drift, axes=(axis,)))) as moved,
    ):
        for k in range(8):
            given.advance(np.array([]))
            moved.advance(np.array([0.0 if k < 4 else 1.0]))
            assert given.values == pytest.approx(moved.values, rel=1e-9)
        assert given.values[0] != 0


def test_a_failing_fmu_tells_why_and_keeps_the_last_frame(failing):
    """The values of the frame before stay, and closing works."""
    live = FrameStepper(failing)
    for _ in range(19):
        live.advance(np.ones(1))
    before = live.t, live.values.copy()
    told = r"^fails: the step failed at t = 0\.195 s with status error; it says: .*broke"
    problem(lambda: live.advance(np.ones(1)), told)
    assert (live.t, live.values) == before
    live.close()
    live.close()


def test_a_long_session_needs_no_more_memory(drift):
    """Of Python's memory nothing is left of two thousand frames."""
    live, wanted = FrameStepper(drift), np.ones(1)
    for _ in range(300):  # more points than the recorder holds
        live.advance(wanted)
    gc.collect()
    tracemalloc.start()
    for _ in range(2000):
        live.advance(wanted)
    gc.collect()
    # other threads of the test process allocate too
    ours = tracemalloc.take_snapshot().filter_traces([tracemalloc.Filter(True, "*/orchestrator/*")])
    tracemalloc.stop()
    live.close()
    left = sum(line.size for line in ours.statistics("filename"))
    assert left < 2000  # one byte per frame: a few numbers that are the latest ones
