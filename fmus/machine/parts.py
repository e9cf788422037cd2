"""The machine of the paper: its parts in all variants, supply, operator and controller."""

from collections.abc import Mapping

from fmus import boom_stick, manipulator, supply, swing
from fmus.contract import Subsystem
from fmus.controller import CONTROLLER
from fmus.faults import CYLINDER_ADDITIONS, MOTOR_ADDITIONS
from fmus.machine.machine import Machine, with_faults
from fmus.operator_input import OPERATOR
from fmus.valve_actuation import ACTUATION, actuation


class Parts(dict[str, Mapping[str, Subsystem]]):
    """Variants of each part by name, the default one first."""

    def __repr__(self) -> str:
        return "\n".join(f"{part}: {', '.join(variants)}" for part, variants in self.items())


def feric(faults: bool = False) -> Machine:
    """The machine of the paper; faults: whether its parts have faults as inputs."""
    machine = Machine(
        name="harvester",
        parts={
            "swing": swing.variants(MOTOR_ADDITIONS) if faults else swing.VARIANTS,
            "boom_stick": boom_stick.variants(CYLINDER_ADDITIONS) if faults else boom_stick.VARIANTS,
            "manipulator": manipulator.VARIANTS,
        },
        supplies={"supply": supply.VARIANTS},
        operator=OPERATOR,
        controller=CONTROLLER,
        actuation=actuation(conditions=True) if faults else ACTUATION,
        # the cylinders press on oil and on the linkage
        shared=dict.fromkeys(("boom_stroke", "stick_stroke"), ("boom_stick", "manipulator")),
    )
    return with_faults(machine) if faults else machine


FERIC = feric()
FAMILIES = Parts(FERIC.families)
# variants with another circuit than the paper's machine: differences from the others are no errors
OTHER_CIRCUITS = ("compensated", "load_sensing")
# the machines of studies and of the virtual rig, as variants of their parts
MACHINES: Mapping[str, Mapping[str, str]] = {
    "lumped": {},
    "detailed": {
        "swing": "detailed",
        "boom_stick": "detailed",
        "manipulator": "pendulum_friction",
        "supply": "engine_pump",
    },
}
DRIVES = ("swing", "boom_stick")
