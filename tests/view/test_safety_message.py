"""Messages from a browser: what is believed, and that everything else is one Problem."""

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from orchestrator.base.errors import Problem
from orchestrator.drive.sticks import StickAxes
from orchestrator.view.authority import Message, TokenBucket, parse

GOOD = {"n": 3, "sticks": [0, -1, 0.25, 1], "dead_man": True}


def test_good() -> None:
    """An honest message is what it says."""
    assert parse(json.dumps(GOOD)) == Message(3, StickAxes(0, -1, 0.25, 1), True)


STICKS = ([], [0] * 3, [0] * 25, "0000", None, {"0": 1})
VALUES = ("1.0001", "-2", "1e308", "1e999", "-1e999", "NaN", "Infinity", "true", "null", '"1"', "[1]")
WRONG = {
    "not json": "{",
    "binary": json.dumps(GOOD).encode(),
    "nothing": "",
    "array": "[]",
    "number": "17",
    "null": "null",
    "a key too few": json.dumps({"n": 1, "dead_man": True}),
    "a key too many": json.dumps(GOOD | {"axis": "x"}),
    "huge": json.dumps(GOOD | {"sticks": [0.1] * 1000}),
    "deep": "[" * 250,
    "long number": '{"n":' + "9" * 240 + "}",
    **{f"n {n!r}": json.dumps(GOOD | {"n": n}) for n in (-1, 2**53, 1.0, True, "1", None, [])},
    **{f"sticks {s!r}": json.dumps(GOOD | {"sticks": s}) for s in STICKS},
    **{f"value {v}": json.dumps(GOOD).replace("0.25", v) for v in VALUES},
    **{f"dead man {d!r}": json.dumps(GOOD | {"dead_man": d}) for d in (1, 0, "true", None)},
}


@pytest.mark.parametrize("raw", WRONG.values(), ids=WRONG.keys())
def test_wrong(raw: str | bytes) -> None:
    """Whatever is wrong is told in one short line."""
    with pytest.raises(Problem, match="message: ") as told:
        parse(raw)
    assert "\n" not in str(told.value)
    assert len(str(told.value)) < 200


@given(st.text() | st.binary())
def test_garbage(raw: str | bytes) -> None:
    """Arbitrary text and bytes are a Problem and no other exception."""
    with pytest.raises(Problem):
        parse(raw)


def shaped(inner: st.SearchStrategy[object]) -> st.SearchStrategy[object]:
    return st.lists(inner, max_size=4) | st.dictionaries(st.sampled_from(["n", "sticks", "dead_man"]), inner)


@given(st.recursive(st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5), shaped))
def test_garbage_of_the_right_shape(found: object) -> None:
    """JSON that looks like a message is a message within its bounds, or a Problem."""
    try:
        message = parse(json.dumps(found))
    except Problem:
        return
    assert all(abs(value) <= 1 for value in vars(message.sticks).values())


def test_bucket() -> None:
    """At once as many as it holds, then the steady rate, however long it was quiet before."""
    bucket = TokenBucket(rate=10, depth=5, content=5)
    assert [bucket.take(100.0) for _ in range(7)] == [True] * 5 + [False] * 2
    # a fifth of a second fills two
    assert [bucket.take(100.2) for _ in range(3)] == [True, True, False]
    assert not bucket.take(99.0)
