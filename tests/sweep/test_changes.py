"""One line says what is not as it was: the first difference, as the file names it, and how many others."""

from __future__ import annotations

from pathlib import Path

import pytest
from sweep.studies import GAIN, study

from orchestrator.studies.cases import resolve
from orchestrator.studies.store import changes, to_json
from orchestrator.studies.study import read

MORE = (
    GAIN.replace('"latin"', '"grid"').replace("runs = 12\n", "")
    + """start = 0.05

[outputs.other]
signal = "gain.y"
measure = "maximum"

[choices]
scenario = ["up.csv", "down.csv"]

[factors."gain.offset"]
distribution = "values"
values = [10, 20]
unit = "mm"
"""
)
OLD = 'distribution = "uniform"\nminimum = 1\nmaximum = 3\n'
TEXT = MORE.replace(OLD, 'distribution = "values"\nvalues = [1, 2]\n').replace('[fixed]\n"gain.u" = 2\n', "")
LIST = ", ".join(map(str, range(40)))


def _changes(folder: Path, fmu: Path, one: str, other: str) -> str:
    """The reported changes between two texts of a study."""
    for name in ("up", "down"):
        (folder / f"{name}.csv").write_text("time,u\n0,0\n0.2,1\n")
    old, new = (to_json(resolve(read(study(folder, text, fmu)))[0]) for text in (one, other))
    return changes({"study": old, "files": {}}, {"study": new, "files": {}})


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("values = [1, 2]", "values = [1, 4]", 'factors."gain.factor".values was [1.0, 2.0], is [1.0, 4.0]'),
        ("[10, 20]", "[10, 30]", 'factors."gain.offset".values was [0.01, 0.02] m, is [0.01, 0.03] m'),
        ('"final"', '"mean"', 'outputs.end.measure was "final", is "mean"'),
        ('"final"', '"integral"', 'outputs.end.measure was "final", is "integral"'),
        ("start = 0.05", "start = 0.1", "outputs.end.start was 0.05, is 0.1"),
        ("start = 0.05", "", "outputs.end.start was 0.05, is null"),
        ("[outputs.other]", "[outputs.another]", "outputs.other is no longer there, and 1 more changed"),
        (
            '["up.csv", "down.csv"]',
            '["up.csv"]',
            'choices.scenario was ["up.csv", "down.csv"], is ["up.csv"]',
        ),
        ("band = true", "", "outputs.end.band was true, is false"),
        ("seed = 3\nstop = 0.2", "seed = 4\nstop = 0.1", "seed was 3, is 4, and 1 more changed"),
        ("outputs.end]", "outputs.zend]", "outputs.end is no longer there, and 1 more changed"),
    ],
)
def test_the_first_difference_is_told(gain: Path, tmp_path: Path, old: str, new: str, expected: str) -> None:
    """By the name of the item and the key in it, and never cut before the difference."""
    assert old in TEXT
    assert _changes(tmp_path, gain, TEXT, TEXT.replace(old, new)) == expected


def test_an_end_of_a_range_is_told_by_its_name(gain: Path, tmp_path: Path) -> None:
    """With the unit of the FMU; of another distribution its numbers go without saying."""
    one = GAIN.replace("gain.factor", "gain.offset")
    two = one.replace("minimum = 1", "minimum = 1.5")
    assert _changes(tmp_path, gain, one, two) == 'factors."gain.offset".minimum was 1 m, is 1.5 m'
    other = one.replace(OLD, 'distribution = "normal"\nmean = 1\nsd = 3\n')
    expected = 'factors."gain.offset".distribution was "uniform", is "normal"'
    assert _changes(tmp_path, gain, one, other) == expected


def test_of_a_long_list_the_item_is_told(gain: Path, tmp_path: Path) -> None:
    """Or how long it was and is."""
    one = TEXT.replace("values = [1, 2]", f"values = [{LIST}]")
    two = one.replace(" 38,", " 38.5,")
    assert _changes(tmp_path, gain, one, two) == 'factors."gain.factor".values[38] was 38, is 38.5'
    two = one.replace(" 38,", "")
    assert _changes(tmp_path, gain, one, two) == 'factors."gain.factor".values had 40 items, has 39'


def test_another_order_of_factors_is_told(gain: Path, tmp_path: Path) -> None:
    """The samples follow it."""
    first, second = ('[factors."gain.factor"]', '[factors."gain.offset"]')
    one = GAIN + f"\n{second}\n{OLD}"
    two = one.replace(first, "[factors.x]").replace(second, first).replace("[factors.x]", second)
    assert (
        _changes(tmp_path, gain, one, two)
        == "the order of factors was gain.factor, gain.offset, is gain.offset, gain.factor"
    )


def test_equal_studies_have_no_difference(gain: Path, tmp_path: Path) -> None:
    """No change is reported."""
    assert _changes(tmp_path, gain, TEXT, TEXT) == ""
