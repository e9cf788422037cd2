"""The load-sensing machine at full levers: right at the default, and told where it is not."""

from contextlib import closing

import numpy as np
import pytest
from kit import shards
from whole_machine.test_guard import off

from fmus.machine.parts import FAMILIES
from fmus.parameters import values
from fmus.supply import rail
from orchestrator import Coupling, Trace, batch, run
from orchestrator.base.options import chosen
from orchestrator.data.trace_writer import write_trace
from orchestrator.engine.job import Job
from orchestrator.engine.options import RunOptions
from orchestrator.lanes.environment import MachinesEnv
from orchestrator.lanes.group import Group, Lanes
from orchestrator.realtime.setup import Axis, Setup
from orchestrator.realtime.stepping import FrameStepper
from orchestrator.ssp.coupling import CouplingOptions
from orchestrator.ssp.swap import with_swaps
from orchestrator.ssp.write import write_ssp
from orchestrator.studies import Choice, Output, Study, sweep

TODAY = {"swing": "compensated", "boom_stick": "compensated", "supply": "load_sensing"}
LEVERS = {"boom_command": 10.0, "stick_command": -10.0, "swing_command": 10.0}  # [V]
FULL = {"time": [0.0, 0.2, 0.5, 1.2]} | {name: [0.0, 0.0, v, v] for name, v in LEVERS.items()}
SPEEDS = [f"manipulator.{name}" for name in ("boom_velocity", "stick_velocity", "swing_speed")]
FLOWS = ["supply.pump_flow", "supply.supply_flow", "supply.rail_leakage_flow", "supply.relief_flow"]
OPTIONS = {"stop": 1.2, "record": [*SPEEDS, *FLOWS], "record_step": 0.01}
RAW = CouplingOptions(
    guard=0.0
)  # without the guard that follows from the suggested step: a spurious steady state


@pytest.fixture(scope="module")
def today(system):
    """The machine of today."""
    return with_swaps(system, TODAY)


def in_lanes(machine, lanes, numbers, **options):
    """A group of machines with full levers after its run; `numbers` by port."""
    job = Job.of(machine, FULL, chosen(RunOptions, {**options, "record": SPEEDS}, "run"))
    group = Group(Lanes(job, [job.system.port(name) for name in SPEEDS]))
    rows = [np.full((lanes, job.times.rows), np.nan) for _ in SPEEDS]
    group.run(0, {job.system.port(name): np.array(v) for name, v in numbers.items()}, rows, lanes)
    return group


def test_the_default_moves_as_the_reference(today):
    """Three levers at full within 0.3 s. Without the guard the boom has half of its speed."""
    truth = run(today, FULL, master="hermite", step=2.5e-4, **OPTIONS)
    found, raw = run(today, FULL, **OPTIONS), run(today, FULL, guard=RAW.guard, **OPTIONS)
    pump, *taken = (float(np.mean(found[name][50:])) for name in FLOWS)
    # the bar of the machine at full levers; measured 0.3 %
    assert pump == pytest.approx(sum(taken), rel=0.01)
    assert max(off(found, truth, name) for name in SPEEDS) < 0.01
    assert found.reliable
    assert not raw.reliable
    assert abs(raw[SPEEDS[0]][-1] / truth[SPEEDS[0]][-1] - 1.0) > 0.1


@pytest.mark.parametrize("drives", ["lumped", "quasistatic", "detailed", "compensated"])
@pytest.mark.parametrize("supply", ["engine_pump", "load_sensing"])
@pytest.mark.parametrize("pose", ["nominal", "reach", "raised", "close"])
@shards.machine
def test_each_drive_and_supply_moves_as_the_reference(system, drives, supply, pose):
    """At the default, within 1 % of range; benchmarks/full_levers.py has all ramps and levers."""
    machine = with_swaps(system, {"swing": drives, "boom_stick": drives, "supply": supply})
    options = {"stop": 1.2, "record": SPEEDS, "record_step": 0.01, "parameters": [pose]}
    truth = run(machine, FULL, master="hermite", step=2.5e-4, **options)
    found = run(machine, FULL, **options)
    assert found.reliable
    assert max(off(found, truth, name) for name in SPEEDS) < 0.01


def test_the_suggested_step_follows_from_the_supply_line():
    """A third of the time constant C / (dQ/dP) with three sections saturated at full opening.

    A saturated section is an edge: Q = k sqrt(dp), dQ/dP = Q / (2 dp). Three sections at 300 L/min together
    with a drop of 1 MPa, which is what the pump leaves of its margin of 2 MPa at full stroke.
    """
    supply = FAMILIES["supply"]["load_sensing"]
    p = values(supply).p
    conductance = (300.0 / 60e3) / (2 * 1e6)  # [m3/(s.Pa)]
    time_constant = p["rail_capacitance"] / conductance
    assert time_constant == pytest.approx(0.8e-3, rel=0.02)  # by hand
    assert time_constant / 4 < supply.step == rail.STEP < time_constant / 2  # Heun's limit is 2


def test_machines_in_lanes_have_a_status_of_their_own(system):
    """The energies of `run`, so the same reasons; steps of 40 ms are too long for any machine."""
    options = {"stop": 1.2, "record": SPEEDS, "record_step": 0.04}
    coarse = options | {"step": 0.04, "master": Coupling("gauss-seidel", guard=0.0)}
    single = run(system, FULL, **coarse)
    result = batch(system, {"manipulator.head_mass": [350.0, 400.0]}, FULL, lanes=True, **coarse)
    assert result.status.tolist() == ["unreliable"] * 2
    assert result.reasons[0].split(": ")[0] == single.card.unreliable[0].split(": ")[0]
    assert result.notes[0].startswith("2 of 2 machines: energy error of the coupling")
    usual = batch(system, {"manipulator.head_mass": [350.0]}, FULL, lanes=True, **options)
    assert usual.status.tolist() == ["ok"]


