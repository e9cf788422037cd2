"""Runs become rows: numbers, bands, and what is told of runs that go wrong."""

import math
import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from sweep.studies import FAILS, GAIN, run, study

from orchestrator import run as single
from orchestrator.studies.analysis.analyse import analyse
from orchestrator.studies.parameter_study import sweep
from orchestrator.studies.runs import MEASURES, measure
from orchestrator.studies.study import MEASURES as NAMES
from orchestrator.studies.study import Output, read


def test_a_row_is_what_a_single_run_gives(gain, tmp_path):
    """Outputs and bands, every band_step, to the last bit, with all start values and their units."""
    found, _ = run(study(tmp_path, GAIN, gain))
    table = found.table
    for number, factor in table["factor:gain.factor"].items():
        trace = single(gain, step=0.01, stop=0.2, set={"gain.factor": factor, "gain.u": 2.0}).trace
        assert table.loc[number, "output:end"] == trace["gain.y"][-1]
        band = found.bands[found.bands["run"] == number]
        assert band["time"].tolist() == [0.05 * k for k in range(5)]
        assert band["gain.y"].tolist() == np.interp(band["time"], trace.time, trace["gain.y"]).tolist()
    assert len(table) == 12
    assert (table["start:gain.factor"] == table["factor:gain.factor"]).all()
    assert set(table["start:gain.u"]) == {2.0}
    assert set(table["start:gain.offset"]) == {0.0}
    assert found.units["start:gain.offset"] == found.units["output:end"] == "m"


def test_runs_that_go_wrong_are_rows_too(fmus, tmp_path):
    """Each once, with status, reason in one line and no number; one that ended early has what it came to."""
    results, runs = run(study(tmp_path, FAILS, fmus["fails"]))
    assert runs == [0, 1, 2, 3, 4]
    table = results.table.set_index("factor:fails.how")
    assert table["status"].to_dict() == {0: "ok", 3: "failed", 5: "failed", 6: "early", 10: "failed"}
    assert table.loc[0, "reason"] == ""
    assert "the pump broke" in table.loc[3, "reason"]
    assert "fails.y: expected a finite value" in table.loc[5, "reason"]
    assert "requests the end of the simulation" in table.loc[6, "reason"]
    # the process that an FMU takes down is named with its signal
    assert re.fullmatch(r"abort in .*fails\.fmu\)", table.loc[10, "reason"])
    assert not any("\n" in reason for reason in table["reason"])
    assert table["output:end"].isna().to_dict() == {0: False, 3: True, 5: True, 6: False, 10: True}
    # y' = 1 for 0.2 s, integrated exactly but for the rounding of its steps
    assert table.loc[0, "output:end"] == pytest.approx(0.2, rel=1e-12, abs=0)
    early = table.loc[6, "run"]
    assert set(results.bands["run"]) == {table.loc[0, "run"], early}
    assert results.bands.loc[results.bands["run"] == early, "time"].max() < 0.2


def test_an_fmu_that_is_replaced_meanwhile_is_not_mixed_in(file, gain):
    """All runs are of the FMU that was there at the start, whose checksum the folder has."""
    fmu = file.parent / "gain.fmu"
    results = sweep(file, file.parent / "out", watch=lambda *_: fmu.write_bytes(b"half built"))
    assert set(results.table["status"]) == {"ok"}
    fmu.write_bytes(gain.read_bytes())
    assert run(file)[1] == []


def test_measures_of_a_sine():
    """Closed forms over a period; the trapezoidal rule is exact there, so only rounding is left."""
    t = np.linspace(0.0, 1.0, 1001)
    found = {name: measure(Output("y", "s", name), t, np.sin(2 * np.pi * t)) for name in NAMES}
    expected = {"maximum": 1.0, "minimum": -1.0, "range": 2.0, "final": 0.0, "mean": 0.0}
    expected |= {"rms": math.sqrt(0.5), "integral": 0.0, "time_of_maximum": 0.25}
    assert found == pytest.approx(expected, abs=1e-12)
    assert set(MEASURES) == set(NAMES)  # those that a study may name


def test_measures_see_their_window_only():
    """Both ends belong to it, however a time was added up; where it holds nothing there is no number."""
    t = np.array([0.1 * k for k in range(11)])
    assert measure(Output("y", "s", "maximum", stop=0.3), t, t) == t[3]
    assert measure(Output("y", "s", "minimum", start=0.3), t, t) == t[3]
    # the mean of t from 0.2 to 0.6 is its middle; the trapezoidal rule is exact for a line, but for rounding
    assert measure(Output("y", "s", "mean", 0.2, 0.6), t, t) == pytest.approx(0.4, rel=1e-12, abs=0)
    assert math.isnan(measure(Output("y", "s", "mean", 2.0, 3.0), t, t))


def test_studies_with_other_seeds_are_put_together(gain, tmp_path):
    """Seeds share no sample, and the joined table is analysed as one study."""
    file = read(study(tmp_path, GAIN, gain))
    parts = [sweep(replace(file, seed=seed), tmp_path / str(seed)) for seed in (1, 2, 3)]
    table = pd.concat([part.table for part in parts], ignore_index=True)
    table["run"] = table.index
    assert table["factor:gain.factor"].nunique() == 36
    (found,) = analyse(replace(parts[0], table=table)).findings
    assert found.spread.runs == 36
    # y = 2 f, but for rounding
    assert found.spread.mean == pytest.approx(2 * table["factor:gain.factor"].mean(), rel=1e-12)
