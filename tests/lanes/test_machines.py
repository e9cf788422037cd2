"""`Machines`: steps with commands for each machine equal single runs, and machines start again one by one."""

import numpy as np
import pytest

from orchestrator import Problem, run
from orchestrator.lanes.compiled import NotInLanes
from orchestrator.lanes.machines import Machines

COMMANDS = ["boom_command", "stick_command"]
SIGNALS = ["manipulator.boom_angle", "manipulator.tip_height", "boom_stick.boom_head_pressure"]
HEAD = "manipulator.head_mass"
STEPS, PERIOD = 50, 0.05  # communication steps and time [s] over which commands are held


@pytest.fixture
def machines(system):
    """Eleven, in two groups."""
    machines = Machines(system, 11, COMMANDS, SIGNALS)
    yield machines
    machines.close()


@pytest.mark.parametrize(("step", "error"), [(1e-3, 5e-4), (2e-4, 5e-5)])
def test_held_commands_give_the_results_of_a_run(system, step, error):
    """Against hermite: the error is that of the coupling, 3e-4 at 1 ms, of order 2.

    The run has ramps of 1 ns in place of the jumps. In 100 ns the flow would stop while the valve is closed.
    """
    table = np.random.default_rng(4).uniform(-4, 4, (6, 9, 2))
    machines = Machines(system, 9, COMMANDS, SIGNALS, step=step)
    found = np.array([machines.start(), *(machines.advance(row, round(PERIOD / step)) for row in table)])
    machines.close()
    jumps = PERIOD * np.arange(1, 6)
    times = [0.0, *np.ravel(np.stack([jumps, jumps + 1e-9], axis=1)), 6 * PERIOD]
    for machine in (0, 8):
        held = np.repeat(table[:, machine], 2, axis=0)
        scenario = {"time": times, **dict(zip(COMMANDS, held.T, strict=True))}
        options = {"master": "hermite", "step": 1e-3, "stop": 6 * PERIOD, "record_step": PERIOD}
        trace = run(system, scenario, record=SIGNALS, isolate=False, **options).trace
        for k, name in enumerate(SIGNALS):
            allowed = error * np.ptp(trace[name])
            np.testing.assert_allclose(found[:, machine, k], trace[name], rtol=0, atol=allowed)


def test_machines_start_again_without_the_others(machines):
    """A machine that has started again does what it did at first, and the others go on."""
    rng = np.random.default_rng(5)
    values = {HEAD: rng.uniform(300, 600, 11), "manipulator.initial_boom_angle": rng.uniform(0.2, 0.6, 11)}
    table = rng.uniform(-8, 8, (4, 11, 2))
    start = machines.start(values)
    first = [machines.advance(row, STEPS) for row in table]
    machines.start(values)
    chosen = np.arange(11) % 3 == 0
    for row in table[:2]:
        machines.advance(row, STEPS)
    again = machines.start(values, chosen)
    # the times of the steps are rounded elsewhere, which changes the last digits
    np.testing.assert_allclose(again, np.where(chosen[:, None], start, first[1]), rtol=1e-9)
    for n in range(2):
        found = machines.advance(np.where(chosen[:, None], table[n], table[n + 2]), STEPS)
        np.testing.assert_allclose(found, np.where(chosen[:, None], first[n], first[n + 2]), rtol=1e-9)


def test_a_machine_that_fails_starts_again(system):
    """Its signals are NaN until then, with a reason; the others are not affected."""
    machines = Machines(system, 3, COMMANDS, SIGNALS)
    weak = {"manipulator.stop_stiffness": [2e7, 1e5, 2e7]}  # [N/m]
    machines.start(weak)
    down = np.tile([-10.0, 0.0], (3, 1))
    found = machines.advance(down, 2000)
    assert np.isnan(found[1]).all()
    assert np.isfinite(found[[0, 2]]).all()
    assert "the boom cylinder has a positive volume" in machines.reasons[1]
    assert [machines.reasons[0], machines.reasons[2]] == ["", ""]
    machines.start(weak, [False, True, False])
    assert machines.reasons == ["", "", ""]
    assert np.isfinite(machines.advance(down, 10)).all()
    machines.close()


@pytest.mark.parametrize(
    ("call", "told"),
    [
        (lambda m: m.advance(np.zeros((11, 3))), r"commands: expected the shape \(11, 2\), got \(11, 3\)"),
        (lambda m: m.start(machines=[True]), r"machines: expected the shape \(11,\), got \(1,\)"),
        (lambda m: m.start({HEAD: [300.0]}), f"values: {HEAD}: expected 11 values, got 1"),
        (lambda m: m.start({"boom_command": np.zeros(11)}), "the scenario drives boom_stick.boom_command"),
    ],
)
def test_a_mistake_is_told_in_one_line(machines, call, told):
    """The line names what was expected and what was found."""
    with pytest.raises(Problem, match=told):
        call(machines)


@pytest.mark.parametrize("boom", [np.full(11, np.nan), np.r_[np.nan, 1e308, np.full(9, 5.0)]])
def test_a_command_that_is_no_number_ends_its_machine(machines, boom):
    """With the reason, and beside any other command: the opening curve has no piece for it."""
    machines.advance(np.column_stack([boom, np.zeros(11)]), STEPS)
    failed = [bool(reason) for reason in machines.reasons]
    assert np.array(failed)[np.isnan(boom)].all()
    assert not np.array(failed)[boom == 5.0].any()
    assert machines.reasons[0].startswith("boom_stick: ")


def test_other_fmus_are_refused(fmus, system):
    """Their machines cannot be stepped in lanes; and a machine needs a command."""
    with pytest.raises(NotInLanes, match="no C sources"):
        Machines(fmus["gain"], 2, ["gain.u"], ["gain.y"])
    with pytest.raises(Problem, match="at least one machine, command and signal, got 2 machines, 0 commands"):
        Machines(system, 2, [], SIGNALS)
