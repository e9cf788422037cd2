"""The FMUs and their system in FMPy: single FMUs, its SSP simulation, and a loop over its classes."""

from collections.abc import Sequence

import numpy as np
import pytest
from fmpy import simulate_fmu
from fmpy.ssp.simulation import simulate_ssp
from fmpy.ssp.ssd import read_ssv
from kit import shards
from kit.fmu import Fmu
from kit.plain_jacobi import SAME, ours
from kit.work_cycle import FMUS, ORDER, RATED, SIGNALS, STEP, VERSIONS, agree, check_log, same, step_through

from fmus.machine.parts import FERIC
from fmus.machine.poses import POSES


@pytest.mark.parametrize("kind", ["CoSimulation", "ModelExchange"])
@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("name", FMUS)
def test_fmpy_runs_each_fmu(request, capfd, name, version, kind):
    """simulate_fmu with all defaults: every output is finite and the log has no error."""
    path = request.getfixturevalue(version) / f"{name}.fmu"
    rows = simulate_fmu(str(path), fmi_type=kind, stop_time=0.5, output_interval=5e-3)
    assert all(np.isfinite(rows[column]).all() for column in rows.dtype.names)
    check_log("".join(capfd.readouterr()))


# one step without forces leaves the arm swinging for a second: measured 1.7e-3, 7e-5 and 2.6e-3 at 1 ms, and
# 8e-3, 3e-4 and 1.4e-2 at 5 ms
LIMITS = {1e-3: (5e-3, 5e-4, 1e-2), 5e-3: (2e-2, 1e-3, 3e-2)}


@pytest.mark.parametrize("step", shards.few([5e-3], LIMITS, shards.machine))
def test_fmpy_runs_the_ssp(fmu_dir, capfd, step):
    """simulate_ssp on harvester.ssp as it is: at 1 ms within the bars of the project's own master.

    FMPy gives zeros to all connected inputs in the first step: forces, positions, pressures.
    """
    rows = simulate_ssp(str(fmu_dir / "harvester.ssp"), stop_time=10.0, step_size=step)
    limits = dict(zip(("speed", "angle", "pressure"), LIMITS[step], strict=True))
    agree(rows["time"] + step, {name: rows[name] for name in SIGNALS}, limits)  # FMPy stamps the step's start
    check_log("".join(capfd.readouterr()))


def test_fmpy_starts_from_a_pose_of_the_ssp(fmu_dir):
    """A pose set carries what FMPy does not pass on at initialisation: the arm stands where it was put."""
    system = str(fmu_dir / "harvester.ssp")
    chosen = read_ssv(system, "resources/raised.ssv")
    chosen.parameters += read_ssv(system, "resources/still.ssv").parameters
    rows = simulate_ssp(system, stop_time=0.5, step_size=STEP, parameter_set=chosen)
    for joint in ("boom", "stick"):
        # 1 ms without forces moves it by 2e-4 rad; without the set's holding forces it would be 3e-3 and more
        angle = getattr(POSES["raised"], joint)
        np.testing.assert_allclose(rows[f"manipulator.{joint}_angle"], angle, rtol=0, atol=5e-4)


def carry(parts: dict[str, Fmu], wires: Sequence[tuple[str, str]]) -> None:
    """Read all sources, then set all targets."""
    ends = [(*start.split("."), *end.split(".")) for start, end in wires]
    found = [parts[source][output] for source, output, _, _ in ends]
    for (_, _, target, name), value in zip(ends, found, strict=True):
        parts[target].set(**{name: value})


@pytest.mark.parametrize("version", VERSIONS)
def test_fmpy_steps_the_system_as_we_do(request, fmu_dir, capfd, version):
    """A loop over FMPy's classes, in FMI 2.0 and 3.0, gives the numbers of our own orchestrator."""
    folder = request.getfixturevalue(version)
    parts = {name: Fmu(folder / f"{name}.fmu").enter() for name in ORDER}
    carry(parts, FERIC.holding)
    for part in parts.values():
        part.fmu.exitInitializationMode()
    carry(parts, RATED)

    def step() -> None:
        for part in parts.values():
            part.step(STEP)
        carry(parts, RATED)

    def take() -> list[float]:
        return [parts[name.split(".")[0]][name.split(".")[1]] for name in SIGNALS]

    _, found = step_through(2.0, step, take)
    for part in parts.values():
        part.fmu.terminate()
        part.close()
    same(found, ours(fmu_dir, STEP, 42.0), SAME)
    check_log("".join(capfd.readouterr()))
