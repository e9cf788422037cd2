"""The FMUs and their system in tools that nobody here wrote, against our own master and the reference.

All these tools are plain Jacobi masters: each FMU does a step with what the others gave at its start, and the
rate ports carry those values through the step.
"""

from __future__ import annotations

import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fmpy import extract, instantiate_fmu, read_model_description, simulate_fmu
from fmpy.ssp.simulation import simulate_ssp
from fmpy.ssp.ssd import read_ssv
from lxml import etree
from plain_jacobi import ours
from work_cycle import (
    HELD,
    JACOBI,
    ORDER,
    RATED,
    SIGNALS,
    STEP,
    agree,
    check_log,
    load,
    same,
    step_through,
    worst,
)

from fmus.machine import COMMAND_WIRES, HOLDING
from fmus.poses import POSES

# the same algorithm on the same FMUs: only the times of the steps differ, by rounding, and with them the
# inner steps of the solvers; measured 5e-12 over 10 s, and 4e-10 where the run itself is unstable
SAME = 1e-8
FMUS = (*ORDER, "harvester")
VERSIONS = ("fmu_dir", "fmi3_dir")
# Ecos asks for the version before it has loaded the library; the library does have the function
ECOS = ('Function "fmi3GetVersion" is not provided by this FMU.',)


# ---- FMPy ------------------------------------------------------------------------------------------


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
@pytest.mark.parametrize(
    ("step", "limits"),
    [
        (1e-3, {"speed": 5e-3, "angle": 5e-4, "pressure": 1e-2}),
        (5e-3, {"speed": 2e-2, "angle": 1e-3, "pressure": 3e-2}),
    ],
)
def test_fmpy_runs_the_ssp(fmu_dir, capfd, step, limits):
    """simulate_ssp on harvester.ssp as it is: at 1 ms within the bars of the project's own master.

    FMPy gives zeros to all connected inputs in the first step: forces, positions, pressures.
    """
    rows = simulate_ssp(str(fmu_dir / "harvester.ssp"), stop_time=10.0, step_size=step)
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


class Part:
    """One FMU in FMPy's interface of its version."""

    def __init__(self, path: Path) -> None:
        description = read_model_description(str(path))
        self.references = {v.name: v.valueReference for v in description.modelVariables}
        self.new = description.fmiMajorVersion == 3
        self.fmu: Any = instantiate_fmu(extract(str(path)), description, "CoSimulation")
        if not self.new:
            self.fmu.setupExperiment(startTime=0.0)
        self.fmu.enterInitializationMode()

    def get(self, names: Sequence[str]) -> list[float]:
        read = self.fmu.getFloat64 if self.new else self.fmu.getReal
        return list(read([self.references[n] for n in names]))

    def set(self, names: Sequence[str], values: Sequence[float]) -> None:
        write = self.fmu.setFloat64 if self.new else self.fmu.setReal
        write([self.references[n] for n in names], values)


def carry(parts: dict[str, Part], wires: Sequence[tuple[str, str]]) -> None:
    """Read all sources, then set all targets."""
    ends = [(*start.split("."), *end.split(".")) for start, end in wires]
    found = {(a, b): parts[a].get([v for c, v, d, _ in ends if (c, d) == (a, b)]) for a, _, b, _ in ends}
    for (a, b), values in found.items():
        parts[b].set([v for c, _, d, v in ends if (c, d) == (a, b)], values)


@pytest.mark.parametrize("version", VERSIONS)
def test_fmpy_steps_the_system_as_we_do(request, fmu_dir, capfd, version):
    """A loop over FMPy's classes, in FMI 2.0 and 3.0, gives the numbers of our own orchestrator."""
    folder = request.getfixturevalue(version)
    parts = {name: Part(folder / f"{name}.fmu") for name in ORDER}
    carry(parts, HOLDING)
    for part in parts.values():
        part.fmu.exitInitializationMode()
    carry(parts, RATED)
    time = [0.0]

    def step() -> None:
        for part in parts.values():
            part.fmu.doStep(time[0], STEP)
        time[0] += STEP
        carry(parts, RATED)

    def take() -> list[float]:
        return [parts[name.split(".")[0]].get([name.split(".")[1]])[0] for name in SIGNALS]

    _, found = step_through(2.0, step, take)
    for part in parts.values():
        part.fmu.terminate()
        part.fmu.freeInstance()
    same(found, ours(fmu_dir, STEP, 42.0), SAME)
    check_log("".join(capfd.readouterr()))


# ---- Ecos ------------------------------------------------------------------------------------------


