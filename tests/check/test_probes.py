"""Probes of `harvester check`: each planted fault is found by its probe; valid FMUs have no findings."""

from __future__ import annotations

import zipfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import pytest

from orchestrator.check.finding import Finding
from orchestrator.check.probe_process import ProbeLimits, probe_limits, use_probe_limits
from orchestrator.check.probes import PROBES
from orchestrator.check.subject import Subject, parse_unpacked
from orchestrator.check.tasks import importing_solver, leaks
from orchestrator.check.tasks.runner import Trial
from orchestrator.worker.activity import ActivityRecord

RULES = {rule.id.removeprefix("run."): rule for rule in PROBES}


@dataclass(frozen=True)
class Planted:
    """A fault in the binary or in a text, the probe that must report it, and a part of its message."""

    probe: str
    text: str
    fault: str = "none"
    change: tuple[str, str] = ("", "")
    major: int = 2
    severity: str = "error"

    def __str__(self) -> str:
        return f"{self.fault if self.fault != 'none' else 'text'}-{self.probe}-{self.major}"


NO_DEPENDENCY = ('<Unknown index="10" dependencies="2 5 6"/>', '<Unknown index="10" dependencies="5 6"/>')
NO_DEPENDENCY_3 = ('dependencies="1 4 5"', 'dependencies="4 5"')
FEWER_STATES = ('<Unknown index="8" dependencies="2 5 6"/>', '<Unknown index="8" dependencies="2 5"/>')
NO_CATEGORY = ('<Category name="logEvents"/>', "")
FAULTS = (
    Planted("load", "GetVersion returns b'1.0'", "version"),
    Planted("default", "segmentation fault in fmi2DoStep at t = 0.31 s", "crash"),
    Planted("default", "segmentation fault in fmi3DoStep at t = 0.31 s", "crash", major=3),
    Planted("default", "hang: no return within 2 s in fmi2DoStep at t = 0.31 s", "hang"),
    Planted("default", "signal 36 in fmi2DoStep", "signal"),
    Planted("default", "the process ended with exit status 3 in fmi2DoStep", "exit"),
    Planted("default", 'fmi2DoStep failed at t = 0.31 s with status error; it says: no more', "error"),
    Planted("default", "position is nan at t = 0.31 s", "nan"),
    Planted("default", "position has grown to", "runaway"),
    Planted("default", "abort in fmi2FreeInstance", "twice"),
    Planted("default", "the last successful time is 0 s", "late"),
    Planted("default", "the last successful time is 0 s", "late", major=3),
    Planted("default", "model exchange: the event iteration does not end", "event"),
    Planted("token", 'instantiation succeeds with the GUID "{0000', "token", severity="warning"),
    Planted("token", "the instantiation token", "token", major=3, severity="warning"),
    Planted("first_output", "force is 0 after initialisation and -40 after", "first", severity="warning"),
    Planted("first_output", "stiffness starts at 41 in modelDescription.xml", change=('"40"', '"41"')),
    Planted("drift", "is rejected at the summed time", "drift"),
    Planted("start_time", "time is 0 s at t = 1000 s", "start"),
    Planted("start_time", "the first step from t = 1000 s changes position by -1", "leap"),
    Planted("start_time", "because nothing depends on time", "clock"),
    Planted("stop_time", "a stop time is needed", "stop"),
    Planted("instances", "a second run in the same process differs", "shared"),
    Planted("instances", "a second instance cannot be created", "once"),
    Planted("threads", "4 instances in 4 threads: ", "threads"),
    Planted("leak", "bytes of memory (of", "leak"),
    Planted("leak", "file handles (of", "handles"),
    Planted("resources", "fmi2Instantiate returns no instance", "location"),
    Planted("resources", "fmi3Instantiate returns no instance", "letters", major=3),
    Planted("state", "continues differently after its state was restored", "solver"),
    Planted("state", "while u changed", "solver"),
    Planted("serialize", "in fmi2DeSerializeFMUstate", "pointer"),
    Planted("serialize", "more is written than the announced", "beyond"),
    Planted("reset", "the run after a reset differs", "reset"),
    Planted("directional", "of force with respect to u is -1, by finite differences 1", "directional"),
    Planted("directional", "the derivative of force with respect to u", "directional", major=3),
    Planted("adjoint", "the adjoint derivative of force with respect to u is 0", "adjoint", major=3),
    Planted("output_derivatives", "the derivative of position is", "slope"),
    Planted("output_derivatives", "the derivative of position is", "slope", major=3),
    Planted("dependencies", "force changes with u, its declared dependencies are", change=NO_DEPENDENCY),
    Planted("dependencies", "force changes with u, its declared", change=NO_DEPENDENCY_3, major=3),
    Planted("dependencies", "der_v changes with v, its declared dependencies are", change=FEWER_STATES),
    Planted("nominals", "model exchange: the nominal value of v is 0, expected a value above 0", "nominal"),
    Planted("nominals", "model exchange: the nominal value of v is 0", "nominal", major=3),
    Planted("late", "parameters cannot be set after fmi2ExitInit", "parameters", severity="note"),
    Planted("late", "stiffness is set to 40.04 after", "deaf", severity="note"),
    Planted("late", "states cannot be set before fmi2EnterContinuous", "states", severity="note"),
    Planted("late", "the time cannot be set before fmi2EnterContinuous", "soon", severity="note"),
    Planted("stiff", "of -5e+04 1/s: explicit Euler needs steps below 4e-05 s", "stiff", severity="note"),
    Planted("stiff", "-0.25 +- 32i 1/s: explicit Euler needs steps below 0.0005", "swings", severity="note"),
    Planted("invalid_values", "u = nan: position is nan even after the input", "accepts", severity="warning"),
    Planted("invalid_values", "segmentation fault in fmi2SetReal", "input"),
    Planted("unexpected_calls", "(a step before the initialisation, illegal)", "order", severity="warning"),
    Planted("unexpected_calls", "(an unknown value reference, illegal)", "reference", severity="warning"),
    Planted("unexpected_calls", "fault in fmi3GetFloat64", "reference", major=3, severity="warning"),
    Planted("unexpected_calls", "(initialisation mode entered twice, illegal)", "again", severity="warning"),
    Planted("unexpected_calls", "running, illegal), last values stiffness", "fixed", severity="warning"),
    Planted("log", 'a message is logged in category "logEvents"', change=NO_CATEGORY, severity="warning"),
    Planted("intermediate", "an update at 0.02 s in the step from 0 to 0.01 s", "update", major=3),
    Planted("early_return", "the last successful time of a step", "early", major=3),
)  # fmt: skip


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


