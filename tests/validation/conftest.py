"""A small run and reference for the validation tests: one shaft that turns and one pressure that rings."""

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from orchestrator.data.recording import read_recording
from orchestrator.data.trace import Trace
from orchestrator.results.validation import Validation, validate

Edit = Callable[[str, str], Path]  # the fixture `edited`


@pytest.fixture(scope="session")
def trace() -> Trace:
    """A run of 2 s at 1 ms in SI units."""
    t = np.arange(2001) * 1e-3
    signals = {
        "shaft.angle": 0.5 * np.sin(3 * t),
        "pump.pressure": 1e7 + 2e6 * np.exp(-t) * np.cos(20 * t),
        "pump.command": 10 * np.clip(t, 0, 1),
    }
    return Trace(t, signals, {"shaft.angle": "rad", "pump.pressure": "Pa", "pump.command": "V"})


@pytest.fixture(scope="session")
def written(tmp_path_factory: pytest.TempPathFactory, trace: Trace) -> Path:
    """A folder with ref.csv (10 ms, degrees and bar, 1 bar below the run) and ref.toml."""
    folder = tmp_path_factory.mktemp("reference")
    angle, pressure = np.degrees(trace["shaft.angle"][::10]), trace["pump.pressure"][::10] / 1e5 - 1.0
    table = pd.DataFrame({"time": trace.time[::10], "shaft.angle": angle, "pump.pressure": pressure})
    table.to_csv(folder / "ref.csv", float_format="%.12g", index=False)
    shutil.copy(Path(__file__).with_name("shaft.toml"), folder / "ref.toml")
    return folder


@pytest.fixture
def folder(tmp_path: Path, written: Path) -> Path:
    """A copy of that folder, to be changed."""
    return shutil.copytree(written, tmp_path, dirs_exist_ok=True)


@pytest.fixture(scope="session")
def outcome(written: Path, trace: Trace) -> Validation:
    """The run compared with the reference."""
    return validate(trace, read_recording(written / "ref.csv"))


@pytest.fixture
def edited(folder: Path) -> Edit:
    """Replace text in ref.toml or, if it is not there, in ref.csv; returns the TOML's path."""

    def edit(old: str, new: str) -> Path:
        for name in ("ref.toml", "ref.csv"):
            text = (folder / name).read_text(encoding="utf-8")
            if old in text:
                (folder / name).write_text(text.replace(old, new, 1), encoding="utf-8")
                return folder / "ref.toml"
        raise AssertionError(f"{old!r} is in neither file")

    return edit
