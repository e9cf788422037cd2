"""The diagnosis in other tools, over the readings of a machine with a leak."""

import numpy as np
import pytest
from fmpy import simulate_fmu
from fmpy.validation import validate_fmu
from kit import shards
from kit.openmodelica import simulated
from kit.work_cycle import load

from orchestrator import load as load_system
from orchestrator import run

pytestmark = shards.tools
LEAK = {"stick_head_leak": "0.5mm2@8s"}
SHOWN = ("stick_head_leak", "stick_head_leak_state", "boom_head_burst", "payload", "swing_gain_up")
STOP = 30.0  # s


@pytest.fixture(scope="module")
def readings(faulty, work):
    """Inputs of the diagnosis every 10 ms."""
    variables = load_system(faulty / "diagnosis.fmu").components["diagnosis"].interface.variables
    names = [n for n, v in variables.items() if v.causality == "input" and n != "reset"]
    seen = [f"diagnosis.{n}" for n in names]
    system = faulty / "harvester_sensors.ssp"
    result = run(system, work, stop=STOP, step=1e-3, fault=LEAK, record=seen, record_step=0.01)
    return np.asarray(result.time), {n: np.asarray(result[f"diagnosis.{n}"]) for n in names}


def test_fmpy_runs_it_over_readings(faulty, readings):
    """A valid description, and the leak with its size as `run` finds it.

    FMPy gives the readings of the begin of each step, as the orchestrator does.
    """
    fmu = str(faulty / "diagnosis.fmu")
    assert validate_fmu(fmu) == []
    time, known = readings
    columns = {"time": time, **known}
    table = np.rec.fromarrays([*columns.values()], names=[*columns])
    found = simulate_fmu(fmu, input=table, stop_time=STOP, output_interval=0.01, output=list(SHOWN))
    ours = run(fmu, columns, stop=STOP, step=0.01, record=list(SHOWN))
    assert found["stick_head_leak_state"][-1] == 1
    for n in SHOWN:
        there, here = found[n][1:], np.asarray(ours[n])[: len(found) - 1]
        size = max(np.abs(here).max(), 1e-12)
        assert np.abs(there[-1] - here[-1]) < 0.05 * size, n


def test_ecos_steps_the_system_with_it(faulty):
    """The system as it is, with the machine at rest: nothing is told, and all is finite."""
    ecos = load("ecospy")
    names = ("boom_spool", "stick_head_burst", "boom_speed_sensor", "payload")
    with ecos.EcosSimulation(step_size=1e-3, ssp_path=str(faulty / "harvester_sensors.ssp")) as simulation:
        assert simulation.init()
        for _ in range(3000):
            simulation.step()
        *states, payload = (simulation.get_real(f"diagnosis::{n}") for n in names)
        simulation.terminate()
    assert states == [0, 0, 0]
    assert np.isfinite(payload)


def test_openmodelica_integrates_it(faulty, tmp_path):
    """For Model Exchange, with inputs that are zero: its filters are stable, and nothing can be told."""
    rows = simulated(faulty / "diagnosis.fmu", tmp_path, "FMUs.Diagnosis", "stopTime = 1, tolerance = 1e-4")
    assert (rows["boom_head_burst_state"].iloc[-1], rows["boom_spool_state"].iloc[-1]) == (-1, -1)
