"""`batch`: results in lanes equal those of single runs, whatever the other machines do; mistakes."""

import re
from contextlib import nullcontext
from dataclasses import replace
from importlib import import_module
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from kit import shards
from kit.every import MACHINES
from kit.mistakes import problem, table
from kit.needs import needs
from zoo.faulty import MEMORY, faulty

from benchmarks import sweep
from orchestrator import Coupling, Interrupted, batch, load, run, with_swaps
from orchestrator.base.compiler import CompilerError
from orchestrator.base.errors import Problem
from orchestrator.base.files import Location, write_zip
from orchestrator.lanes import compiled, group
from orchestrator.lanes.compiled import NotInLanes, compiled_model, sources_of
from orchestrator.worker.process import CLOSED

# full strokes: cylinders hit their stops, chambers cavitate, and valves close fast
STROKES = {
    "time": [0.0, 0.3, 0.4, 2.2, 2.3, 4.0],
    "boom_command": [0.0, 0.0, -10.0, -10.0, 10.0, 10.0],
    "stick_command": [0.0, 0.0, 10.0, 10.0, -10.0, -10.0],
}
AXES = ("swing", "boom", "stick")
MASS, STIFFNESS = "manipulator.head_mass", "manipulator.stop_stiffness"
DEAD_BAND = "boom_stick.valve_dead_band"
MASSES = {MASS: np.linspace(300.0, 1200.0, 3)}
# Lanes take the inner steps of the scalar FMUs with other rounding, which stops and cavities amplify to 1e-11
# of the range; the tolerance of the FMUs is 1e-6
SAME = sweep.ROUNDING


@pytest.mark.parametrize("lanes", [True, False])
def test_an_interrupt_leaves_the_machines_that_are_complete(built, monkeypatch, lanes):
    """`result` of the exception has them, and the status of the others."""

    def interrupted(*_):
        raise KeyboardInterrupt

    batches = import_module("orchestrator.lanes.batch")
    monkeypatch.setattr(batches, "many", interrupted)
    with pytest.raises(Interrupted) as caught:
        batch(built / "harvester.ssp", MASSES, stop=0.01, record="manipulator.boom_angle", lanes=lanes)
    assert caught.value.result.status.tolist() == ["interrupted"] * 3


@pytest.mark.parametrize("lanes", [True, pytest.param(False, marks=shards.faults)])
def test_a_limit_of_time_ends_the_machines_that_are_not_done(built, lanes):
    """All of them together, with the reason; it is refused if it is not positive."""
    options = {"stop": 1e4, "record": "manipulator.boom_angle", "record_step": 10.0, "lanes": lanes}
    result = batch(built / "harvester.ssp", MASSES, **options, time_limit=0.3, workers=1)
    assert result.status.tolist() == ["failed"] * 3
    # in a step, before the first one, or, where FMUs are unpacked slowly, before the run
    assert re.search("not (done|begun) within 0.3 s", result.reasons[0])
    never = "time_limit: expected a positive number"
    problem(lambda: batch(built / "harvester.ssp", MASSES, **options, time_limit=0.0), never)


LOST = {"exec": CLOSED, "take": "uses more than 0.5 GB of memory", "sleep": "not done within 4 s"}


@needs("POSIX", "faults of POSIX")
@pytest.mark.parametrize("fault", shards.few(["exec"], LOST, shards.faults))
def test_a_machine_whose_process_is_lost_fails_alone(tmp_path, fault):
    """Also one that takes too much memory or never ends; `rate` 3 commits no fault."""
    fmu, rates = faulty(tmp_path, fault).fmu, {"lag.rate": [3.0, 1.0]}
    result = batch(fmu, rates, stop=1.0, step=0.01, workers=1, memory_limit=MEMORY, time_limit=4.0)
    assert result.status.tolist() == ["ok", "failed"]
    assert result.reasons[1].startswith(LOST[fault])
    assert f"in fmi2DoStep at t = 0.5 s of lag ({fmu})" in result.reasons[1]


