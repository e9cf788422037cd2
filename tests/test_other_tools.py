"""The three FMUs and their system in tools that nobody here wrote, against the monolithic reference.

All these tools are Jacobi masters: each FMU does a step with what the others gave at its start, and the rate
ports carry those values through the step.
"""

from __future__ import annotations

import zipfile

import numpy as np
import pytest
from fmpy.ssp.simulation import simulate_ssp
from lxml import etree
from work_cycle import COMMANDS, JACOBI, ORDER, SIGNALS, STEP, agree, command, load, step_through

from fmus.machine import CONNECTIONS, INPUTS


def test_fmpy_runs_the_ssp(fmu_dir):
    """simulate_ssp on harvester.ssp as it is: within the bars of the project's own master.

    FMPy hands inputs over one step late and gives zeros in the first step: forces, positions, pressures.
    """
    late = 1.5 * STEP  # one step, and half of one because it holds
    inputs = {f"{a}_command": (lambda t, a=a: command(a, t + late)) for a in COMMANDS}
    inputs |= {"supply_pressure": lambda _: 20.684e6, "tank_pressure": lambda _: 0.0}
    rows = simulate_ssp(str(fmu_dir / "harvester.ssp"), stop_time=10.0, step_size=STEP, input=inputs)
    # 1 ms without forces leaves the arm swinging for a second: speed 2e-3, pressure 3e-3
    limits = {"speed": 5e-3, "angle": 5e-4, "pressure": 1e-2}
    agree(rows["time"] + STEP, {name: rows[name] for name in SIGNALS}, limits)  # FMPy stamps the step's start


@pytest.mark.parametrize("source", ["ssp", "python"])
def test_ecos_runs_the_system(fmu_dir, source):
    """Ecos, from an SSP and from its Python interface, over the whole work cycle."""
    ecos = load("ecospy")
    ecos.EcosLib.set_log_level("err")
    if source == "ssp":
        made = {"ssp_path": str(fmu_dir / "harvester_components.ssp")}
    else:
        made = {"structure": ecos.EcosSimulationStructure()}
        for name in ORDER:
            made["structure"].add_model(name, str(fmu_dir / f"{name}.fmu"))
        for start, end in CONNECTIONS:
            made["structure"].make_real_connection(start.replace(".", "::"), end.replace(".", "::"))
    ports = [f"{component}::{axis}_command" for axis, component in COMMANDS.items()]
    names = [name.replace(".", "::") for name in SIGNALS]
    with ecos.EcosSimulation(step_size=STEP, **made) as simulation:
        simulation.init()
        time, found = step_through(
            42.0,
            lambda commands: [simulation.set_real(*pair) for pair in zip(ports, commands, strict=True)],
            simulation.step,
            lambda: [simulation.get_real(name) for name in names],
        )
        simulation.terminate()
    agree(time, found, JACOBI)


def test_libcosim_runs_the_system(fmu_dir):
    """libcosim, from an SSP, with the step that the SSP states."""
    cosim, logging = load("libcosimpy.CosimExecution"), load("libcosimpy.CosimLogging")
    logging.log_output_level(logging.CosimLogLevel.WARNING)
    execution = cosim.CosimExecution.from_ssp_file(str(fmu_dir / "harvester_components.ssp"))
    manipulator = load("libcosimpy.CosimManipulator").CosimManipulator.create_override()
    observer = load("libcosimpy.CosimObserver").CosimObserver.create_last_value()
    assert execution.add_manipulator(manipulator)
    assert execution.add_observer(observer)
    slaves = {info.name.decode(): info.index for info in execution.slave_infos()}
    references = {
        f"{slave}.{v.name.decode()}": (index, v.reference)
        for slave, index in slaves.items()
        for v in execution.slave_variables(index)
    }
    ports = [references[f"{component}.{axis}_command"] for axis, component in COMMANDS.items()]
    wanted = {slave: [n for n in SIGNALS if n.startswith(f"{slave}.")] for slave in slaves}

    def give(commands: np.ndarray) -> None:
        for (slave, reference), value in zip(ports, commands, strict=True):
            manipulator.slave_real_values(slave, [reference], [value])

    def take() -> list[float]:
        found = {}
        for slave, names in wanted.items():
            values = observer.last_real_values(slaves[slave], [references[n][1] for n in names])
            found |= dict(zip(names, values, strict=True))
        return [found[name] for name in SIGNALS]

    time, found = step_through(10.0, give, execution.step, take)
    assert execution.status().current_time == 10 * 10**9  # ns: no step was refused
    agree(time, found, JACOBI)


def test_ssp_has_what_omsimulator_and_libcosim_ask_for(fmu_dir):
    """OMSimulator 3.0 opens no system without its annotation or with a SystemGeometry, and feeds zeros to
    inputs without start value; libcosim takes the step from its annotation."""
    root = etree.fromstring(zipfile.ZipFile(fmu_dir / "harvester.ssp").read("SystemStructure.ssd"))
    system = root.find("{*}System")
    assert system.find("{*}Annotations//{*}FixedStepMaster").get("stepSize") == "0.001"
    experiment = root.find("{*}DefaultExperiment/{*}Annotations//{*}FixedStepAlgorithm")
    assert experiment.get("baseStepSize") == "0.001"
    assert system.find("{*}SystemGeometry") is None
    starts = {
        p.get("name"): p[0].get("value") for p in system.find("{*}ParameterBindings").iter("{*}Parameter")
    }
    assert starts == dict.fromkeys(INPUTS, "0") | {"supply_pressure": "20684000"}
