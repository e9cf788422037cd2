"""The machine with other FMUs: it stays at rest, and messages list ports that do not fit."""

import numpy as np
import pytest
from kit.any_fmu.edit import caused, edited, renamed

from orchestrator import run

JOINTS = [f"manipulator.{joint}_speed" for joint in ("swing", "boom", "stick")]
# Through closed valves oil leaks, 20 mL/min per edge, and the arm settles on it: 1.5e-4 rad/s at full reach.
# Pressures that do not fit the pose let it fall with nearly 0.1 rad/s.
STILL = 3e-4  # [rad/s]


def speed(result):
    """The largest speed of a joint [rad/s]."""
    return max(float(np.abs(result.trace[name]).max()) for name in JOINTS)


@pytest.mark.parametrize(("folder", "pose"), [("fmu_dir", "reach"), ("fmi3_dir", "nominal")])
def test_the_machine_stands_still_with_every_variant(system, request, folder, pose):
    """Connections reach the new FMU, also one of FMI 3.0 in a system of FMI 2.0."""
    files = sorted((request.getfixturevalue(folder) / "variants").glob("*.fmu"))
    swaps = [(c, f) for f in files for c in system.components if f.stem.startswith(f"{c}_")]
    assert len(swaps) == len(files) > 0
    for component, file in swaps:
        result = run(system, swap={component: file}, parameters=["still", pose], stop=0.3)
        assert speed(result) < STILL, file.name


def test_without_start_wires_the_machine_falls(system, fmu_dir):
    """Without the holding force the boom falls, so a machine at rest is evidence."""
    cut = system.without("boom_stick.boom_holding_force")
    options = {"swap": {"boom_stick": fmu_dir / "boom_stick.fmu"}, "parameters": ["still"], "stop": 0.3}
    assert speed(run(cut, set={"boom_stick.boom_holding_force": 0.0}, **options)) > 100 * STILL


def test_an_actuator_may_lack_start_wires(system, fmu_dir, tmp_path):
    """An FMU without inputs for the holding forces is accepted, and the note names both."""
    ports = [f"{rod}_holding_force" for rod in ("boom", "stick")]
    changes = [
        change for port in ports for change in (renamed(port, f"no_{port}"), caused(f"no_{port}", "local"))
    ]
    table = edited(fmu_dir / "boom_stick.fmu", tmp_path / "table.fmu", *changes)
    result = run(system, swap={"boom_stick": table}, stop=0.1)
    assert f"{table} has no {', '.join(ports)}: it does not use" in str(result.card.notes)


def test_rates_may_be_missing_on_both_sides(system, fmu_dir, tmp_path):
    """An actuator without rate ports: power connections are kept, and the machine stays at rest."""
    rates = ["boom_force_rate", "stick_force_rate", "boom_acceleration", "stick_acceleration"]
    changes = [renamed(rate, f"no_{rate}") for rate in rates]
    plain = edited(fmu_dir / "boom_stick.fmu", tmp_path / "plain.fmu", *changes)
    result = run(system, swap={"boom_stick": plain}, parameters=["still"], stop=0.3)
    before, after = ({c.target.variable for c in s.connections} for s in (system, result.system))
    assert before - after == set(rates)
    assert speed(result) < STILL
    assert any("plain.fmu has no" in note for note in result.card.notes)
