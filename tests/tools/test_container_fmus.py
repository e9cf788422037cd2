"""The machine as one FMU: containers that other tools build from the four FMUs, against our own master."""

import shutil
from copy import copy
from pathlib import Path
from typing import Any

import pytest
from fmpy import read_model_description, simulate_fmu
from fmpy.container_fmu.cli import create_container_fmu
from fmpy.container_fmu.config import Component, Configuration, Connection
from fmpy.model_description import CoSimulation, ModelDescription, ModelVariable
from kit import shards
from kit.plain_jacobi import ours
from kit.work_cycle import JACOBI, ORDER, RATED, SIGNALS, STEP, agree, check_log, load, same

pytestmark = shards.tools

# the same algorithm; what is left is rounding of the times of the steps, and what the inner steps of the
# solvers make of it: measured 7e-12 in the pressures of the boom after 42 s
SAME = 1e-10
# the container of fmu-manipulation-toolbox tells this of any FMU, as errors and warnings of its own
TOOLBOX = (
    "[WARNING] FMUContainer 'V2.0'",
    "[ERROR] Solver configure....",
    "[WARNING] Container use PARALLEL mode with MONO thread.",
)
versions = pytest.mark.parametrize(("folder", "version"), [("fmu_dir", 2), ("fmi3_dir", 3)])


def rank(wire: tuple[str, str]) -> int:
    """Motion is carried first, then force, acceleration, rates: each depends directly on those before."""
    ranks = {"force": 1, "torque": 1, "acceleration": 2, "rate": 3}
    return ranks.get(wire[0].rsplit("_", 1)[-1], 0)


def fmpy_container(folder: Path, target: Path, version: int) -> Path:
    """The four FMUs and their connections in one FMU, by FMPy."""
    parts, variables = {}, {}
    for name in ORDER:
        description = read_model_description(str(folder / f"{name}.fmu"))
        parts[name] = Component(name, folder / f"{name}.fmu", description)
        variables |= {f"{name}.{v.name}": v for v in description.modelVariables}

    def end(port: str) -> tuple[Any, list[Any]]:
        variable = copy(variables[port])
        variable.type = "Float64"  # FMPy 0.3.32 writes "Real" for FMI 2.0, which its own container refuses
        return parts[port.split(".")[0]], [variable]

    real = "Real" if version == 2 else "Float64"
    clock = ModelVariable(name="time", type=real, causality="independent", variability="continuous")
    mapped = {}
    for name in SIGNALS:
        shown = {"causality": "output", "initial": "calculated", "variability": "continuous"}
        variable = ModelVariable(name=name.replace(".", "_"), type=real, **shown)
        mapped[variable] = [(parts[name.split(".")[0]], variables[name])]
    description = ModelDescription(
        fmiVersion=f"{version}.0",
        modelName="harvester",
        instantiationToken="harvester",
        modelVariables=[clock, *mapped],
        coSimulation=CoSimulation(fixedInternalStepSize=STEP),
    )
    wires = [Connection(*end(start), *end(stop)) for start, stop in sorted(RATED, key=rank)]
    system = Configuration(False, description, list(parts.values()), wires, mapped)
    (target / "unpacked").mkdir()
    create_container_fmu(system, target / "unpacked", target / "harvester.fmu")
    return target / "harvester.fmu"


@versions
def test_fmpy_container_runs_the_system(request, fmu_dir, tmp_path, capfd, folder, version):
    """The container steps its four parts by itself, over the whole work cycle: the numbers of our `jacobi`.

    It carries one connection after the other, so their order decides what is read with new inputs.
    """
    path = fmpy_container(request.getfixturevalue(folder), tmp_path, version)
    names = {name: name.replace(".", "_") for name in SIGNALS}
    # FMPy's own container lacks InitialUnknowns
    options = {"validate": False, "output": list(names.values())}
    rows = simulate_fmu(str(path), stop_time=42.0, output_interval=STEP, **options)
    found = {name: rows[column] for name, column in names.items()}
    agree(rows["time"], found, JACOBI)
    expected = ours(fmu_dir, STEP, 42.0, master="jacobi")
    same({name: values[20::20] for name, values in found.items()}, expected, SAME)
    check_log("".join(capfd.readouterr()))


@versions
def test_fmucontainer_reads_the_ssp(request, fmu_dir, tmp_path, capfd, caplog, folder, version):
    """fmu-manipulation-toolbox turns either SSP into one FMU: our numbers, and no error while it does so."""
    assembly = load("fmu_manipulation_toolbox.assembly")
    shutil.copy(request.getfixturevalue(folder) / "harvester.ssp", tmp_path)
    made = assembly.Assembly("harvester.ssp", default_step_size=STEP, fmu_directory=tmp_path)
    # it shows all that is not connected: our outputs, and supply_pressure and tank_pressure as inputs
    made.root.auto_input = made.root.auto_output = True
    made.make_fmu(fmi_version=version)
    assert not [record for record in caplog.records if record.levelname == "ERROR"]
    path = tmp_path / "harvester.fmu"
    variables = {v.name: v for v in read_model_description(str(path), validate=False).modelVariables}
    shown = {name: name if name in variables else name.split(".")[1] for name in SIGNALS}
    options = {"validate": False, "output": list(shown.values())}
    rows = simulate_fmu(str(path), stop_time=10.0, output_interval=STEP, **options)
    found = {name: rows[column] for name, column in shown.items()}
    agree(rows["time"], found, JACOBI)
    same({name: values[20::20] for name, values in found.items()}, ours(fmu_dir, STEP, 42.0), SAME)
    check_log("".join(capfd.readouterr()), TOOLBOX)