def ecos_run(
    stop: float, step: float, folder: Path | None = None, wires: Any = RATED, ssp: Path | None = None
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """The work cycle in Ecos, from an SSP or from the FMUs in `folder` and wires."""
    ecos = load("ecospy")
    ecos.EcosLib.set_log_level("debug")
    if ssp:
        made = {"ssp_path": str(ssp)}
    else:
        made = {"structure": ecos.EcosSimulationStructure()}
        for name in ORDER:
            made["structure"].add_model(name, str(folder / f"{name}.fmu"))
        for start, end in wires:
            made["structure"].make_real_connection(start.replace(".", "::"), end.replace(".", "::"))
    names = [name.replace(".", "::") for name in SIGNALS]
    with ecos.EcosSimulation(step_size=step, **made) as simulation:
        assert simulation.init()
        found = step_through(stop, simulation.step, lambda: [simulation.get_real(n) for n in names], step)
        simulation.terminate()
    return found


@pytest.mark.parametrize("step", [1e-3, 5e-3])
def test_ecos_runs_the_ssp(fmu_dir, capfd, step):
    """The whole work cycle from harvester.ssp as it is: our numbers; near the reference, also at 5 ms."""
    time, found = ecos_run(42.0, step, ssp=fmu_dir / "harvester.ssp")
    same(found, ours(fmu_dir, step, 42.0), SAME)
    # the error of the coupling grows with the square of the step: measured 9e-5 and 1.9e-3 in speed
    agree(time, found, {kind: limit * (step / STEP) ** 2 for kind, limit in JACOBI.items()})
    check_log("".join(capfd.readouterr()))


def test_ecos_couples_fmi_3(fmu_dir, fmi3_dir, capfd):
    """FMI 3.0 FMUs through Ecos' Python interface (it reads no SSP 2.0): the numbers of FMI 2.0."""
    _, found = ecos_run(10.0, STEP, fmi3_dir)
    same(found, ours(fmu_dir, STEP, 42.0), SAME)
    check_log("".join(capfd.readouterr()), ECOS)


def test_without_rate_wires_the_system_is_lost(fmu_dir):
    """Inputs held and nothing else, as in most tools: at 1 ms the arm shakes itself off the reference."""
    time, found = ecos_run(6.0, STEP, fmu_dir, HELD)
    same(found, ours(fmu_dir, STEP, 6.0, rates=False), SAME)
    rated = {name: values[: len(time)] for name, values in ours(fmu_dir, STEP, 42.0).items()}
    # measured 4.4e-2 against 1.4e-4
    assert worst(time, found, "speed") > 100 * worst(time, rated, "speed")


def test_ecos_needs_no_small_steps_for_the_one_block(fmu_dir, capfd):
    """operator.fmu drives harvester.fmu: no coupling error, at 20 ms as exact as the FMU's own solver."""
    ecos = load("ecospy")
    structure = ecos.EcosSimulationStructure()
    for name in ("operator", "harvester"):
        structure.add_model(name, str(fmu_dir / f"{name}.fmu"))
    for start, _ in COMMAND_WIRES:
        lever = start.split(".")[1]
        structure.make_real_connection(f"operator::{lever}", f"harvester::{lever}")
    names = [f"harvester::{name.split('.')[1]}" for name in SIGNALS]
    with ecos.EcosSimulation(step_size=0.02, structure=structure) as simulation:
        assert simulation.init()
        time, found = step_through(
            42.0, simulation.step, lambda: [simulation.get_real(n) for n in names], 0.02
        )
        simulation.terminate()
    # tolerance 1e-6 of the solver, and a command that starts within a step; measured 5e-6 in speed
    agree(time, found, dict.fromkeys(JACOBI, 1e-4))
    check_log("".join(capfd.readouterr()))


# ---- libcosim --------------------------------------------------------------------------------------


def test_libcosim_runs_the_ssp(fmu_dir, capfd):
    """From harvester.ssp as it is, with the step that it states: our numbers, near the reference."""
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
    same(found, ours(fmu_dir, STEP, 42.0), SAME)
    agree(time, found, JACOBI)
    check_log("".join(capfd.readouterr()))


# ---- what else tools ask of the SSP ----------------------------------------------------------------


def test_ssp_has_what_omsimulator_and_libcosim_ask_for(fmu_dir):
    """OMSimulator 3.0 opens no system without its annotation, with a SystemGeometry or with a dictionary;
    libcosim takes the step from its annotation; Ecos and libcosim refuse connectors of the system."""
    root = etree.fromstring(zipfile.ZipFile(fmu_dir / "harvester.ssp").read("SystemStructure.ssd"))
    system = root.find("{*}System")
    assert system.find("{*}Annotations//{*}FixedStepMaster").get("stepSize") == "0.001"
    experiment = root.find("{*}DefaultExperiment/{*}Annotations//{*}FixedStepAlgorithm")
    assert experiment.get("baseStepSize") == "0.001"
    for tag in ("SystemGeometry", "SignalDictionaries", "Connectors"):
        assert system.find(f"{{*}}{tag}") is None
