"""Studies of FMUs with faults: each failed run is a row that names the FMU and what happened."""

import sys
from itertools import product
from pathlib import Path

import pandas as pd
import pytest
from kit import shards

from zoo.command import command
from zoo.faulty import CAUSES, FAULTS, PHASES, Faulty, faulty, study, two_lags

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="faults and signals of POSIX")
LIMIT = 1.5  # [s]; a run takes 20 ms


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


def _check(fmu: Faulty, row: pd.Series, lag: float) -> None:
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
    ids=["three", "each-2", "each-3"],
)
def test_each_fault_is_a_row(tmp_path: Path, names: list[tuple[str, str]], major: int) -> None:
    """The other runs are as they would be without it, and no process or file is left."""
    fmus = [faulty(tmp_path, fault, phase, major, f"{fault}_{phase}") for fault, phase in names]
    good = faulty(tmp_path, name="good", major=major)
    table, out = _sweep([good, *fmus], tmp_path)
    assert len(table) == len(fmus) + 1
    for fmu in (good, *fmus):
        _check(fmu, table.loc[fmu.fmu.name], table.loc["good.fmu", "output:end"])
    assert f"{sum(not fmu.harmless for fmu in fmus)} failed" in out


@shards.faults
def test_a_study_of_which_every_run_fails_has_status_1(tmp_path: Path) -> None:
    """And the summary has one line with the reason."""
    _, out = _sweep([faulty(tmp_path, "exit_0", name=name) for name in ("one", "other")], tmp_path)
    assert "2 runs: 2 failed\n" in out
    assert "\n1 failed: the process ended with exit status 0 in " in out


@pytest.mark.parametrize("fault", ["spin", pytest.param("sleep", marks=shards.faults)])
def test_an_interrupt_is_obeyed_while_an_fmu_hangs(tmp_path: Path, fault: str) -> None:
    """In one line; runs that are stored stay."""
    fmu = faulty(tmp_path, fault)
    rates = '[factors]\n"lag.rate" = { distribution = "values", values = [1, 2] }'
    file = study(tmp_path, fmu.fmu, "lag.y", rates)
    ended = command(["sweep", file, "--out", "out"], tmp_path, fmu.committed.exists)
    stored = "0 of 2 runs are stored in out; the same command continues the study"
    assert (ended.status, ended.lines) == (130, [f"harvester: interrupted; {stored}"])
    assert ended.left == ()
