"""The FMUs and their system in Ecos and libcosim, against our own master and the reference.

Both are plain Jacobi masters: each FMU does a step with what the others gave at its start, and the rate ports
carry those values through the step.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from kit import shards
from kit.plain_jacobi import SAME, ours
from kit.work_cycle import (
    FMUS,
    HELD,
    JACOBI,
    ORDER,
    RATED,
    SIGNALS,
    STEP,
    VERSIONS,
    agree,
    check_log,
    load,
    same,
    step_through,
    worst,
)

from fmus.machine.parts import FERIC

pytestmark = shards.tools

# Ecos asks for the version before it has loaded the library; the library does have the function
ECOS = ('Function "fmi3GetVersion" is not provided by this FMU.',)


def ecos_run(
    stop: float,
    step: float,
    folder: Path | None = None,
    wires: Any = RATED,
    ssp: Path | None = None,
    parts: Sequence[str] = ORDER,
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """The work cycle in Ecos, from an SSP or from the FMUs `parts` in `folder` and wires."""
    ecos = load("ecospy")
    ecos.EcosLib.set_log_level("debug")
    if ssp:
        made = {"ssp_path": str(ssp)}
    else:
        made = {"structure": ecos.EcosSimulationStructure()}
        for name in parts:
            made["structure"].add_model(name, str(folder / f"{name}.fmu"))
        for start, end in wires:
            made["structure"].make_real_connection(start.replace(".", "::"), end.replace(".", "::"))
    whole = "harvester" in parts
    names = [f"harvester::{n.split('.')[1]}" if whole else n.replace(".", "::") for n in SIGNALS]
    with ecos.EcosSimulation(step_size=step, **made) as simulation:
        assert simulation.init()
        found = step_through(stop, simulation.step, lambda: [simulation.get_real(n) for n in names], step)
        simulation.terminate()
    return found


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("name", FMUS)
def test_ecos_runs_each_fmu(request, capfd, name, version):
    """Alone, of both versions: the log has no error."""
    ecos = load("ecospy")
    ecos.EcosLib.set_log_level("debug")
    structure = ecos.EcosSimulationStructure()
    structure.add_model(name, str(request.getfixturevalue(version) / f"{name}.fmu"))
    with ecos.EcosSimulation(step_size=STEP, structure=structure) as simulation:
        assert simulation.init()
        assert simulation.step(500) == pytest.approx(0.5)
        simulation.terminate()
    check_log("".join(capfd.readouterr()), ECOS)


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
    """operator_input.fmu drives harvester.fmu: no coupling error, at 20 ms as exact as the solver."""
    wires = [(start, f"harvester.{start.split('.')[1]}") for start, _ in FERIC.operator_wires]
    time, found = ecos_run(42.0, 0.02, fmu_dir, wires, parts=("operator_input", "harvester"))
    # tolerance 1e-6 of the solver, and a command that starts within a step; measured 5e-6 in speed
    agree(time, found, dict.fromkeys(JACOBI, 1e-4))
    check_log("".join(capfd.readouterr()))


@pytest.mark.parametrize("name", FMUS)
def test_libcosim_runs_each_fmu(fmu_dir, capfd, name):
    """Alone: no step is refused and the log has no error."""
    cosim, logging = load("libcosimpy.CosimExecution"), load("libcosimpy.CosimLogging")
    logging.log_output_level(logging.CosimLogLevel.WARNING)
    execution = cosim.CosimExecution.from_step_size(step_size=10**6)  # ns
    given = {"fmu_path": str(fmu_dir / f"{name}.fmu"), "instance_name": name}
    slave = load("libcosimpy.CosimSlave").CosimLocalSlave(**given)
    execution.add_local_slave(slave)
    assert execution.step(step_count=500)
    assert execution.status().current_time == 500 * 10**6
    check_log("".join(capfd.readouterr()))


def test_libcosim_runs_the_ssp(fmu_dir, capfd):
    """From harvester.ssp as it is, with the step that it states: our numbers, near the reference."""
    cosim, logging = load("libcosimpy.CosimExecution"), load("libcosimpy.CosimLogging")
    logging.log_output_level(logging.CosimLogLevel.WARNING)
    execution = cosim.CosimExecution.from_ssp_file(str(fmu_dir / "harvester.ssp"))
    observer = load("libcosimpy.CosimObserver").CosimObserver.create_last_value()
    assert execution.add_observer(observer)
    slaves = {info.name.decode(): info.index for info in execution.slave_infos()}
    variables = [(slave, v) for slave, index in slaves.items() for v in execution.slave_variables(index)]
    references = {f"{slave}.{v.name.decode()}": v.reference for slave, v in variables}
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
