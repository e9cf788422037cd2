"""A recording in a folder as a logger writes it, and one in memory."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from orchestrator.data.recording import Recording, Sensor

RATE, SIZE = 200.0, 4000
T = np.arange(SIZE) / RATE
GAUGE = Sensor("gauge", noise=0.1, resolution=400 / 4096, low=0.0, high=400.0)
META = Path(__file__).with_name("valve.toml").read_text(encoding="utf-8")


def edit(file: Path, *changes: tuple[str, str]) -> None:
    """Change a description, each text once."""
    text = file.read_text(encoding="utf-8")
    for old, new in changes:
        assert old in text
        text = text.replace(old, new, 1)
    file.write_text(text, encoding="utf-8")


def rounded(values, resolution):
    """Values of a converter."""
    return np.round(values / resolution) * resolution


@pytest.fixture
def columns() -> dict[str, np.ndarray]:
    """Raw columns of META with one gap: 40 samples at 200 Hz."""
    k = np.arange(40)
    pressure = 2.5 + 0.1 * np.sin(0.3 * k)
    pressure[7] = np.nan
    return {"t": 5.0 * k, "U": np.repeat([0.0, 2.5, -1.0, 4.0], 10), "P1": pressure, "Q": 1.7 * k}


@pytest.fixture
def csv(tmp_path, columns) -> Path:
    """The columns as a CSV file of a logger, a gap as an empty cell, with its description."""
    (tmp_path / "a.toml").write_text(META, encoding="utf-8")
    pd.DataFrame(columns).to_csv(tmp_path / "a.csv", index=False)
    return tmp_path / "a.csv"


def recording(rate: float = RATE, sensors: dict[str, Sensor] | None = None, **signals) -> Recording:
    """A recording in memory; no signal has a unit."""
    n = len(next(iter(signals.values())))
    return Recording(
        np.arange(n) / rate,
        {name: np.asarray(values, dtype=float) for name, values in signals.items()},
        dict.fromkeys(signals, "1"),
        Path("memory.csv"),
        procedure="valve",
        conditions={"edge": "P-A"},
        sensors=sensors or {},
    )
