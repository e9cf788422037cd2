"""The machine of the paper: its parts in all variants, supply, operator and controller."""

from collections.abc import Mapping
from dataclasses import replace

from fmus import boom_stick, faults, manipulator, supply, swing
from fmus.contract import Subsystem
from fmus.controller import CONTROLLER
from fmus.controller.harvester import ARM
from fmus.diagnosis import diagnosis
from fmus.machine.machine import Machine
from fmus.operator_input.model import OPERATOR
from fmus.parameters import numbers
from fmus.sensors import sensors
from fmus.valve_actuation import ACTUATION, actuation
from fmus.valve_actuation.model import VALVES


class Parts(dict[str, Mapping[str, Subsystem]]):
    """Variants of each part by name, the default one first."""

    def __repr__(self) -> str:
        return "\n".join(f"{part}: {', '.join(variants)}" for part, variants in self.items())


FERIC = Machine(
    parts={"swing": swing.VARIANTS, "boom_stick": boom_stick.VARIANTS, "manipulator": manipulator.VARIANTS},
    supplies={"supply": supply.VARIANTS},
    operator=OPERATOR,
    controller=CONTROLLER,
    actuation=ACTUATION,
    # the cylinders press on oil and on the linkage
    shared=dict.fromkeys(("boom_stroke", "stick_stroke"), ("boom_stick", "manipulator")),
)
FAMILIES = Parts(FERIC.families)


def with_faults() -> Machine:
    """The same machine with faults as inputs of its parts (`fmus.faults`)."""
    of_swing = swing.variants(faults.MOTOR_ADDITIONS)
    of_arm = boom_stick.variants(faults.CYLINDER_ADDITIONS)
    return replace(
        FERIC,
        parts={
            "swing": {v: faults.faulty(sub, ["swing"]) for v, sub in of_swing.items()},
            "boom_stick": {v: faults.faulty(sub, ["boom", "stick"]) for v, sub in of_arm.items()},
            "manipulator": manipulator.VARIANTS,
        },
        supplies={"supply": {v: faults.faulty(sub) for v, sub in supply.VARIANTS.items()}},
        actuation=faults.faulty(actuation(conditions=True), [*VALVES]),
        sensors=sensors(FERIC.measured),
        diagnosis=diagnosis(ARM, numbers(CONTROLLER)["parameters"], manipulator.MANIPULATOR),
    )


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
JOINT_SPEEDS = tuple(f"manipulator.{joint}_speed" for joint in ("swing", "boom", "stick"))