# the libraries for the machine of today take 20 s to compile
TODAYS = (pytest.param(TODAY, master, marks=shards.machine) for master in ("gauss-seidel", "jacobi"))


@pytest.mark.parametrize(("swap", "master"), [({}, "gauss-seidel"), *TODAYS])
def test_energies_in_lanes_are_those_of_a_run(system, swap, master):
    """Each bond of an unguarded run, to rounding."""
    machine = with_swaps(system, swap)
    options = {"stop": 0.5, "record_step": 0.01, "master": master, "guard": RAW.guard}
    single = run(machine, FULL, record=SPEEDS, **options)
    energies = in_lanes(machine, 1, {}, **options).energies(0)
    for bond, other in zip(single.card.bonds, energies, strict=True):
        # other inner steps of the FMUs: 1e-8 of what is exchanged
        assert other.residual == pytest.approx(bond.residual, abs=1e-8 * bond.exchanged), bond.name
        assert other.turnover == pytest.approx(bond.turnover, abs=1e-8 * bond.exchanged), bond.name
        assert other.exchanged == pytest.approx(bond.exchanged, rel=1e-8), bond.name


@shards.machine
def test_energies_of_machines_with_steps_of_their_own_are_those_of_runs(today):
    """The guard divides the steps of two machines at different times; a machine that waits adds nothing."""
    options = {"stop": 0.7, "record_step": 0.01}
    masses = [300.0, 330.0]
    group = in_lanes(today, 2, {"manipulator.head_mass": masses}, **options)
    for lane, mass in enumerate(masses):
        single = run(today, FULL, record=SPEEDS, set={"manipulator.head_mass": mass}, **options)
        for bond, other in zip(single.card.bonds, group.energies(lane), strict=True):
            # rounding decides where a step is divided: 1e-12 of the mass changes 3e-5 of what is exchanged
            assert other.residual == pytest.approx(bond.residual, abs=1e-3 * bond.exchanged), bond.name
            assert other.exchanged == pytest.approx(bond.exchanged, rel=1e-3), bond.name


@shards.machine
def test_an_environment_tells_and_truncates(today):
    """In `info`, for the machines with full levers only; by option the episode ends. A start forgets it."""
    limits = {name: (-10.0, 10.0) for name in LEVERS}
    full, rest = np.array(list(LEVERS.values())), np.zeros(3)

    def environment(**options):
        return MachinesEnv(today, 2, limits, SPEEDS, lambda o, _: o[:, 0], interval=0.25, **options)

    for truncate in (False, True):
        env = environment(truncate_unreliable=truncate, guard=RAW.guard)
        env.reset(seed=1)
        for _ in range(3):
            *_, truncated, info = env.step(np.stack([full, rest]))
            if "unreliable" in info:
                break
        assert info["unreliable"].tolist() == info["_reason"].tolist() == [True, False]
        assert "not reliable" in info["reason"][0]
        assert truncated.tolist() == [truncate, False]
        if truncate:
            assert env.step(np.stack([rest, rest]))[4] == {}
        env.close()
    env = environment()
    env.reset(seed=1)
    assert all(env.step(np.stack([full, rest]))[4] == {} for _ in range(3))
    env.close()


@shards.machine
def test_a_study_counts_it_as_not_valid(today, tmp_path):
    """A column and a status of its own; single runs and lanes say the same."""
    file = write_ssp(today.coupled(RAW), tmp_path / "today.ssp")
    scenarios = [tmp_path / "still.csv", tmp_path / "full.csv"]
    for scenario, share in zip(scenarios, (0.0, 1.0), strict=True):
        levers = {name: [share * v for v in FULL[name]] for name in LEVERS}
        write_trace(Trace(np.array(FULL["time"]), {n: np.array(v) for n, v in levers.items()}), scenario)
    choice, output = Choice("scenario", tuple(map(str, scenarios))), Output("boom", SPEEDS[0], "maximum")
    study = Study("Full", str(file), method="grid", stop=1.2, choices=(choice,), outputs=(output,))
    results = sweep(study, tmp_path / "out", workers=1)
    assert results.table["status"].tolist() == ["ok", "unreliable"]
    errors = results.table["energy_error"].tolist()
    assert errors[0] < 0.05 < errors[1]


@shards.machine
def test_the_live_machine_says_it_while_it_lasts(today, tmp_path):
    """Within a second of full levers, with the bond; it is over when the energies before have faded."""
    file = write_ssp(today.coupled(RAW), tmp_path / "today.ssp")
    axes = tuple(Axis(name, 10.0, 40.0) for name in LEVERS)
    full, rest = np.array(list(LEVERS.values())), np.zeros(3)
    with closing(FrameStepper(Setup(file, axes, ("supply.pump_flow",)))) as live:
        assert not live.unreliable
        for n in range(60):
            live.advance(min(n / 25, 1.0) * full)
        assert live.unreliable.startswith("energy error of the coupling above 5% of what boom_stick - supply")
        for n in range(600):
            live.advance(max(1.0 - n / 25, 0.0) * full + rest)
        assert not live.unreliable
