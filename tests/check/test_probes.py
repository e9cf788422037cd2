"""Probes of `harvester check`: each planted fault is found by its probe; valid FMUs have no findings."""

import zipfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from kit import shards
from kit.any_fmu.description import packed
from kit.any_fmu.models import ticking_fmu
from kit.mistakes import entry

from orchestrator.check.finding import Finding
from orchestrator.check.probe_process import ProbeLimits, probe_limits, use_probe_limits
from orchestrator.check.probes import PROBES
from orchestrator.check.subject import Subject, parse_unpacked
from orchestrator.check.tasks import importing_solver, leaks
from orchestrator.check.tasks.derivatives import ShiftedPoint
from orchestrator.check.tasks.runner import Trial
from orchestrator.check.tasks.trial_run import severity
from orchestrator.fmi.instance import CallFailed
from orchestrator.worker.calls import share_activity

RULES = {rule.id.removeprefix("run."): rule for rule in PROBES}


PLANTED = entry(__file__, "planted")
# quick: the first of each probe
QUICK = {id(next(row for row in PLANTED if row[0] == probe)) for probe, _, _ in PLANTED}


@pytest.fixture(autouse=True)
def _short() -> Iterator[None]:
    """Limits for a busy machine: two seconds of work per probe, and a minute until a call is a hang."""
    with use_probe_limits(ProbeLimits(call_time=60.0, total_time=300.0, work_time=2.0)):
        yield


def opened(path: Path, folder: Path) -> Subject:
    """An FMU for the probes."""
    with zipfile.ZipFile(path) as archive:
        archive.extractall(folder)
    return parse_unpacked(path, folder)


def apply(path: Path, folder: Path, *probes: str) -> list[Finding]:
    """Findings of some probes on an FMU; without names, of all probes."""
    subject = opened(path, folder)
    return [found for name in probes or RULES for found in RULES[name](subject)]


@pytest.mark.parametrize(
    ("probe", "text", "more"),
    [
        pytest.param(
            *row,
            marks=[] if id(row) in QUICK else shards.faults,
            id=f"{row[2].get('fault', 'text')}-{row[0]}-{row[2].get('major', 2)}",
        )
        for row in PLANTED
    ],
)
def test_a_planted_fault_is_found_by_its_probe(oscillators, tmp_path, probe, text, more):
    """One finding has the right severity, and a message with the fault and the call."""
    fault, grave = more.get("fault", "none"), more.get("severity", "error")
    path = oscillators.make(more.get("major", 2), fault, more.get("change", ("", "")))
    call_time = 2.0 if fault == "hang" else probe_limits().call_time
    with use_probe_limits(replace(probe_limits(), call_time=call_time)):
        found = apply(path, tmp_path, probe)
    assert any(text in f.text and f.severity == grave for f in found), found
    assert all(f.rule == f"run.{probe}" for f in found)


CLOCKED = [
    'intervalVariability="constant" intervalDecimal="0.1"',
    'intervalVariability="tunable" supportsFraction="true"',
    'intervalVariability="countdown"',
]


@pytest.mark.parametrize("interval", CLOCKED)
def test_an_fmu_with_clocks_is_run_in_event_mode(tmp_path, interval):
    """It is instantiated as in a run; its clocks tick, also from a state that another process has saved."""
    found = apply(
        ticking_fmu(tmp_path / "unit.fmu", interval), tmp_path, "default", "state", "serialize", "drift"
    )
    assert not found


def test_outputs_of_clocks_are_read_at_their_ticks(tmp_path):
    """This FMU declares another clock than the one with which `got` can be read."""
    got = 'valueReference="11" causality="output" clocks="{}"'
    wrong = {got.format(3): got.format(1)}
    found = apply(ticking_fmu(tmp_path / "unit.fmu", CLOCKED[0], **wrong), tmp_path, "default")
    assert "fmi3GetInt32 failed" in found[0].text


