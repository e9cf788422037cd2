"""A machine of one's own from the parts of the paper's: one motor more, with a supply of its own."""

import numpy as np
import pytest
from kit import shards
from kit.equations import played

from fmus.contract import Group, Quantity, Scalar, Subsystem
from fmus.drives import motor
from fmus.drives.drive import Axis, part
from fmus.drives.lumped import LUMPED
from fmus.drives.motor import MOTOR
from fmus.export.build import build
from fmus.machine.machine import Machine, wiring
from fmus.machine.parts import FERIC
from fmus.monolith import join
from fmus.parameters import numbers
from fmus.ports import rate_input, rate_output, shaft
from fmus.supply import supply
from fmus.swing import SWING
from orchestrator import assemble, run


class Saw(Group):
    saw_inertia: Scalar = Quantity("kg.m2", "Inertia of the saw", 100.0, value=2000.0)


class SawInputs(Group):
    saw_torque: Scalar = Quantity("N.m", "Hydraulic torque on the saw", 1e4, rate="saw_torque_rate")
    saw_torque_rate: Scalar = rate_input("saw_torque", "N.m/s", 1e5)


class SawState(Group):
    saw_speed: Scalar = Quantity("rad/s", "Speed of the saw")


class SawOutputs(SawState):
    saw_acceleration: Scalar = rate_output("saw_speed", "rad/s2")


BLADE = Subsystem(
    name="blade", text="Saw", parameters=Saw, states=SawState, inputs=SawInputs, outputs=SawOutputs,
    dynamics=lambda _, u, p: SawState(saw_speed=u.saw_torque / p.saw_inertia),
    observe=lambda x, u, p: SawOutputs(saw_speed=x.saw_speed, saw_acceleration=u.saw_torque / p.saw_inertia),
    terminals=(shaft("saw", drives=False),),
)  # fmt: skip
# a motor like that of the swing, with its values
DRIVE = part(
    "saw", [Axis("saw", MOTOR, motor.Inputs, str)], LUMPED, text="Saw drive", validity="-",
    numbers={"parameters": numbers(SWING)["parameters"], "start": {}},
)  # fmt: skip
OWN = Machine(
    name="own",
    parts={**FERIC.parts, "saw": {"lumped": DRIVE}, "blade": {"rigid": BLADE}},
    supplies={**FERIC.supplies, "second_supply": supply(["saw"], "second_supply")},
    operator=FERIC.operator,
)


def test_the_own_machine_has_the_wires_of_the_paper_and_those_of_its_motor():
    """Terminals connect the saw to its blade and to its own supply, and to nothing else."""
    own, papers = ({*m.connections, *m.operator_wires, *m.supply_wires} for m in (OWN, FERIC))
    more = own - papers
    assert papers <= own
    joined = {frozenset(end.partition(".")[0] for end in wire) for wire in more}
    assert joined == {frozenset({"saw", part}) for part in ("blade", "second_supply")}
    assert ("second_supply.supply_pressure", "saw.supply_pressure") in more
    assert ("saw.saw_torque_rate", "blade.saw_torque_rate") in more


@shards.machine
def test_the_own_machine_is_built_and_runs(built, tmp_path):
    """Three FMUs more; the co-simulation is the monolithic solution of the machine."""
    fmus = {name: built / f"{name}.fmu" for name in FERIC.components}
    fmus |= {sub.name: build(sub, tmp_path) for sub in (DRIVE, BLADE, OWN.feeding["second_supply"])}
    system = assemble(fmus, OWN.connections + OWN.operator_wires + OWN.supply_wires, stop=2.0, step=1e-3)
    time = np.linspace(0, 2, 2001)
    command = np.interp(time, [0, 0.2, 0.5, 2.0], [0, 0, 4.0, 4.0])
    found = run(system, {"time": time, "saw.saw_command": command}, master="hermite")
    true = played(join(OWN.components, *wiring(OWN.components)), time, {"saw_command": command})
    for name in ("blade.saw_speed", "saw.saw_pressure_a", "manipulator.boom_angle"):
        assert np.ptp(true[name]) > 0
        # of the range; the error of a hermite master at 1 ms with the corners of the command in steps
        at = np.interp(found.time, time, true[name])
        assert found[name] == pytest.approx(at, abs=1e-3 * np.ptp(true[name]))