@pytest.mark.parametrize("planted", FAULTS, ids=str)
def test_a_planted_fault_is_found_by_its_probe(oscillators, tmp_path, planted):
    """One finding has the right severity, and a message with the fault and the call."""
    path = oscillators.make(planted.major, planted.fault, planted.change)
    with use_probe_limits(
        replace(probe_limits(), call_time=2.0 if planted.fault == "hang" else probe_limits().call_time)
    ):
        found = apply(path, tmp_path, planted.probe)
    assert any(planted.text in f.text and f.severity == planted.severity for f in found), found
    assert all(f.rule == f"run.{planted.probe}" for f in found)


def test_a_probe_that_takes_too_long_is_stopped(oscillators, tmp_path):
    """The message contains the last call, also if no single call took long enough to be a hang."""
    for probe in (1.0, 4.0, 16.0, 64.0):
        with use_probe_limits(ProbeLimits(call_time=1000.0, total_time=probe, work_time=2.0)):
            found = apply(oscillators.make(fault="hang"), tmp_path / f"{probe:g}", "default")
        if any(f.text.endswith("at t = 0.31 s") for f in found):
            break  # else the machine is so slow that the FMU did not come so far
    text = f"co-simulation: not done within {probe:g} s, stopped in fmi2DoStep at t = 0.31 s"
    assert ("note", text) in [(f.severity, f.text) for f in found]  # slow is not wrong


def test_an_fmu_without_binary_for_this_machine_is_not_run(oscillators, tmp_path):
    """The only finding is a note with the platforms that exist."""
    subject = opened(oscillators.make(), tmp_path)
    (binary,) = (tmp_path / "binaries").iterdir()
    binary.rename(binary.with_name("amiga68k"))
    (found,) = [f for name in RULES for f in RULES[name](subject)]
    assert (
        found.rule == "run.possible"
    )  # no tool has a verdict on it: that there is none says nothing of the FMU
    text = found.text
    assert text.startswith(f"no binary for this platform, expected {binary.name}")
    assert text.endswith("got amiga68k: the FMU was not run")


