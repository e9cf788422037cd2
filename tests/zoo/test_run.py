"""Runs of FMUs with faults: one line, all rows until then, and nothing is left."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from kit import shards

from orchestrator.data.trace import read_trace
from zoo.command import Ended, command, obeyed
from zoo.faulty import BEGIN, CAUSES, FAULTS, HANGS, MEMORY, PHASES, Faulty, faulty, two_lags

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="faults and signals of POSIX")
STEP, STOP = 0.01, 1.0  # [s]
LIMIT = 3.0  # [s]; a run takes a tenth of it
SELECTED = [(fault, "step") for fault in FAULTS]
SELECTED += [("exit_0", "instantiate"), ("sleep", "initialise"), ("abort", "free"), ("exit_0", "free")]
SWAPPED = [("exit_7", "step"), ("divide", "instantiate"), ("spin", "free")]
EARLIER = "time,lag.y\n0,1\n"  # a result of an earlier run


def _run(folder: Path, system: Path, *options: str, interrupt: Path | None = None) -> Ended:
    """A run over an earlier result."""
    (folder / "trace.csv").write_text(EARLIER, encoding="utf-8")
    arguments = ["run", system, "--stop", str(STOP), "--step", str(STEP), "--out", "trace.csv", *options]
    ended = command(arguments, folder, interrupt.exists if interrupt else None)
    assert (ended.files, ended.processes) == ((), ())
    return ended


def _check_rows(folder: Path, fmu: Faulty) -> None:
    """The rows until the fault are there; a good earlier result stays."""
    partial, result = folder / "trace.partial.csv", folder / "trace.csv"
    if fmu.harmless:
        assert not partial.exists()
        partial = result
    else:
        assert result.read_text("utf-8") == EARLIER
    if fmu.phase in ("instantiate", "initialise") and not fmu.harmless:
        assert not partial.exists() or len(partial.read_text("utf-8").splitlines()) == 1  # no row
        return
    end = BEGIN if fmu.phase == "step" and not fmu.harmless else STOP
    # an integer count times the step, in another order of operations
    np.testing.assert_allclose(
        read_trace(partial).time, np.arange(0, end + STEP / 2, STEP), rtol=0, atol=1e-12
    )


def _check(folder: Path, fmu: Faulty, component: str, system: Path, *options: str) -> None:
    limits = ["--memory-limit", str(MEMORY)] + (["--time-limit", str(LIMIT)] if fmu.fault in HANGS else [])
    ended = _run(folder, system, *options, *limits)
    assert fmu.committed.exists()
    _check_rows(folder, fmu)
    if fmu.harmless:
        assert (ended.status, ended.err) == (0, "")
        return
    assert ended.status == 2
    assert len(ended.lines) == 1
    line = ended.lines[0]
    if fmu.fault == "nan":
        assert line.startswith(f"harvester: {component}.y: expected a ")
        assert " got nan" in line
        return
    assert CAUSES.get(fmu.fault, f"not done within {LIMIT:g} s") in line
    assert f" in {fmu.call} " in line
    assert f" of {component} ({fmu.fmu})" in line


@pytest.mark.parametrize(("fault", "phase"), SELECTED)
def test_a_fault_ends_the_run_in_one_line(tmp_path: Path, fault: str, phase: str) -> None:
    """With the FMU, the call and what happened; status 2."""
    fmu = faulty(tmp_path, fault, phase)
    _check(tmp_path, fmu, "lag", fmu.fmu)


@pytest.mark.parametrize(
    ("fault", "phase"), [("exit_7", "step"), ("divide", "instantiate"), ("spin", "free")]
)
def test_a_swapped_fmu_is_named(tmp_path: Path, fault: str, phase: str) -> None:
    """By its component and its own file."""
    fmu = faulty(tmp_path, fault, phase, name="other")
    _check(tmp_path, fmu, "second", two_lags(tmp_path), "--swap", f"second={fmu.fmu}")


@shards.faults
@pytest.mark.parametrize("major", [2, 3])
@pytest.mark.parametrize("phase", PHASES)
@pytest.mark.parametrize("fault", FAULTS)
def test_each_fault_in_each_phase_ends_the_run(tmp_path: Path, fault: str, phase: str, major: int) -> None:
    """Of the FMU alone and swapped into a system, in both versions of FMI."""
    fmu = faulty(tmp_path, fault, phase, major)
    _check(tmp_path, fmu, "lag", fmu.fmu)
    fmu.committed.unlink()
    other = faulty(tmp_path, fault, phase, major, name="other")
    _check(tmp_path, other, "second", two_lags(tmp_path), "--swap", f"second={other.fmu}")


@pytest.mark.parametrize(("fault", "phase"), [("spin", "step"), ("sleep", "step"), ("spin", "instantiate")])
def test_an_interrupt_is_obeyed_while_an_fmu_hangs(tmp_path: Path, fault: str, phase: str) -> None:
    """Within 2 s, in one line; the rows until then are kept."""
    fmu = faulty(tmp_path, fault, phase)
    ended = _run(tmp_path, fmu.fmu, interrupt=fmu.committed)
    assert obeyed(ended)
    assert ended.status == 130
    assert len(ended.lines) == 1
    assert ended.lines[0].startswith(f"harvester: interrupted; in {fmu.call} ")
    assert ended.lines[0].endswith(f" of lag ({fmu.fmu})")
    _check_rows(tmp_path, fmu)
