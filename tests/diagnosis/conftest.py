"""A machine with faults, sensors and its diagnosis, and work that shows what is broken."""

import numpy as np
import pytest

from fmus.machine.build import harvester


@pytest.fixture(scope="session")
def faulty(once):
    """Folder of the FMUs and systems."""
    return once("faulty", lambda folder: harvester(faults=True).write(folder))


@pytest.fixture(scope="session")
def fmu(diagnosis_fmu):
    """The diagnosis of the harvester alone."""
    return diagnosis_fmu


@pytest.fixture(scope="session")
def work():
    """Strokes to and fro of all functions, with rests, over 60 s; they end where they began."""
    time = np.arange(0, 60.01, 0.02)
    columns = {"time": time}
    for axis, begin, period in (("swing", 0.5, 6.0), ("boom", 2.5, 7.0), ("stick", 4.0, 8.0)):
        phase = (time - begin) % period
        there, back = (np.clip(np.minimum(phase - t, t + 1.2 - phase) / 0.3, 0, 1) for t in (0.0, 2.7))
        columns[f"{axis}_lever"] = 3.0 * (there - back) * (time > begin)
    return columns
