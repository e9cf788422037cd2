"""Structure of the machine: subsystems, their variants, and their connections."""

from collections.abc import Mapping
from typing import TypeAlias

from fmus import boom_stick, manipulator, supply, swing
from fmus.boom_stick import BOOM_STICK
from fmus.contract import Subsystem
from fmus.controller import CONTROLLER
from fmus.manipulator import MANIPULATOR
from fmus.operator_input.model import OPERATOR
from fmus.supply import SUPPLY
from fmus.swing import SWING
from orchestrator.base.errors import Problem


class Parts(dict[str, Mapping[str, Subsystem]]):
    """Variants of each part by name, the default one first."""

    def __repr__(self) -> str:
        return "\n".join(f"{part}: {', '.join(variants)}" for part, variants in self.items())


FAMILIES: Mapping[str, Mapping[str, Subsystem]] = Parts(
    swing=swing.VARIANTS,
    boom_stick=boom_stick.VARIANTS,
    manipulator=manipulator.VARIANTS,
    supply=supply.VARIANTS,
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
# default variants: of the machine, and of the machine with supply and operator
SUBSYSTEMS: Mapping[str, Subsystem] = {s.name: s for s in (SWING, BOOM_STICK, MANIPULATOR)}
ALL: Mapping[str, Subsystem] = {**SUBSYSTEMS, SUPPLY.name: SUPPLY, OPERATOR.name: OPERATOR}
Connections: TypeAlias = tuple[tuple[str, str], ...]

JOINT_SPEEDS = tuple(f"manipulator.{joint}_speed" for joint in ("swing", "boom", "stick"))
# power ports: both signals of each port
SIGNALS: Connections = (
    ("swing.swing_torque", "manipulator.swing_torque"),
    ("manipulator.swing_speed", "swing.swing_speed"),
    ("boom_stick.boom_force", "manipulator.boom_force"),
    ("manipulator.boom_position", "boom_stick.boom_position"),
    ("manipulator.boom_velocity", "boom_stick.boom_velocity"),
    ("boom_stick.stick_force", "manipulator.stick_force"),
    ("manipulator.stick_position", "boom_stick.stick_position"),
    ("manipulator.stick_velocity", "boom_stick.stick_velocity"),
)

# rate ports: exact time derivatives of these signals, optional
RATES: Connections = (
    ("swing.swing_torque_rate", "manipulator.swing_torque_rate"),
    ("manipulator.swing_acceleration", "swing.swing_acceleration"),
    ("boom_stick.boom_force_rate", "manipulator.boom_force_rate"),
    ("manipulator.boom_acceleration", "boom_stick.boom_acceleration"),
    ("boom_stick.stick_force_rate", "manipulator.stick_force_rate"),
    ("manipulator.stick_acceleration", "boom_stick.stick_acceleration"),
)

# only for initialisation: holding forces of the pose, from which the initial pressures follow
HOLDING: Connections = (
    ("manipulator.boom_holding_force", "boom_stick.boom_holding_force"),
    ("manipulator.stick_holding_force", "boom_stick.stick_holding_force"),
)

CONNECTIONS = SIGNALS + RATES + HOLDING

# parameter -> parts that it describes together: the cylinders press on oil and on the linkage
SHARED: Mapping[str, tuple[str, ...]] = dict.fromkeys(
    ("boom_stroke", "stick_stroke"), ("boom_stick", "manipulator")
)

# commands of the operator and their rates
LEVER_WIRES: Connections = tuple(
    (f"operator_input.{lever}_command{suffix}", f"{part}.{lever}_command{suffix}")
    for lever, part in (("swing", "swing"), ("boom", "boom_stick"), ("stick", "boom_stick"))
    for suffix in ("", "_rate")
)
COMMAND_WIRES: Connections = (*LEVER_WIRES, ("operator_input.payload_mass", "manipulator.payload_mass"))

# commands of the controller, which replaces the operator, and its measured signals
CONTROL_WIRES: Connections = (
    *((source.replace(OPERATOR.name, CONTROLLER.name), target) for source, target in LEVER_WIRES),
    *(
        (f"manipulator.{axis}_{kind}", f"controller.{axis}_{kind}")
        for kind in ("angle", "speed")
        for axis in ("swing", "boom", "stick")
    ),
    *((f"swing.swing_pressure_{port}", f"controller.swing_pressure_{port}") for port in "ab"),
    *(
        (f"boom_stick.{axis}_{side}_pressure", f"controller.{axis}_{side}_pressure")
        for axis in ("boom", "stick")
        for side in ("head", "rod")
    ),
    *((f"supply.{line}_pressure", f"controller.{line}_pressure") for line in ("supply", "tank")),
)

# between supply and drives; without them the drives have constant pressures
DRIVES = ("swing", "boom_stick")
LINES = tuple(
    f"{line}_pressure{suffix}" for line in ("supply", "tank", "load_sensing") for suffix in ("", "_rate")
)
SUPPLY_WIRES: Connections = (
    *((f"supply.{v}", f"{d}.{v}") for d in DRIVES for v in LINES),
    *(
        (f"{d}.{d}_load_pressure{suffix}", f"supply.{d}_load_pressure{suffix}")
        for d in DRIVES
        for suffix in ("", "_rate")
    ),
    *((f"{d}.{v}", f"supply.{v}_{d}") for d in DRIVES for v in ("supply_flow", "return_flow")),
)

# external inputs of the machine without operator -> component inputs
INPUTS: Mapping[str, tuple[str, ...]] = {
    **{end.split(".")[1]: (end,) for _, end in LEVER_WIRES},
    **{v: tuple(f"{d}.{v}" for d in DRIVES) for v in LINES},
    "payload_mass": ("manipulator.payload_mass",),
}


def parts(**variants: str) -> dict[str, Subsystem]:
    """Parts of the machine by name, in their default variants except for the variants in the arguments.

    Example: parts(boom_stick="detailed", supply="engine_pump"). The supply is included only if it is an
    argument.
    """
    for part, variant in variants.items():
        family = FAMILIES.get(part)
        if family is None or variant not in family:
            expected = (
                f"a variant of {part}: {', '.join(family)}" if family else f"a part: {', '.join(FAMILIES)}"
            )
            raise Problem(f"{part}={variant}: expected {expected}")
    return {**SUBSYSTEMS} | {part: FAMILIES[part][variant] for part, variant in variants.items()}


def wiring(chosen: Mapping[str, Subsystem]) -> tuple[Connections, Mapping[str, tuple[str, ...]]]:
    """Connections and external inputs of a machine of these parts, with or without supply."""
    if SUPPLY.name not in chosen:
        return CONNECTIONS, INPUTS
    supplied = {target for _, target in SUPPLY_WIRES}
    return CONNECTIONS + SUPPLY_WIRES, {n: ends for n, ends in INPUTS.items() if not supplied & set(ends)}
