"""Messages of a worker: data comes back as it was, and no other bytes are taken for a message."""

import io
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from orchestrator.base.errors import Problem
from orchestrator.worker import wire
from orchestrator.worker.wire import Garbled, packed, read_message


@dataclass(frozen=True)
class Found:
    name: str
    values: NDArray[np.float64]
    counts: NDArray[np.int32] | None
    spans: tuple[float, float]
    names: tuple[str, ...]
    by_name: Mapping[str, float]
    problem: Problem | None = None
    local: Any = field(default=None, metadata={"local": True})


CONTENTS = {"found": Found, "any": Any, "time": float, "flag": bool, "array": NDArray[np.float64]}


def frame(name: str, content: Any, number: int = 0) -> bytes:
    return b"".join(packed(number, name, content))


def read(data: bytes, number: int = 0) -> tuple[str, Any]:
    return read_message(io.BufferedReader(io.BytesIO(data)), number, lambda: CONTENTS)


def test_data_comes_back_as_it_was() -> None:
    """Numbers that are not finite, empty arrays, texts of any kind; what is local stays."""
    sent = Found(
        name="µ\udc80\n",
        values=np.array([[1.5, np.nan], [np.inf, -0.0]]),
        counts=np.zeros((0, 3), np.int32),
        spans=(np.float64(0.1), np.inf),
        names=("a", ""),
        by_name={"x": 1},
        problem=Problem("no\nline"),
        local=object(),
    )
    _, found = read(frame("found", sent))
    np.testing.assert_array_equal(found.values, sent.values)
    assert found.counts.shape == (0, 3)
    found.values[0, 0] = 2.0  # memory of its own
    assert (str(found.problem), found.local) == ("no\\nline", None)
    for name in ("name", "spans", "names", "by_name"):
        assert getattr(found, name) == getattr(sent, name)
    assert {type(v) for v in (*found.spans, found.by_name["x"])} == {float}
    assert read(frame("any", {"a": [b"\0\xff", None, (1, "b")]}))[1] == {"a": [b"\0\xff", None, [1, "b"]]}


@given(st.integers(0, 400), st.binary(min_size=1, max_size=80))
def test_added_bytes_are_no_message(place: int, added: bytes) -> None:
    """Wherever another thread writes into a frame; after its end it is complete."""
    good = frame("array", np.arange(20.0))
    place %= len(good)
    if good[:place] + added + good[place:] == good + added:  # repeats what follows
        return
    with pytest.raises((Garbled, EOFError)):
        read(good[:place] + added + good[place:])


@pytest.mark.parametrize(
    "content",
    [
        *(
            ("flag", 1),
            ("time", "1"),
            ("time", True),
            ("unknown", 0),
            ("array", [0.0]),
            ("array", b"12345678"),
        ),
        *(("array", np.zeros(2, np.float32)), ("found", {"name": "a"}), ("found", {"other": 1})),
        *(("array", {"@": [8, "<f8", [1]]}), ("array", {"@": [-8, "<f8", [1]]})),
        *(("array", {"@": [0, "<f8", [-1]]}), ("array", {"@": [0, "<f8", [1 << 60, 1 << 60]]})),
        ("any", {"@": [0, "", "x"]}),
    ],
)
def test_another_content_is_no_message(content: tuple[str, Any]) -> None:
    """Other types, arrays outside of the bytes, names that nobody expects."""
    with pytest.raises(Garbled):
        read(frame(*content))


def test_a_frame_counts_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """A second process that sends the same frames is found, and so are sizes beyond any message."""
    assert read(frame("time", 1.0, 7), 7) == ("time", 1.0)
    with pytest.raises(Garbled):
        read(frame("time", 1.0, 7), 8)
    with pytest.raises(EOFError):
        read(frame("time", 1.0)[:-1])
    for limit, content in (("MOST_TEXT", ["a name"] * 9), ("MOST_BYTES", np.zeros(2))):
        large = frame("array", content)
        with monkeypatch.context() as patch:
            patch.setattr(wire, limit, 10)
            with pytest.raises(Garbled):
                read(large)
            with pytest.raises(ValueError, match="too long"):
                frame("array", content)
