"""One line says what is not as it was: the first difference, as the file names it, and how many others."""

from pathlib import Path

import pytest
from kit.mistakes import table
from sweep.studies import FACTOR, GAIN, resolved, study

from orchestrator.studies.store import changes, to_json

MORE = GAIN.replace('"latin"', '"grid"').replace("runs = 12\n", "")
MORE += Path(__file__).with_name("more.toml").read_text("utf-8")
OLD = FACTOR.partition("\n")[2]
TEXT = MORE.replace(OLD, 'distribution = "values"\nvalues = [1, 2]\n').replace('[fixed]\n"gain.u" = 2\n', "")
LIST = ", ".join(map(str, range(40)))


@pytest.fixture
def told(gain, tmp_path):
    """The reported changes between two texts of a study."""
    for name in ("up", "down"):
        (tmp_path / f"{name}.csv").write_text("time,u\n0,0\n0.2,1\n")

    def between(one, other):
        old, new = (to_json(resolved(study(tmp_path, text, gain))) for text in (one, other))
        return changes({"study": old, "files": {}}, {"study": new, "files": {}})

    return between


@table(__file__, "changes", "old, new, expected")
def test_the_first_difference_is_told(told, old, new, expected):
    """By the name of the item and the key in it, and never cut before the difference."""
    assert old in TEXT
    assert told(TEXT, TEXT.replace(old, new)) == expected


def test_ends_and_items_are_told_by_name(told):
    """With the unit of the FMU; of a long list the item, or how long it was and is."""
    one = GAIN.replace("gain.factor", "gain.offset")
    two = one.replace("minimum = 1", "minimum = 1.5")
    assert told(one, two) == 'factors."gain.offset".minimum was 1 m, is 1.5 m'
    other = one.replace(OLD, 'distribution = "normal"\nmean = 1\nsd = 3\n')
    expected = 'factors."gain.offset".distribution was "uniform", is "normal"'
    assert told(one, other) == expected
    one = TEXT.replace("values = [1, 2]", f"values = [{LIST}]")
    two = one.replace(" 38,", " 38.5,")
    assert told(one, two) == 'factors."gain.factor".values[38] was 38, is 38.5'
    two = one.replace(" 38,", "")
    assert told(one, two) == 'factors."gain.factor".values had 40 items, has 39'


def test_another_order_of_factors_is_told(told):
    """The samples follow it; between equal studies no change is reported."""
    first, second = ('[factors."gain.factor"]', '[factors."gain.offset"]')
    one = GAIN + f"\n{second}\n{OLD}"
    two = one.replace(first, "[factors.x]").replace(second, first).replace("[factors.x]", second)
    assert told(one, two) == "the order of factors was gain.factor, gain.offset, is gain.offset, gain.factor"
    assert told(TEXT, TEXT) == ""
