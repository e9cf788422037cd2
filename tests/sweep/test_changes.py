"""One line says what is not as it was: the first difference, as the file names it, and how many others."""

import json
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


def test_long_values_are_not_told(told):
    """The line stays one that can be read; the order of the factors counts, as the samples follow it."""
    one = TEXT.replace("values = [1, 2]", f"values = [{LIST}]")
    assert told(one, one.replace(" 38,", " 38.5,")) == 'factors."gain.factor".values changed'
    first, second = ('[factors."gain.factor"]', '[factors."gain.offset"]')
    one = GAIN + f"\n{second}\n{OLD}"
    two = one.replace(first, "[factors.x]").replace(second, first).replace("[factors.x]", second)
    names = ["gain.factor", "gain.offset"]
    assert told(one, two) == f"factors was {json.dumps(names)}, is {json.dumps(names[::-1])}"
    assert told(TEXT, TEXT) == ""
