"""A machine with faults, sensors and its diagnosis, and work that shows what is broken."""

import numpy as np
import pytest

from fmus.machine.build import build_machine


@pytest.fixture(scope="session")
def faulty(tmp_path_factory):
    """Folder of the FMUs and systems."""
    folder = tmp_path_factory.mktemp("faulty")
    build_machine(folder, (2,), faults=True)
    return folder


@pytest.fixture(scope="session")
def work():
    """Strokes to and fro of all functions, with rests, over 60 s; they end where they began."""
    time = np.arange(0, 60.01, 0.02)
    columns = {"time": time}
    for axis, begin, size, period in (
        ("swing", 0.5, 3.0, 6.0),
        ("boom", 2.5, 3.0, 7.0),
        ("stick", 4.0, 3.0, 8.0),
    ):
        phase = (time - begin) % period
        stroke = np.clip(np.minimum(phase, 1.2 - phase) / 0.3, 0, 1) - np.clip(
            np.minimum(phase - 2.7, 3.9 - phase) / 0.3, 0, 1
        )
        columns[f"{axis}_lever"] = size * stroke * (time > begin)
    return columns
