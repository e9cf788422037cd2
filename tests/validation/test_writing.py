"""Computed reference traces: written, and read back as they were."""

from __future__ import annotations

from dataclasses import replace
from datetime import date
from pathlib import Path

import numpy as np
import pytest

from orchestrator.base.errors import Problem
from orchestrator.data.description import Origin, Tolerance
from orchestrator.data.recording import read_recording, write_recording
from orchestrator.data.trace import Trace
from orchestrator.results.validation import validate

ORIGIN = Origin(
    title='The "joined" machine',
    origin="monolith, version 1",
    made_by="make reference",
    solver="Radau, order 5",
    relative_tolerance=1e-10,
    absolute_tolerance=1e-8,
    date=date(2026, 1, 31),
    change="first version",
)


def test_written_trace_is_read_back(tmp_path: Path, trace: Trace) -> None:
    """Numbers, units, groups, limits and the story of a reference survive the files."""
    meta = write_recording(
        tmp_path / "ref.csv",
        trace,
        ORIGIN,
        tolerances={"angle": Tolerance("nrmse", 0.0005)},
        groups={"shaft.angle": "angle", "pump.command": "command"},
        labels={"shaft.angle": "Shaft angle"},
    )
    found = read_recording(meta)
    assert found.metadata["title"] == 'The "joined" machine'
    assert found.metadata["date"] == "2026-01-31"
    assert found.criterion("shaft.angle").tolerance == Tolerance("nrmse", 0.0005)
    assert found.criterion("pump.command").tolerance is None
    assert found.file_units["pump.pressure"] == "Pa"
    outcome = validate(trace, found, rate=False)
    assert outcome.passed
    # nine digits in the CSV
    np.testing.assert_allclose(outcome["pump.pressure"].reference, trace["pump.pressure"], rtol=1e-8)


def test_reason_of_the_change_is_required(tmp_path: Path, trace: Trace) -> None:
    """Nobody records a reference again without saying why."""
    with pytest.raises(
        Problem, match=r"ref.csv: expected the reason of this change of the reference, got none"
    ):
        write_recording(tmp_path / "ref.csv", trace, replace(ORIGIN, change=" "), {}, {})
