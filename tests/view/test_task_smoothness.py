"""The spectral arc length: what it must not depend on, and what it must show."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from orchestrator.view.task.score import spectral_arc_length

TIME = np.arange(0, 10, 0.01)


def bells(*centres: float, width: float = 0.5) -> NDArray[np.float64]:
    """Speeds of bell-shaped movements."""
    return np.sum([np.exp(-(((TIME - c) / width) ** 2)) for c in centres], axis=0)


@given(st.floats(1e-3, 1e3))
def test_size_does_not_matter(size: float) -> None:
    """A larger movement of the same form is as smooth."""
    # rounding only
    assert spectral_arc_length(TIME, size * bells(5)) == pytest.approx(
        spectral_arc_length(TIME, bells(5)), rel=1e-9
    )


def test_bell_by_hand() -> None:
    """The spectrum of exp(-(t/w)^2) is exp(-(pi f w)^2): its arc down to 0.05, by quadrature."""
    end = np.sqrt(np.log(20)) / (np.pi * 0.5)
    f = np.linspace(0, end, 100_001)
    arc = np.sum(np.hypot(np.diff(f) / end, np.diff(np.exp(-((np.pi * f * 0.5) ** 2)))))
    # the end of the arc lies on a line of the padded spectrum: up to 1/109 of its width beside it
    assert spectral_arc_length(TIME, bells(5)) == pytest.approx(-arc, rel=0.01)


def test_more_stops_are_less_smooth() -> None:
    """Each further start and stop makes it more negative."""
    values = [spectral_arc_length(TIME, bells(*np.arange(1, n + 1) * 1.5)) for n in range(1, 6)]
    assert all(a > b for a, b in itertools.pairwise(values))


def test_nothing() -> None:
    """No movement and no time have no smoothness."""
    assert spectral_arc_length(TIME, 0 * TIME) is None
    assert spectral_arc_length(TIME[:3], TIME[:3]) is None
