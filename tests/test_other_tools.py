"""The four FMUs and their system in tools that nobody here wrote, against the monolithic reference.

All these tools are Jacobi masters: each FMU does a step with what the others gave at its start, and the rate
ports carry those values through the step.
"""

from __future__ import annotations

import zipfile

import numpy as np
import pytest
from fmpy.ssp.simulation import simulate_ssp
from fmpy.ssp.ssd import read_ssv
from lxml import etree
from work_cycle import JACOBI, ORDER, SIGNALS, STEP, agree, load, step_through

from fmus.machine import COMMAND_WIRES, CONNECTIONS
from fmus.poses import POSES


def test_fmpy_runs_the_ssp(fmu_dir):
    """simulate_ssp on harvester.ssp as it is: within the bars of the project's own master.

    FMPy gives zeros to all connected inputs in the first step: forces, positions, pressures.
    """
    rows = simulate_ssp(str(fmu_dir / "harvester.ssp"), stop_time=10.0, step_size=STEP)
    # 1 ms without forces leaves the arm swinging for a second: speed 2e-3, pressure 3e-3
    limits = {"speed": 5e-3, "angle": 5e-4, "pressure": 1e-2}
    agree(rows["time"] + STEP, {name: rows[name] for name in SIGNALS}, limits)  # FMPy stamps the step's start


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


@pytest.mark.parametrize("source", ["ssp", "python"])
def test_ecos_runs_the_system(fmu_dir, source):
    """Ecos, from the SSP and from its Python interface, over the whole work cycle."""
    ecos = load("ecospy")
    ecos.EcosLib.set_log_level("err")
    if source == "ssp":
        made = {"ssp_path": str(fmu_dir / "harvester.ssp")}
    else:
        made = {"structure": ecos.EcosSimulationStructure()}
        for name in ORDER:
            made["structure"].add_model(name, str(fmu_dir / f"{name}.fmu"))
        for start, end in CONNECTIONS + COMMAND_WIRES:
            made["structure"].make_real_connection(start.replace(".", "::"), end.replace(".", "::"))
    names = [name.replace(".", "::") for name in SIGNALS]
    with ecos.EcosSimulation(step_size=STEP, **made) as simulation:
        simulation.init()
        time, found = step_through(
            42.0, simulation.step, lambda: [simulation.get_real(name) for name in names]
        )
        simulation.terminate()
    agree(time, found, JACOBI)


def test_libcosim_runs_the_system(fmu_dir):
    """libcosim, from the SSP, with the step that the SSP states."""
    cosim, logging = load("libcosimpy.CosimExecution"), load("libcosimpy.CosimLogging")
    logging.log_output_level(logging.CosimLogLevel.WARNING)
    execution = cosim.CosimExecution.from_ssp_file(str(fmu_dir / "harvester.ssp"))
    observer = load("libcosimpy.CosimObserver").CosimObserver.create_last_value()
    assert execution.add_observer(observer)
    slaves = {info.name.decode(): info.index for info in execution.slave_infos()}
    references = {
        f"{slave}.{v.name.decode()}": v.reference
        for slave, index in slaves.items()
        for v in execution.slave_variables(index)
    }
    wanted = {slave: [n for n in SIGNALS if n.startswith(f"{slave}.")] for slave in ORDER[:3]}

    def take() -> list[float]:
        found = {}
        for slave, names in wanted.items():
            values = observer.last_real_values(slaves[slave], [references[n] for n in names])
            found |= dict(zip(names, values, strict=True))
        return [found[name] for name in SIGNALS]

    time, found = step_through(10.0, execution.step, take)
    assert execution.status().current_time == 10 * 10**9  # ns: no step was refused
    agree(time, found, JACOBI)


def test_ssp_has_what_omsimulator_and_libcosim_ask_for(fmu_dir):
    """OMSimulator 3.0 opens no system without its annotation or with a SystemGeometry; libcosim takes the
    step from its annotation; Ecos and libcosim refuse connectors of the system."""
    root = etree.fromstring(zipfile.ZipFile(fmu_dir / "harvester.ssp").read("SystemStructure.ssd"))
    system = root.find("{*}System")
    assert system.find("{*}Annotations//{*}FixedStepMaster").get("stepSize") == "0.001"
    experiment = root.find("{*}DefaultExperiment/{*}Annotations//{*}FixedStepAlgorithm")
    assert experiment.get("baseStepSize") == "0.001"
    assert system.find("{*}SystemGeometry") is None
    assert system.find("{*}Connectors") is None
