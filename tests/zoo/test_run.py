"""Runs of FMUs with faults: one line, all rows until then, and nothing is left."""

import sys
from pathlib import Path

import numpy as np
import pytest
from kit import shards

from orchestrator.data.trace import read_trace
from zoo.command import Ended, command
from zoo.faulty import BEGIN, CASES, CAUSES, HANGS, MEMORY, Faulty, faulty, two_lags

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="faults and signals of POSIX")
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
