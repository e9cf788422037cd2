"""What the page shows of shares and of medians: within the axis, and by their names."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from sweep.synthetic import Columns, effects, finding, results, uniform

from orchestrator.studies.analysis.analyse import analyse
from orchestrator.studies.report.study_figures import tornado
from orchestrator.studies.report.study_page import PAGE, write
from orchestrator.studies.study import Choice

TWO = Choice("swing", ("lumped", "detailed"))
SPACE = (uniform("x1", 0.0, 1.0), uniform("x2", 0.0, 1.0))


def _one(x: Columns) -> np.ndarray:
    """Nearly all of it is x1, in units of 1e5 Pa."""
    return 1e5 * (10 * x["x1"] ** 4 + 0.1 * x["x2"])


@pytest.mark.parametrize("choices", [(), (TWO,)])
@pytest.mark.parametrize("runs", [8, 16])
def test_shares_end_within_the_axis(runs: int, choices: tuple[Choice, ...]) -> None:
    """All marks, of a linear model (8) and of Sobol' indices (16); a cap at 100 % is in sight."""
    found = finding(results(_one, SPACE, "saltelli", runs, choices))
    assert found.sensitivity is not None
    estimate = effects(found)["x1"].estimates[found.sensitivity.measure]
    assert estimate.ceiling > 1.03  # beyond the axis, if it were drawn as it is
    axes = tornado(found, found.sensitivity).axes[0]
    drawn = np.concatenate([np.asarray(line.get_xdata(), float) for line in axes.lines])
    widths = [bar.get_width() for bar in axes.patches]
    assert drawn.max() == 100.0
    assert drawn.min() >= 0.0
    assert max(widths) <= 100.0
    assert min(widths) >= 0.0
    assert 100.0 < axes.get_xlim()[1] <= 103.0


def test_the_number_at_the_top_is_called_the_median(tmp_path: Path) -> None:
    """With the unit; of an output that is the same in all runs, that it is."""
    found = results(_one, SPACE, "latin", 30)
    write(tmp_path, found, analyse(found))
    page = (tmp_path / PAGE).read_text("utf-8")
    assert 'bar</b><span class="soft">median; ' in page
    assert " in nine of ten runs<br>" in page
    same = results(lambda x: np.full(len(x["x1"]), 3e6), SPACE, "latin", 30)
    write(tmp_path, same, analyse(same))
    assert '30 bar</b><span class="soft">in all 30 runs<br>' in (tmp_path / PAGE).read_text("utf-8")


def test_an_output_that_no_run_has_has_no_range(tmp_path: Path) -> None:
    """Nor is anything said of nine of ten runs."""
    found = results(_one, SPACE, "latin", 20, failed=lambda t: np.ones(len(t), bool))
    write(tmp_path, found, analyse(found))
    page = (tmp_path / PAGE).read_text("utf-8")
    assert '<b>-</b><span class="soft">no run has it<br>' in page
