"""A choice of one option says what all runs have: it is no choice in design, analysis and report."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
from sweep.synthetic import ishigami, results, uniform

from orchestrator.studies import design
from orchestrator.studies.analysis.analyse import analyse
from orchestrator.studies.report.study_page import NUMBERS, PAGE, write
from orchestrator.studies.study import Choice, Factor

POSE = Choice("parameters", ("reach",))
SCENARIO = Choice("scenario", ("levers.csv",), sampled=True)
TWO = Choice("swing", ("lumped", "detailed"))
GRID = tuple(Factor(f"x{i}", "values", {"values": (0.5, 1.0, 2.0)}, unit="m") for i in (1, 2, 3))
SPACE = tuple(uniform(f"x{i}", -3.0, 3.0) for i in (1, 2, 3))
METHODS = {"morris": 6, "saltelli": 32, "latin": 220, "sobol": 64, "grid": 0}


@pytest.mark.parametrize("others", [(), (TWO,)])
@pytest.mark.parametrize("method", METHODS)
def test_one_option_changes_nothing(method: str, others: tuple[Choice, ...], tmp_path: Path) -> None:
    """All numbers are those of the study without it, for options that are drawn and that are crossed."""
    space = GRID if method == "grid" else SPACE
    plain = results(ishigami, space, method, METHODS[method], others)
    found = results(ishigami, space, method, METHODS[method], (POSE, *others, SCENARIO))
    assert len(found.table) == found.study.count == len(plain.table)
    assert set(found.table[POSE.column]) == {"reach"}
    one, two = analyse(found), analyse(plain)
    assert one == two
    write(tmp_path, found, one)
    numbers = json.loads((tmp_path / NUMBERS).read_text("utf-8"))
    names = [e["name"] for e in numbers["findings"][0]["sensitivity"]["effects"]]
    assert sorted(names) == sorted([*(f.name for f in space), *(c.name for c in others)])
    page = (tmp_path / PAGE).read_text("utf-8")
    assert f"3 factors{', 1 choice' if others else ''}, " in page
    assert "By parameters" not in page
    assert 'reach <span class="soft">in all runs</span>' in page


def test_options_are_all_that_differs_in_the_columns() -> None:
    """The samples of the factors are those of the study without the option."""
    study = results(ishigami, SPACE, "saltelli", 8, (POSE,)).study
    table = design.table(study)
    assert table.drop(columns=POSE.column).equals(design.table(replace(study, choices=())))