def test_an_fmu_that_needs_event_mode_without_clocks_gets_it(tmp_path):
    """It refuses to be instantiated otherwise."""
    unit = ticking_fmu(tmp_path / "unit.fmu", CLOCKED[0])
    with zipfile.ZipFile(unit) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    text = members["modelDescription.xml"].decode()
    head, rest = text.split("<ModelVariables>")
    noted = [line for line in rest.splitlines() if 'name="note"' in line or 'name="noted"' in line]
    structure = '<ModelStructure><Output valueReference="16"/></ModelStructure></fmiModelDescription>'
    text = f"{head}<ModelVariables>{''.join(noted)}</ModelVariables>{structure}"
    plain = packed(tmp_path / "plain.fmu", {**members, "modelDescription.xml": text})
    assert not apply(plain, tmp_path / "plain", "default")


@shards.faults
def test_a_probe_that_takes_too_long_is_stopped(oscillators, tmp_path):
    """The message contains the last call, also if no single call took long enough to be a hang."""
    for probe in (1.0, 4.0, 16.0, 64.0):
        with use_probe_limits(ProbeLimits(call_time=1000.0, total_time=probe, work_time=2.0)):
            found = apply(oscillators.make(fault="hang"), tmp_path / f"{probe:g}", "default")
        if any(f.text.endswith("at t = 0.31 s") for f in found):
            break  # else the machine is so slow that the FMU did not come so far
    text = f"co-simulation: not done within {probe:g} s, stopped in fmi2DoStep at t = 0.31 s"
    assert ("note", text) in [(f.severity, f.text) for f in found]  # slow is not wrong


# compilers have folders below that of a platform, for static libraries
@pytest.mark.parametrize("folder", ["amiga68k", "win32/VisualStudio10"])
def test_an_fmu_without_binary_for_this_machine_is_not_run(oscillators, tmp_path, folder):
    """The only finding is a note with the platforms that exist, of which no tool has a verdict."""
    subject = opened(oscillators.make(), tmp_path)
    (binary,) = (tmp_path / "binaries").iterdir()
    (binary.parent / folder).parent.mkdir(exist_ok=True)
    binary.rename(binary.parent / folder)
    (found,) = [f for name in RULES for f in RULES[name](subject)]
    assert found.rule == "run.possible"
    assert found.text.startswith(f"no binary for this platform, expected {binary.name}")
    assert found.text.endswith(f"got {folder.partition('/')[0]}: the FMU was not run")


@shards.faults
def test_an_fmu_that_takes_summed_times_only_is_probed_that_way(oscillators, tmp_path):
    """One probe reports it, and all other probes still run."""
    found = apply(oscillators.make(fault="strict"), tmp_path)
    assert {f.rule for f in found} == {"run.drift"}
    assert "is rejected at the counted time" in found[0].text


@shards.faults
def test_a_slow_instantiation_is_not_a_leak(oscillators, tmp_path):
    """If two thousand instances take too long, leaks are not reported."""
    with use_probe_limits(ProbeLimits(call_time=60.0, total_time=300.0, work_time=0.02)):
        found = apply(oscillators.make(fault="slow"), tmp_path, "leak")
    told = "an instance takes too long for a test with 2000 instances"
    assert {(f.severity, f.text) for f in found} == {("note", told)}


NAME = 'modelIdentifier="oscillator"'
ONCE = (NAME, f'{NAME} canBeInstantiatedOnlyOncePerProcess="true"')
AGAIN = ["state", "serialize", "reset", "instances"]  # probes that run it again


