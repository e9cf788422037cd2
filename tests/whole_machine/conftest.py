"""The example examples/hydraulic_manipulator: its modules, its systems built once."""

import sys
from pathlib import Path

import pytest

# the example is a script, not an installed package
sys.path.insert(0, str(Path(__file__).parents[2] / "examples" / "hydraulic_manipulator"))


@pytest.fixture(scope="session")
def manipulator_systems(once) -> dict[str, Path]:
    """The SSP of the example with and without rate ports; both FMUs are in the same folder."""
    from machine import build

    folder = once("hydraulic_manipulator", build)
    return {ports: folder / f"hydraulic_manipulator_{ports}.ssp" for ports in ("rates", "held")}
