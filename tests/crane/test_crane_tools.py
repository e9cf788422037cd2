"""Cranes in other tools: FMPy, OpenModelica and Ecos, against the monolithic solution."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from fmpy import simulate_fmu
from fmpy.validation import validate_fmu
from kit import shards
from kit.cranes import crane, solved
from kit.openmodelica import simulated
from kit.work_cycle import load

from fmus.crane.machine import crane_build
from orchestrator.__main__ import main

pytestmark = shards.tools

STOP = 12.0  # s: strokes of the first levers
SHOWN = {
    "loader": ("slew_angle", "boom_angle", "jib_angle", "extension_extension", "link_angle"),
    "feric": ("swing_angle", "boom_angle", "stick_angle"),
}


class Built(NamedTuple):
    """FMUs of a crane; times, and the outputs of its manipulator by the monolithic solution."""

    name: str
    folder: Path
    time: np.ndarray
    true: dict[str, np.ndarray]


@pytest.fixture(scope="module", params=[*SHOWN])
def built(request, tmp_path_factory):
    """FMUs, system and solution of a crane."""
    name = request.param
    folder = tmp_path_factory.mktemp(name)
    crane_build(crane(name)).write(folder)
    solution = solved(folder, name, STOP)
    return Built(name, folder, solution["time"], {n: solution[f"manipulator.{n}"] for n in SHOWN[name]})


def agrees(built, time, found, limit):
    """Each coordinate is within a share of its range of the monolithic solution."""
    for name, values in found.items():
        true = np.interp(time, built.time, built.true[name])
        error = float(np.sqrt(np.mean((values - true) ** 2)) / np.ptp(built.true[name]))
        assert error < limit, f"{name}: {error:.1e}"


@pytest.mark.parametrize("built", ["loader"], indirect=True)  # which has every kind of joint and part
def test_the_fmus_of_a_crane_are_valid(built, capsys):
    """`harvester check` finds no error and no warning, FMPy's validation no problem."""
    for file in sorted(built.folder.rglob("*.fmu")):
        assert validate_fmu(str(file)) == []
        assert main(["check", str(file)]) == 0
        assert "0 errors, 0 warnings" in capsys.readouterr().out


@pytest.mark.parametrize("kind", ["CoSimulation", "ModelExchange"])
def test_fmpy_runs_a_crane_as_one_block(built, kind):
    """With the commands of its operator, which it sets every 5 ms: within 0.5 % of the range."""
    operator = simulate_fmu(str(built.folder / "operator_input.fmu"), stop_time=STOP, output_interval=5e-3)
    names = [n for n in operator.dtype.names if n.endswith(("_command", "payload_mass")) or n == "time"]
    rows = simulate_fmu(
        *(str(built.folder / f"{built.name}.fmu"),),
        **{"fmi_type": kind, "stop_time": STOP, "output_interval": 5e-3, "input": operator[names]},
    )
    agrees(built, rows["time"], {n: rows[n] for n in built.true}, 5e-3)


def test_openmodelica_integrates_the_system_of_a_crane(built, tmp_path):
    """The FMUs for Model Exchange under DASSL: within 1e-5 of the range."""
    model, file = f"Systems.{built.name.capitalize()}", built.folder / f"{built.name}.ssp"
    experiment = f"stopTime = {STOP}, numberOfIntervals = 2400, tolerance = 1e-8"
    rows = simulated(file, tmp_path, model, experiment)
    agrees(built, rows["time"], {n: rows[f"manipulator.{n}"] for n in built.true}, 1e-5)


def test_ecos_steps_the_system_of_a_crane(built):
    """Its SSP as it is, Jacobi at 1 ms with the rate ports: within 1e-3 of the range."""
    ecos = load("ecospy")
    rows, names = [], [f"manipulator::{n}" for n in built.true]
    with ecos.EcosSimulation(step_size=1e-3, ssp_path=str(built.folder / f"{built.name}.ssp")) as simulation:
        assert simulation.init()
        for n in range(1, round(STOP / 1e-3) + 1):
            simulation.step()
            if n % 20 == 0:
                rows.append([n * 1e-3, *(simulation.get_real(name) for name in names)])
        simulation.terminate()
    columns = np.array(rows).T
    agrees(built, columns[0], dict(zip(built.true, columns[1:], strict=True)), 1e-3)
