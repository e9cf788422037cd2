"""FMUs with faults, in each command: one line, all rows until then, and nothing is left."""

from collections.abc import Iterator
from itertools import product
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from kit import shards
from kit.needs import needs
from kit.wait import LONG, runs, until

from orchestrator import Problem
from orchestrator.data.trace import read_trace
from orchestrator.realtime import machine as realtime
from orchestrator.realtime.machine import RealTimeMachine
from orchestrator.realtime.setup import Axis, Setup
from zoo.command import Ended, command
from zoo.faulty import BEGIN, CASES, CAUSES, FAULTS, HANGS, MEMORY, PHASES, Faulty, faulty, study, two_lags

pytestmark = needs("POSIX", "faults and signals of POSIX")
STEP, STOP = 0.01, 1.0  # [s]
LIMIT = 1.5  # [s]; the fault is committed after a tenth of it
QUICK = [("segfault", "step", 2, False), ("spin", "step", 3, True), ("exit_0", "instantiate", 3, True)]
QUICK += [("nan", "step", 3, False)]
HANGING = [("spin", "step"), ("sleep", "step"), ("spin", "instantiate")]
# each fault, phase and version of FMI alone and swapped into a system
SWAPPED = [(*case, (k // 8 + k + 1) % 2 == 1) for k, case in enumerate(CASES)]
EARLIER = "time,lag.y\n0,1\n"  # a result of an earlier run


def _run(folder: Path, system: Path, *options: str, interrupt: Path | None = None) -> Ended:
    """A run over an earlier result."""
    (folder / "trace.csv").write_text(EARLIER, encoding="utf-8")
    arguments = ["run", system, "--stop", str(STOP), "--step", str(STEP), "--out", "trace.csv", *options]
    ended = command(arguments, folder, interrupt.exists if interrupt else None)
    assert ended.left == ()
    return ended


def _check_rows(folder: Path, fmu: Faulty) -> None:
    """The rows until the fault are there; a good earlier result stays, unless all rows are there."""
    partial, result = folder / "trace.partial.csv", folder / "trace.csv"
    if fmu.harmless or fmu.phase == "free":
        assert not partial.exists()
        partial = result
    else:
        assert result.read_text("utf-8") == EARLIER
    if fmu.phase in ("instantiate", "initialise") and not fmu.harmless:
        assert not partial.exists() or len(partial.read_text("utf-8").splitlines()) == 1  # no row
        return
    end = BEGIN if fmu.phase == "step" and not fmu.harmless else STOP
    # an integer count times the step, in another order of operations
    times = np.arange(0, end + STEP / 2, STEP)
    np.testing.assert_allclose(read_trace(partial).time, times, rtol=0, atol=1e-12)


@pytest.mark.parametrize(("fault", "phase", "major", "swapped"), shards.few(QUICK, SWAPPED, shards.faults))
def test_a_fault_ends_the_run_in_one_line(
    tmp_path: Path, fault: str, phase: str, major: int, swapped: bool
) -> None:
    """With the FMU, the call and what happened, and status 2; also of an FMU swapped into a system."""
    fmu = faulty(tmp_path, fault, phase, major, name="other" if swapped else "lag")
    component, system, options = "lag", fmu.fmu, ["--memory-limit", str(MEMORY)]
    if swapped:
        component, system = "second", two_lags(tmp_path)
        options += ["--swap", f"second={fmu.fmu}"]
    if fault in HANGS:
        options += ["--time-limit", str(LIMIT)]
    ended = _run(tmp_path, system, *options)
    assert fmu.committed.exists()
    _check_rows(tmp_path, fmu)
    if fmu.harmless:
        assert (ended.status, ended.err) == (0, "")
        return
    assert ended.status == 2
    assert len(ended.lines) == 1
    assert ended.lines[0].startswith("harvester: ")
    fmu.assert_told(ended.lines[0], component, CAUSES.get(fault, f"not done within {LIMIT:g} s"))


@pytest.mark.parametrize(("fault", "phase"), shards.few(HANGING[:1], HANGING, shards.faults))
def test_an_interrupt_is_obeyed_while_an_fmu_hangs(tmp_path: Path, fault: str, phase: str) -> None:
    """In one line; the rows until then are kept."""
    fmu = faulty(tmp_path, fault, phase)
    ended = _run(tmp_path, fmu.fmu, interrupt=fmu.committed)
    assert ended.status == 130
    assert len(ended.lines) == 1
    assert ended.lines[0].startswith(f"harvester: interrupted; in {fmu.call} ")
    assert ended.lines[0].endswith(f" of lag ({fmu.fmu})")
    _check_rows(tmp_path, fmu)


# ---- `harvester check`: a finding that names the call, and nothing is left;
# tests/check/test_children.py interrupts a check while an FMU hangs

TIMEOUT = 1.0  # [s] for one call of an FMU that hangs; others may leak or print for a while
# the limit is a quarter of the machine's memory
LIMITS = f"import orchestrator.base.processes as p; p.machine_memory = lambda: 4 * {MEMORY}e9"


@pytest.mark.parametrize(
    ("fault", "phase", "major"),
    shards.few([("segfault", "step", 2), ("spin", "instantiate", 3)], CASES, shards.faults),
)
def test_a_fault_is_found(tmp_path: Path, fault: str, phase: str, major: int) -> None:
    """Under the name of the file, with the call that did not return."""
    fmu = faulty(tmp_path, fault, phase, major)
    timeout = TIMEOUT if fault in HANGS else LONG
    ended = command(["check", fmu.fmu, "--timeout", str(timeout)], tmp_path, setup=LIMITS)
    assert ended.left == ()
    assert fmu.committed.exists()
    # the findings under the heading of errors
    found = ended.out.partition("\nerrors\n")[2].partition("\n\n")[0].splitlines()
    if fmu.harmless:
        assert (ended.status, found, ended.err) == (0, [], "")
        return
    assert ended.status == 1
    assert ended.out.startswith(f"{fmu.fmu}: ")
    if fault == "nan":
        assert any("y is nan" in line for line in found), ended.out
        return
    cause = f"hang: no return within {TIMEOUT:g} s" if fault in HANGS else CAUSES[fault]
    assert any(cause in line and f" in {fmu.call}" in line for line in found), ended.out


# ---- studies: each failed run is a row that names the FMU and what happened


def _sweep(fmus: list[Faulty], folder: Path) -> tuple[pd.DataFrame, str]:
    """The runs of a study of two FMUs, the second of which is each of these, and what the command printed."""
    options = ", ".join(f'"{fmu.fmu.name}"' for fmu in fmus)
    settings = f"time_limit = {LIMIT}\n[choices]\nsecond = [{options}]"
    file = study(folder, two_lags(folder), "second.y", settings)
    ended = command(["sweep", file, "--workers", "2", "--out", "out", "--no-report"], folder)
    assert ended.left == ()
    assert ended.status == all(not fmu.harmless for fmu in fmus), ended.err
    table = pd.read_parquet(folder / "out" / "runs.parquet")
    return table.set_index("choice:second"), ended.out


def _check_row(fmu: Faulty, row: pd.Series, lag: float) -> None:
    """The row of a run; lag: the output at the end without a fault."""
    assert fmu.committed.exists() or fmu.fault == "none"
    if fmu.harmless:
        assert (row["status"], row["reason"], row["output:end"]) == ("ok", "", lag)
        return
    assert row["status"] == "failed"
    fmu.assert_told(row["reason"], "second", CAUSES.get(fmu.fault, f"not done within {LIMIT:g} s"))
    assert "xxx" not in row["reason"]  # printed by another run


@pytest.mark.parametrize(
    ("names", "major"),
    [
        ([("segfault", "step"), ("spin", "step"), ("exit_0", "instantiate")], 2),
        *(pytest.param(list(product(FAULTS, PHASES)), major, marks=shards.faults) for major in (2, 3)),
    ],
    ids=["four", "each-2", "each-3"],
)
def test_each_fault_is_a_row(tmp_path: Path, names: list[tuple[str, str]], major: int) -> None:
    """The other runs are as they would be without it, and no process or file is left."""
    fmus = [faulty(tmp_path, fault, phase, major, f"{fault}_{phase}") for fault, phase in names]
    good = faulty(tmp_path, name="good", major=major)
    table, out = _sweep([good, *fmus], tmp_path)
    assert len(table) == len(fmus) + 1
    for fmu in (good, *fmus):
        _check_row(fmu, table.loc[fmu.fmu.name], table.loc["good.fmu", "output:end"])
    assert f"{sum(not fmu.harmless for fmu in fmus)} failed" in out


@shards.faults
def test_a_study_of_which_every_run_fails_has_status_1(tmp_path: Path) -> None:
    """And the summary has one line with the reason."""
    _, out = _sweep([faulty(tmp_path, "exit_0", name=name) for name in ("one", "other")], tmp_path)
    assert "2 runs: 2 failed\n" in out
    assert out.count("\n1 of them: the process ended with exit status 0 in ") == 2


@pytest.mark.parametrize("fault", ["spin", pytest.param("sleep", marks=shards.faults)])
def test_an_interrupt_of_a_study_is_obeyed(tmp_path: Path, fault: str) -> None:
    """In one line; runs that are stored stay."""
    fmu = faulty(tmp_path, fault)
    rates = '[factors]\n"lag.rate" = { distribution = "values", values = [1, 2] }'
    file = study(tmp_path, fmu.fmu, "lag.y", rates)
    ended = command(["sweep", file, "--out", "out"], tmp_path, fmu.committed.exists)
    stored = "0 of 2 runs are stored in out; the same command continues the study"
    assert (ended.status, ended.lines) == (130, [f"harvester: interrupted; {stored}"])
    assert ended.left == ()


# ---- a live machine: one line on the page and the terminal, its frames are kept

SILENT, STARTED = 1.0, 4.0  # [s] instead of 5 and 60, to wait less
SELECTED = [(fault, "step") for fault in FAULTS if fault not in ("exit_7", "overflow")]
SELECTED += [("spin", "instantiate"), ("exit_0", "initialise"), ("exit_0", "free"), ("sleep", "free")]
QUIET = ("--no-open", "--port", "0")
QUICK_ON_A_PAGE = [("segfault", "step"), ("spin", "step"), ("exit_0", "initialise")]
STUCK = [("spin", "instantiate"), ("sleep", "step")]


def _timeouts(fault: str) -> tuple[float, float]:
    """Timeouts [s] of a step and of the start; long for a leak, which takes its time on a loaded machine."""
    return (LONG, LONG) if fault == "leak" else (SILENT, STARTED)


def _check_page(fmu: Faulty, message: str) -> None:
    """One line with the FMU and what has happened."""
    cause = ""
    if fmu.fault in HANGS or (fmu.fault, fmu.phase) == ("leak", "free"):  # nobody looks at the memory then
        hangs = {"step": "not answered for 1 s", "free": f"did not end within {realtime.END_TIMEOUT:g} s"}
        cause = hangs.get(fmu.phase, f"not started within {STARTED:g} s")
    fmu.assert_told(message, fmu.fmu.stem, cause)


@pytest.fixture
def limits(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[None]:
    """Limits that are reached soon; no file is left at the end."""
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(temporary))
    monkeypatch.setattr(realtime, "MEMORY", 1e9 * MEMORY)
    yield
    assert list(temporary.iterdir()) == []


@pytest.mark.usefixtures("limits")
@pytest.mark.parametrize(("fault", "phase"), shards.few(QUICK_ON_A_PAGE, SELECTED, shards.faults))
def test_a_fault_fails_the_machine(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fault: str, phase: str
) -> None:
    """Frames until then stay; the process and what it started are gone after the close."""
    fmu = faulty(tmp_path, fault, phase)
    silent, started = _timeouts(fault)
    monkeypatch.setattr(realtime, "SILENT", silent)
    monkeypatch.setattr(realtime, "START_TIMEOUT", started)
    try:
        machine = RealTimeMachine(Setup(str(fmu.fmu), (Axis("u", 2.0, 10.0),), ("lag.y",)))
    except Problem as problem:
        assert phase in ("instantiate", "initialise")
        _check_page(fmu, str(problem))
        return
    if phase == "step":
        assert until(fmu.committed.exists)
        until(lambda: machine.latest().state == "failed", 0.5 if fmu.harmless else 2 * silent + 10)
        assert (machine.latest().state == "failed") != fmu.harmless
        # the frame that ends at 0.5 s is the last; without a fault the machine goes on
        assert (machine.trace().time[-1] > BEGIN + 0.05) == fmu.harmless
        assert machine.trace().time[-1] > BEGIN - 0.011
    machine.close()
    frame = machine.latest()
    assert frame.state == ("ended" if fmu.harmless else "failed")
    if not fmu.harmless:
        _check_page(fmu, frame.message)
    assert not runs(machine.pid)
    assert until(lambda: not runs(int(fmu.committed.read_text())))


ABORT = [("abort", "step", 3)]


@pytest.mark.parametrize(("fault", "phase", "major"), shards.few(ABORT, CASES, shards.faults))
def test_the_terminal_tells_the_fault(tmp_path: Path, fault: str, phase: str, major: int) -> None:
    """In one line, also while an FMU hangs; Ctrl-C ends the command and leaves nothing."""
    fmu = faulty(tmp_path, fault, phase, major)

    def begun() -> bool:
        """The fault was committed and its line is there, or it is committed at the end."""
        if phase == "free" or fmu.harmless:
            return (tmp_path / "stdout").stat().st_size > 0
        return "session-" in (tmp_path / "stderr").read_text("utf-8")

    limits = "m.MEMORY, m.SILENT, m.START_TIMEOUT = {}, {}, {}".format(1e9 * MEMORY, *_timeouts(fault))
    setup = f"import orchestrator.realtime.machine as m; {limits}"
    ended = command(["view", fmu.fmu, *QUIET, "--results", "results"], tmp_path, begun, setup)
    assert ended.left == ()
    if "harvester: interrupted" not in ended.err:  # failed before its page was there
        assert ended.status == 2
        assert phase in ("instantiate", "initialise")
        _check_page(fmu, "\n".join(ended.lines))
        return
    assert ended.status == 130
    assert len(ended.lines) == 2 - fmu.harmless
    if not fmu.harmless:
        _check_page(fmu, ended.lines[0])
        file = tmp_path / ended.lines[0].rpartition(" is in ")[2]
        # frames of 10 ms up to 0.5 s, and the first
        assert len(read_trace(file).time) >= (51 if phase == "step" else 1)


@pytest.mark.parametrize(("fault", "phase"), shards.few(STUCK[:1], STUCK, shards.faults))
def test_an_interrupt_of_a_page_is_obeyed(tmp_path: Path, fault: str, phase: str) -> None:
    """Before the page is there, and after."""
    fmu = faulty(tmp_path, fault, phase)
    ended = command(["view", fmu.fmu, *QUIET], tmp_path, fmu.committed.exists)
    assert (ended.status, ended.lines[-1]) == (130, "harvester: interrupted")
    assert ended.left == ()