def differences(system, result, scenario=None, machines=(0, -1), **options):
    """Largest root mean square difference to single runs over range or nominal value, by signal."""
    found = {}
    for machine in machines:
        given = {"set": {MASS: float(MASSES[MASS][machine])}, "record": [*result.signals]}
        single = run(system, scenario, isolate=False, **given, **options).trace
        np.testing.assert_array_equal(single.time, result.time)
        for name, values in result.signals.items():
            size = max(np.ptp(single[name]), abs(system.variable(system.port(name)).nominal or 1.0))
            error = np.sqrt(np.mean((values[machine] - single[name]) ** 2)) / size
            found[name] = max(error, found.get(name, 0.0))
    return found


@table(__file__, "masters", "coupling, options")
def test_machines_in_lanes_have_the_results_of_single_runs(system, coupling, options):
    """Every output at every point, by each master, through stops, cavities and closed valves."""
    options = options | ({"master": Coupling(**coupling)} if coupling else {})
    result = batch(system, MASSES, STROKES, stop=2.5, lanes=True, **options)
    assert set(result.status) == {"ok"}
    assert max(differences(system, result, STROKES, stop=2.5, **options).values()) < SAME
    assert result["boom_stick.boom_rod_pressure"].min() < 0.0  # a cavity, relative to the atmosphere
    assert np.abs(result["manipulator.boom_stop_force"]).max() > 1e4  # [N]


# slopes from rate outputs, from FMUs and by differences; steps that are repeated, and divided
QUICK = ["jacobi, order 1", "gauss-seidel, guarded", "gauss-seidel, order 3", "hermite, 2 passes", "hermite"]
CASES = product(range(3), range(len(MACHINES)), sweep.COUPLINGS)


@pytest.mark.parametrize(
    ("seed", "swaps", "how"), shards.few([(1, 0, how) for how in QUICK], CASES, shards.search)
)
def test_a_random_machine_moves_in_lanes_as_in_a_run(system, seed, swaps, how):
    """With corners between the steps; benchmarks/sweep.py has the two bars and their reasons."""
    random = np.random.default_rng(seed)
    scenario = {"time": [0.0, *np.sort(random.uniform(0.01, 0.39, 4))]}
    scenario |= {f"{axis}_command": [0.0, *random.uniform(-8.0, 8.0, 4)] for axis in AXES}
    mass = float(random.uniform(100.0, 2000.0))
    swapped = with_swaps(system, MACHINES[swaps])
    machine = sweep.Machine(swapped, *sweep.COUPLINGS[how], mass, scenario, stop=0.4)
    check(machine)


def check(machine):
    """It ends in lanes as in a run, and its signals are within the bars."""
    lanes = machine.lanes()
    if lanes.status == ["failed"]:  # this master cannot couple this machine
        with pytest.raises(Problem):
            machine.run()
        return
    single = machine.run()
    distance = machine.distance(lanes.trace(0), single)
    if distance > sweep.ROUNDING:
        assert distance < sweep.TIMES * machine.changed(single)


@shards.machine
def test_a_slope_that_no_model_gives_follows_from_values_as_in_a_run(system):
    """With open rate ports, of outputs that depend on held inputs; the adaptive steps depend on it."""
    swapped, rates = with_swaps(system, {"supply": "load_sensing"}), {*system.rate_ports.values()}
    opened = replace(swapped, connections=tuple(c for c in swapped.connections if c.target not in rates))
    levers = {"time": [0.0, 0.05, 0.2], "boom_command": [0.0, 0.0, 2.0], "stick_command": [0.0, 0.0, 2.0]}
    machine = sweep.Machine(opened, Coupling("gauss-seidel", adaptive=1e-2), None, 500.0, levers, stop=0.2)
    assert machine.distance(machine.lanes().trace(0), machine.run()) < sweep.ROUNDING


COUPLINGS = {
    "parallel": (Coupling("jacobi", order=1), 5e-4),
    "guarded": (Coupling("gauss-seidel", order=2, guard=0.01), 4e-3),
    "repeated": (Coupling("hermite", guard=0.0), 5e-3),
    "repeated and guarded": (Coupling("hermite"), 5e-3),
    "adaptive": (Coupling("hermite", adaptive=1e-3), None),
    "accurate": (Coupling("hermite", adaptive=1e-5), None),
}


