"""What a run is compared with may be any file that identification reads, with gaps in it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import scipy.io

from orchestrator.base.errors import Problem
from orchestrator.data.recording import Recording, fill_gaps, read_recording
from orchestrator.data.trace import Trace
from orchestrator.results.validation import validate


@pytest.mark.parametrize("kind", ["parquet", "mat"])
def test_parquet_and_matlab_are_compared_like_csv(folder: Path, trace: Trace, kind: str) -> None:
    """The same columns in another file give the same metrics; a gap is left out and counted."""
    table = pd.read_csv(folder / "ref.csv")
    table.loc[20:29, "shaft.angle"] = np.nan
    csv = read_recording(folder / "ref.toml")
    (folder / "ref.csv").unlink()
    if kind == "parquet":
        table.to_parquet(folder / "ref.parquet")
    else:
        text = (folder / "ref.toml").read_text(encoding="utf-8")
        for name in ("shaft.angle", "pump.pressure"):  # a dot is a struct in MATLAB
            column = f'[signals."{name}"]\ncolumn = "{name.replace(".", "_")}"'
            text = text.replace(f'[signals."{name}"]', column)
        (folder / "ref.toml").write_text(text, encoding="utf-8")
        columns = {name.replace(".", "_"): table[name].to_numpy() for name in table}
        scipy.io.savemat(folder / "ref.mat", columns)
    found = validate(trace, read_recording(folder / "ref.toml"), rate=False)
    expected = validate(trace, csv, rate=False)
    assert found["pump.pressure"].metrics == expected["pump.pressure"].metrics
    assert found["shaft.angle"].notes == ("10 of 201 samples are in gaps of the reference, left out",)
    assert len(found["shaft.angle"].time) == 191


def test_short_gaps_of_a_command_are_bridged() -> None:
    """What drives a run has a value at every time; half a second without is refused."""
    time = np.arange(0.0, 2.0, 0.01)
    short = np.where((time > 0.495) & (time < 0.555), np.nan, time)
    made = Recording(Path("ref.csv"), time, {"short": short, "none": np.full(200, np.nan)}, {})
    np.testing.assert_allclose(fill_gaps(made, "short"), time, atol=1e-15)  # a straight line, rounding
    with pytest.raises(
        Problem, match=r"ref.csv: short: expected gaps of at most 0.05 s, got one from 0.5 s to 0.55 s"
    ):
        fill_gaps(made, "short", longest=0.05)
    with pytest.raises(Problem, match=r"ref.csv: none: expected a sample"):
        fill_gaps(made, "none")
    np.testing.assert_allclose(made.trace()["short"], time, atol=1e-15)
    assert "none" not in made.trace().signals