@pytest.mark.parametrize(
    ("major", "fault", "change", "probes"),
    [
        (3, "none", ("", ""), ()),
        pytest.param(2, "none", ("", ""), (), marks=shards.faults),
        # each process creates one instance of an FMU that declares so; tasks that need two are skipped
        pytest.param(2, "only", ONCE, (), marks=shards.faults),
        # the end of the last of many steps may exceed the stop time by a rounding error: none is set
        (2, "exact", ("", ""), ["drift"]),
        # at a kink from slope 1 to slope 2 the derivative may be 1.3
        (2, "kink", ("", ""), ["directional"]),
        # a growing mode sets no limit to the step of explicit Euler
        pytest.param(2, "grows", ("", ""), ["default", "stiff"], marks=shards.faults),
        # -0 for 0, and 8e-15 at a nominal value of 1, are no differences between runs
        *(pytest.param(n, "zero", ("", ""), AGAIN, marks=shards.faults) for n in (2, 3)),
    ],
)
def test_what_is_no_fault_has_no_findings(oscillators, tmp_path, major, fault, change, probes):
    """No probe has findings on an oscillator whose peculiarities are allowed."""
    assert apply(oscillators.make(major, fault, change), tmp_path, *probes) == []


@pytest.mark.parametrize(
    ("fault", "what"), [("soon", "the time"), pytest.param("states", "states", marks=shards.faults)]
)
def test_only_the_rejected_late_call_is_reported(oscillators, tmp_path, fault, what):
    """Calls that fail only because of an earlier failure are not reported."""
    found = apply(oscillators.make(2, fault), tmp_path, "late")
    assert [f.text.split(": ")[1].split(" cannot")[0] for f in found] == [what]


def test_probes_of_solvers_free_their_instances(oscillators, tmp_path):
    """This FMU allows one instance at a time, and each probe creates some."""
    subject = opened(oscillators.make(2, "once"), tmp_path)
    trial = Trial(subject.folder, subject.model, "ModelExchange", share_activity(tmp_path / "activity"))
    for task in (importing_solver.nominals, importing_solver.late, importing_solver.stiff) * 2:
        assert list(task(trial)) == []


def test_a_difference_above_the_tolerance_is_an_error(oscillators, tmp_path):
    """The tolerance is 1e-4 without a DefaultExperiment that has one; rows are position and force."""
    subject = opened(oscillators.make(), tmp_path)
    trial = Trial(subject.folder, subject.model, "CoSimulation", share_activity(tmp_path / "activity"))
    for difference, expected in ((0.9e-4, "warning"), (1.1e-4, "error")):
        assert severity(trial, [[1.0, -40.0]], [[1.0, -40.0 * (1 + difference)]]) == expected
    assert severity(trial, [[1.0, 0.0]] * 2, [[1.0, 0.0]]) == "error"  # the run ends early


def test_a_table_that_doubles_is_no_leak():
    """Memory that grows in one half of the instances only is not a leak."""
    window = leaks.WINDOW
    steady = [1000.0 * window * n for n in range(9)]
    once = [0.0] * 6 + [1e6] * 3
    assert leaks._growth(steady, noise=8e3) == pytest.approx(1000.0 - 4e3 / (4 * window))
    assert leaks._growth(once, noise=8e3) < leaks.LEAK


def test_a_shift_that_the_fmu_refuses_is_undone():
    """The next call finds the state and the input as they were before."""
    state, given = SimpleNamespace(name="x"), SimpleNamespace(name="u")
    at = {"x": np.zeros(1), "u": 0.5}

    def refuse():
        raise CallFailed("x is beyond its range")

    def values(_):
        return SimpleNamespace(set=lambda v: at.update(u=v[0]), get=refuse)

    integrator = SimpleNamespace(set_time_and_states=lambda _, x: at.update(x=x))
    point = object.__new__(ShiftedPoint)
    point.simulation = SimpleNamespace(integrator=integrator, time=0.0, values=values)
    point.values, point.states, point.x, point.u = values([]), [state], np.zeros(1), {"u": 0.5}
    for known in (state, given):
        with pytest.raises(CallFailed):
            point.shifted(known, 1.0)
    assert at == {"x": point.x, "u": 0.5}