@pytest.mark.parametrize("how", shards.few(["repeated and guarded"], COUPLINGS, shards.machine))
@given(
    lane=st.integers(0, 7),
    masses=st.lists(st.floats(100.0, 3000.0), min_size=8, max_size=8),
    bands=st.lists(st.floats(0.1, 2.0), min_size=8, max_size=8),
)
@settings(max_examples=2, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_a_machine_has_the_same_bits_beside_any_neighbours(system, how, lane, masses, bands):
    """In any lane, whatever steps the others take, and in whatever pieces of the opening curve they are."""
    coupling, step = COUPLINGS[how]
    options = {"stop": 0.8, "record_step": 0.02, "lanes": True, "master": coupling, "step": step}
    masses[lane], bands[lane] = 350.0, 0.5
    alone = batch(system, {MASS: [350.0], DEAD_BAND: [0.5]}, STROKES, **options)
    beside = batch(system, {MASS: masses, DEAD_BAND: bands}, STROKES, **options)
    for name, values in alone.signals.items():
        np.testing.assert_array_equal(beside[name][lane], values[0], err_msg=name)


@pytest.mark.parametrize("how", shards.few(["guarded", "repeated"], COUPLINGS, shards.machine))
def test_a_machine_that_fails_does_not_change_the_others(system, how):
    """It is in the first lane, whose time is that of all machines with equal steps."""
    coupling, step = COUPLINGS[how]
    options = {"stop": 2.5, "record_step": 0.02, "lanes": True, "master": coupling, "step": step}
    alone = batch(system, {STIFFNESS: [2e7]}, STROKES, **options)
    beside = batch(system, {STIFFNESS: [1e5, 2e7, 2e7]}, STROKES, **options)
    assert beside.status.tolist() == ["failed", "ok", "ok"]
    for name, values in alone.signals.items():
        np.testing.assert_array_equal(beside[name][1:], values[[0, 0]], err_msg=name)


@shards.machine
@pytest.mark.parametrize("variants", range(4))
def test_every_variant_runs_in_lanes(system, variants):
    """All variants of all parts, four combinations in which each occurs, over both work cycle and strokes."""
    names = {
        "swing": ("lumped", "quasistatic", "detailed", "compensated"),
        "boom_stick": ("quasistatic", "detailed", "compensated", "lumped"),
        "manipulator": ("friction", "pendulum", "pendulum_friction", "rigid"),
        "supply": ("load_sensing", "ideal", "engine_pump", "load_sensing"),
    }
    swapped = with_swaps(system, {part: options[variants] for part, options in names.items()})
    for scenario, mass in product((None, STROKES), (300.0, 1200.0)):
        check(sweep.Machine(swapped, None, None, mass, scenario, stop=4.0))


@pytest.mark.parametrize(
    "changed", ["sources/model.c.inc", "sources/opening_curve.h", "modelDescription.xml"]
)
def test_only_code_that_this_installation_has_generated_runs_in_lanes(system, tmp_path, changed):
    """Lanes are in the process of the caller; another page of documentation changes no code."""
    component = system.components["swing"]
    content = {name: component.source.member(name).read() for name in component.source.names()}
    page = "documentation/index.html"
    for file in (page, changed):
        write_zip(tmp_path / f"{len(file)}.fmu", content | {file: content[file] + b"\n"})
    same, other = (replace(component, source=Location(tmp_path / f"{len(f)}.fmu")) for f in (page, changed))
    assert sources_of(same) == sources_of(component)
    with pytest.raises(NotInLanes, match=r"swing \(.*\): expected an FMU that this installation"):
        sources_of(other)
    stops = replace(component, interface=replace(component.interface, event_mode=True))
    with pytest.raises(NotInLanes, match=r"swing \(.*\): the FMU has events"):
        compiled_model(stops)


def test_the_fmus_of_fmi_3_run_in_lanes(fmi3_dir):
    """The sources of both versions are the same, and so are the results."""
    system = load(fmi3_dir / "harvester.ssp")
    result = batch(system, MASSES, stop=1.0, lanes=True)
    assert max(differences(system, result, stop=1.0).values()) < SAME


@pytest.mark.parametrize(
    ("name", "output"),
    [
        ("manipulator", "boom_holding_force"),
        pytest.param("harvester", "boom_angle", marks=shards.machine),  # 12 s to compile
    ],
)
def test_a_single_fmu_runs_in_lanes(fmu_dir, name, output):
    """A system of one component, without connections; the whole machine in one FMU is one, too."""
    system, mass, shown = load(fmu_dir / f"{name}.fmu"), f"{name}.head_mass", f"{name}.{output}"
    options = {"stop": 1.0, "record": [shown]}
    result = batch(system, {mass: [300.0, 400.0]}, lanes=True, **options)
    single = run(system, set={mass: 400.0}, isolate=False, **options).trace
    np.testing.assert_allclose(result[shown][1], single[shown], rtol=1e-9)
    assert not np.array_equal(*result[shown])


@pytest.mark.parametrize("lanes", [True, False])
def test_a_machine_that_fails_does_not_stop_the_others(system, lanes):
    """Its signals end, the reason names the requirement, and the others run on."""
    stiffness = {"manipulator.stop_stiffness": [2e7, 1e5, 2e7]}  # [N/m]: the piston leaves the cylinder
    options = {"scenario": STROKES, "stop": 2.0, "record": ["manipulator.boom_angle"], "lanes": lanes}
    result = batch(system, stiffness, **options)
    assert list(result.status) == ["ok", "failed", "ok"]
    told = "head chamber of the boom cylinder has a positive volume at boom_position"
    assert f'requirement "{told}" is violated at t = 1.333 s' in result.reasons[1]
    assert result.reasons[1].startswith("boom_stick: ")
    assert result.reasons[0] == ""
    angle = result["manipulator.boom_angle"]
    finite = np.isfinite(angle)
    assert finite[[0, 2]].all()
    np.testing.assert_array_equal(finite[1], result.time < 1.3325)  # up to 1.332 s
    assert result.trace(1).time[-1] == pytest.approx(1.332)
    np.testing.assert_array_equal(angle[0], angle[2])


def test_a_start_that_violates_a_requirement_fails_at_once(system):
    """No point is recorded."""
    angles = {"manipulator.initial_boom_angle": [0.4, 3.0]}
    result = batch(system, angles, stop=0.1, record=["manipulator.boom_angle"])
    assert list(result.status) == ["ok", "failed"]
    assert "at t = 0 s" in result.reasons[1]
    assert np.isnan(result["manipulator.boom_angle"][1]).all()


def test_a_tighter_tolerance_is_passed_to_the_models(system):
    """As `tolerance` of a run."""
    result = batch(system, MASSES, STROKES, stop=1.0, lanes=True, tolerance=1e-8)
    assert max(differences(system, result, STROKES, stop=1.0, tolerance=1e-8).values()) < SAME
    coarse = batch(system, MASSES, STROKES, stop=1.0, lanes=True)
    name = "boom_stick.boom_head_pressure"
    assert 0 < np.abs(result[name] - coarse[name]).max() < 1e-4 * np.ptp(result[name])


def test_without_a_compiler_the_machines_run_one_by_one(system, monkeypatch):
    """With a note that says how to install it, and the same results."""

    def missing(*_, **__):
        raise CompilerError("no C compiler: the package ziglang is not installed")

    monkeypatch.setattr(compiled, "shared_library", missing)
    result = batch(system, MASSES, stop=0.2)
    (note,) = [note for note in result.notes if "one by one" in note]
    assert note.endswith("no C compiler: the package ziglang is not installed")
    assert max(differences(system, result, stop=0.2).values()) == 0.0


def test_a_line_announces_a_compilation(system, monkeypatch):
    """Once for all FMUs, and not if the libraries are in the cache."""
    lines, shared_library = [], compiled.shared_library

    def announced(text):
        lines.append(text)
        return nullcontext()

    def anew(*library, begin):
        if begin:
            begin()
        return shared_library(*library)

    batch(system, MASSES, stop=0.01, lanes=True)
    monkeypatch.setattr(group, "doing", announced)
    batch(system, MASSES, stop=0.01, lanes=True)
    assert lines == []
    monkeypatch.setattr(compiled, "shared_library", anew)
    batch(system, MASSES, stop=0.01, lanes=True)
    assert lines == [group.COMPILING]


# ---- other FMUs, one by one


def test_other_fmus_run_one_by_one(fmus):
    """Any FMU, with a note why."""
    values = {"gain.factor": [1.0, 2.0, 3.0], "gain.u": [1.0, 2.0, 4.0]}
    result = batch(fmus["gain"], values, stop=0.1, step=0.01)
    np.testing.assert_array_equal(result["gain.y"], [[1.0] * 11, [4.0] * 11, [12.0] * 11])
    assert any("one by one: gain" in note and "no C sources" in note for note in result.notes)
    with pytest.raises(NotInLanes, match="no C sources"):
        batch(fmus["gain"], {"gain.factor": [1.0]}, stop=0.1, step=0.01, lanes=True)


@table(__file__, "crashes", "how, status, told")
def test_a_crash_ends_only_its_machine(fmus, how, status, told):
    """An error status, an FMU that asks for the end, a crash of its process: the others run on.

    It keeps the points before.
    """
    values = {"fails.how": [0, how, 0], "fails.when": [0.05] * 3}
    result = batch(fmus["fails"], values, stop=0.1, step=0.01, record=["fails.y"])
    assert list(result.status) == ["ok", status, "ok"]
    assert told in result.reasons[1]
    finite = np.isfinite(result["fails.y"])
    assert finite[[0, 2]].all()
    assert finite[1, :5].all()
    assert not finite[1, 7:].any()


# ---- mistakes


@table(__file__, "mistakes", "parameters, options, message")
def test_a_mistake_is_told_in_one_line(system, parameters, options, message):
    """The line names the parameter, what was expected, and what was found."""
    assert message in problem(lambda: batch(system, parameters, **{"stop": 0.1, **options}))


@pytest.mark.parametrize("lanes", [True, False])
def test_nothing_has_to_be_recorded(system, lanes):
    """Then the status of each machine is the result."""
    result = batch(system, MASSES, stop=0.01, record=[], lanes=lanes, workers=1)
    assert result.status.tolist() == ["ok"] * 3
    assert not result.signals


def test_a_record_that_is_too_large_or_has_no_step_is_refused(system):
    """Signals of a thousand machines over hours, and adaptive steps, which are not common to all machines."""
    message = problem(lambda: batch(system, {MASS: [300.0] * 1000}, stop=1e6))
    assert "signals of 1000 machines " in message
    assert "choose fewer signals by record or a longer record_step" in message
    free = Coupling("hermite", adaptive=1e-3)
    message = problem(lambda: batch(system, {MASS: [300.0]}, stop=0.1, master=free))
    assert "expected a record step for adaptive steps" in message


def test_what_lanes_lack_is_told(system):
    """In one line."""
    with pytest.raises(NotInLanes, match="the master interface-jacobian"):
        batch(system, MASSES, stop=0.1, master="interface-jacobian", lanes=True)


def test_the_documented_example_runs(fmu_dir, monkeypatch, capsys):
    """The lines in the docstring of `batch`."""
    monkeypatch.chdir(fmu_dir.parent)
    example = batch.__doc__.split("mistake.\n")[1].partition("Options:")[0]
    lines = [line.strip() for line in example.splitlines() if line.strip()]
    code = "\n".join(lines).replace("build/", f"{fmu_dir.name}/").replace("stop=10.0", "stop=0.1")
    exec(code, {})
    assert len(capsys.readouterr().out.split()) == 3


@needs("Linux", "reads the flags of its kernel")
@needs("x86-64")
def test_code_is_compiled_for_the_best_level_that_the_processor_has(monkeypatch):
    """By the flags of the kernel; no level of x86-64 on another processor."""
    flags = set(re.search(r"flags\s*:(.*)", Path("/proc/cpuinfo").read_text())[1].split())
    wide = {f"avx512{x}" for x in ("f", "cd", "vl", "bw", "dq")}
    levels = {"x86_64_v4": wide, "x86_64_v3": {"avx2", "fma"}}
    best = next((level for level, needed in levels.items() if needed <= flags), "baseline")
    assert compiled.processor() == best
    monkeypatch.setattr(compiled, "host", lambda: "aarch64-linux")
    assert compiled.processor.__wrapped__() == "baseline"