def test_an_fmu_that_takes_summed_times_only_is_probed_that_way(oscillators, tmp_path):
    """One probe reports it, and all other probes still run."""
    found = apply(oscillators.make(fault="strict"), tmp_path)
    assert {f.rule for f in found} == {"run.drift"}
    assert "is rejected at the counted time" in found[0].text


def test_an_fmu_that_can_be_instantiated_once_is_instantiated_once(oscillators, tmp_path):
    """Each process creates one instance of an FMU that declares so; tasks that need two are skipped."""
    name = 'modelIdentifier="oscillator"'
    change = (name, f'{name} canBeInstantiatedOnlyOncePerProcess="true"')
    assert apply(oscillators.make(2, "only", change), tmp_path) == []


def test_a_slow_instantiation_is_not_a_leak(oscillators, tmp_path):
    """If two thousand instances take too long, leaks are not reported."""
    with use_probe_limits(ProbeLimits(call_time=60.0, total_time=300.0, work_time=0.02)):
        found = apply(oscillators.make(fault="slow"), tmp_path, "leak")
    assert {(f.severity, f.text) for f in found} == {
        ("note", "an instance takes too long for a test with 2000 instances")
    }


@pytest.mark.parametrize("major", [2, 3])
def test_a_valid_fmu_has_no_findings(oscillators, tmp_path, major):
    """No probe has findings on the oscillator without fault."""
    assert apply(oscillators.make(major), tmp_path) == []


@pytest.mark.parametrize(("fault", "what"), [("soon", "the time"), ("states", "states")])
def test_only_the_rejected_late_call_is_reported(oscillators, tmp_path, fault, what):
    """Calls that fail only because of an earlier failure are not reported."""
    found = apply(oscillators.make(2, fault), tmp_path, "late")
    assert [f.text.split(": ")[1].split(" cannot")[0] for f in found] == [what]


def test_a_growing_mode_is_not_stiff(oscillators, tmp_path):
    """A growing mode sets no limit to the step of explicit Euler."""
    assert apply(oscillators.make(2, "grows"), tmp_path, "default", "stiff") == []


def test_probes_of_solvers_free_their_instances(oscillators, tmp_path):
    """This FMU allows one instance at a time, and each probe creates some."""
    subject = opened(oscillators.make(2, "once"), tmp_path)
    trial = Trial(subject.folder, subject.model, "ModelExchange", ActivityRecord(tmp_path / "activity"))
    for task in (importing_solver.nominals, importing_solver.late, importing_solver.stiff) * 2:
        assert list(task(trial)) == []


def test_rounding_around_zero_is_no_difference(oscillators, tmp_path):
    """-0 for 0, and 8e-15 at a nominal value of 1, are no differences between runs."""
    for major in (2, 3):
        path = oscillators.make(major, "zero")
        assert apply(path, tmp_path / f"{major}", "state", "serialize", "reset", "instances") == []


def test_folders_of_compilers_are_not_platforms(oscillators, tmp_path):
    """Static libraries are in folders below their platform: binaries/win32/VisualStudio10/x.lib."""
    subject = opened(oscillators.make(), tmp_path)
    (binary,) = (tmp_path / "binaries").iterdir()
    below = binary.with_name("win32") / "VisualStudio10"
    below.mkdir(parents=True)
    next(binary.iterdir()).rename(below / "oscillator.lib")
    (found,) = RULES["possible"](subject)
    assert found.text.endswith(", got win32: the FMU was not run")


def test_a_table_that_doubles_is_no_leak():
    """Memory that grows in one half of the instances only is not a leak."""
    window = leaks.WINDOW
    steady = [1000.0 * window * n for n in range(9)]
    once = [0.0] * 6 + [1e6] * 3
    assert leaks._growth(steady, noise=8e3) == pytest.approx(1000.0 - 4e3 / (4 * window))
    assert leaks._growth(once, noise=8e3) < leaks.LEAK
