"""The machine as one FMU: containers that other tools build from the four FMUs, against the reference."""

from __future__ import annotations

import shutil
from copy import copy
from typing import Any

import pytest
from fmpy import read_model_description, simulate_fmu
from fmpy.model_description import CoSimulation, ModelDescription, ModelVariable
from work_cycle import JACOBI, ORDER, SIGNALS, STEP, agree, load

from fmus.machine import COMMAND_WIRES, CONNECTIONS


@pytest.fixture(scope="module")
def container(fmu_dir, tmp_path_factory):
    """The four FMUs and their connections in one FMU, by FMPy."""
    from fmpy.container_fmu.cli import create_container_fmu
    from fmpy.container_fmu.config import Component, Configuration, Connection

    folder = tmp_path_factory.mktemp("container")
    parts, variables = {}, {}
    for name in ORDER:
        description = read_model_description(str(fmu_dir / f"{name}.fmu"))
        parts[name] = Component(name, fmu_dir / f"{name}.fmu", description)
        variables |= {f"{name}.{v.name}": v for v in description.modelVariables}

    def end(port: str) -> tuple[Any, list[Any]]:
        variable = copy(variables[port])
        variable.type = "Float64"  # FMPy 0.3.32 writes "Real" for FMI 2.0, which its own container refuses
        return parts[port.split(".")[0]], [variable]

    clock = ModelVariable(name="time", type="Real", causality="independent", variability="continuous")
    mapped = {}
    for name in SIGNALS:
        shown = {"causality": "output", "initial": "calculated", "variability": "continuous"}
        variable = ModelVariable(name=name.replace(".", "_"), type="Real", **shown)
        mapped[variable] = [(parts[name.split(".")[0]], variables[name])]
    description = ModelDescription(
        fmiVersion="2.0",
        modelName="harvester",
        instantiationToken="harvester",
        modelVariables=[clock, *mapped],
        coSimulation=CoSimulation(fixedInternalStepSize=STEP),
    )
    wires = [Connection(*end(start), *end(stop)) for start, stop in CONNECTIONS + COMMAND_WIRES]
    system = Configuration(False, description, list(parts.values()), wires, mapped)
    (folder / "unpacked").mkdir()
    create_container_fmu(system, folder / "unpacked", folder / "harvester.fmu")
    return folder / "harvester.fmu"


def test_fmpy_container_runs_the_system(container):
    """The container FMU steps its four parts by itself, over the whole work cycle."""
    names = {name: name.replace(".", "_") for name in SIGNALS}
    rows = simulate_fmu(
        str(container),
        validate=False,  # FMPy's own container lacks InitialUnknowns
        stop_time=42.0,
        output_interval=STEP,
        output=list(names.values()),
    )
    agree(rows["time"], {name: rows[column] for name, column in names.items()}, JACOBI)


def test_fmucontainer_reads_the_ssp(fmu_dir, tmp_path):
    """fmu-manipulation-toolbox turns the SSP into one FMU without inputs."""
    assembly = load("fmu_manipulation_toolbox.assembly")
    shutil.copy(fmu_dir / "harvester.ssp", tmp_path)
    made = assembly.Assembly("harvester.ssp", default_step_size=STEP, fmu_directory=tmp_path)
    made.make_fmu()
    path = tmp_path / "harvester.fmu"
    variables = {v.name: v for v in read_model_description(str(path), validate=False).modelVariables}
    assert "input" not in {v.causality for v in variables.values()}
    # it shows connected signals only: one joint speed and two piston positions, as close as an angle
    shown = ("manipulator.swing_speed", "manipulator.boom_position", "manipulator.stick_position")
    rows = simulate_fmu(str(path), validate=False, stop_time=10.0, output_interval=STEP, output=shown)
    agree(rows["time"], {name: rows[name] for name in shown}, JACOBI | {"position": JACOBI["angle"]})
