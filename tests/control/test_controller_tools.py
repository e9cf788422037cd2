"""The system with the controller in other tools: Ecos and libcosim move the tip as our master does.

The joystick goes inwards by 0.3 m/s from the beginning, engaged from the beginning: nothing that a tool
would have to read from a file.
"""

import numpy as np
import pytest
from kit.work_cycle import check_log, load

from orchestrator import Trace, run

STOP, STEP, SPEED = 3.0, 1e-3, -0.3
JOYSTICK = {"engaged": 1.0, "radial_velocity": SPEED}
TIP = ("tip_radius", "tip_height")
# of 0.9 m; a joystick that is there a step later makes 0.3 mm, the rest is the coupling
NEAR = 1e-3  # m


@pytest.fixture(scope="module")
def ours(fmu_dir) -> list[float]:
    """Radius and height at the end, by our own master."""
    wanted = {f"controller.{n}": np.full(2, v) for n, v in JOYSTICK.items()}
    names = [f"manipulator.{n}" for n in TIP]
    trace = run(fmu_dir / "harvester_control.ssp", Trace(np.array([0, STOP]), wanted), record=names).trace
    assert trace[names[0]][-1] == pytest.approx(trace[names[0]][0] + SPEED * (STOP - 0.15), abs=0.01)  # lag
    return [trace[n][-1] for n in names]


def test_ecos_runs_the_system(fmu_dir, capfd, ours):
    """From the SSP as it is."""
    ecos = load("ecospy")
    with ecos.EcosSimulation(step_size=STEP, ssp_path=str(fmu_dir / "harvester_control.ssp")) as simulation:
        assert simulation.init()
        for name, value in JOYSTICK.items():
            simulation.set_real(f"controller::{name}", value)
        simulation.step(round(STOP / STEP))
        found = [simulation.get_real(f"manipulator::{n}") for n in TIP]
        simulation.terminate()
    assert found == pytest.approx(ours, abs=NEAR)
    check_log("".join(capfd.readouterr()))


def test_libcosim_runs_the_system(fmu_dir, capfd, ours):
    """From the SSP as it is, with the step that it states."""
    cosim = load("libcosimpy.CosimExecution")
    execution = cosim.CosimExecution.from_ssp_file(str(fmu_dir / "harvester_control.ssp"))
    observer = load("libcosimpy.CosimObserver").CosimObserver.create_last_value()
    assert execution.add_observer(observer)
    hand = load("libcosimpy.CosimManipulator").CosimManipulator.create_override()
    assert execution.add_manipulator(hand)
    index = {info.name.decode(): info.index for info in execution.slave_infos()}

    def places(part, names):
        of = {v.name.decode(): v.reference for v in execution.slave_variables(index[part])}
        return index[part], [of[n] for n in names]

    hand.slave_real_values(*places("controller", JOYSTICK), list(JOYSTICK.values()))
    assert execution.step(step_count=round(STOP / STEP))
    assert list(observer.last_real_values(*places("manipulator", TIP))) == pytest.approx(ours, abs=NEAR)
    check_log("".join(capfd.readouterr()))
