"""The machine: which subsystems there are and how they are wired."""

from __future__ import annotations

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

# all there is of each part, the usual variant first
FAMILIES: Mapping[str, Mapping[str, Subsystem]] = {
    "swing": swing.VARIANTS,
    "boom_stick": boom_stick.VARIANTS,
    "manipulator": manipulator.VARIANTS,
    "supply": supply.VARIANTS,
}
# the machine; and what is built: the machine, its supply and its operator
SUBSYSTEMS: Mapping[str, Subsystem] = {s.name: s for s in (SWING, BOOM_STICK, MANIPULATOR)}
ALL: Mapping[str, Subsystem] = {**SUBSYSTEMS, SUPPLY.name: SUPPLY, OPERATOR.name: OPERATOR}
Wires: TypeAlias = tuple[tuple[str, str], ...]

# power ports: what flows over each port and back
SIGNALS: Wires = (
    ("swing.swing_torque", "manipulator.swing_torque"),
    ("manipulator.swing_speed", "swing.swing_speed"),
    ("boom_stick.boom_force", "manipulator.boom_force"),
    ("manipulator.boom_position", "boom_stick.boom_position"),
    ("manipulator.boom_velocity", "boom_stick.boom_velocity"),
    ("boom_stick.stick_force", "manipulator.stick_force"),
    ("manipulator.stick_position", "boom_stick.stick_position"),
    ("manipulator.stick_velocity", "boom_stick.stick_velocity"),
)

# rate ports: the exact time derivatives of those signals, optional
RATES: Wires = (
    ("swing.swing_torque_rate", "manipulator.swing_torque_rate"),
    ("manipulator.swing_acceleration", "swing.swing_acceleration"),
    ("boom_stick.boom_force_rate", "manipulator.boom_force_rate"),
    ("manipulator.boom_acceleration", "boom_stick.boom_acceleration"),
    ("boom_stick.stick_force_rate", "manipulator.stick_force_rate"),
    ("manipulator.stick_acceleration", "boom_stick.stick_acceleration"),
)

# used only to initialise: pressures that hold the pose
HOLDING: Wires = (
    ("manipulator.boom_holding_force", "boom_stick.boom_holding_force"),
    ("manipulator.stick_holding_force", "boom_stick.stick_holding_force"),
)

CONNECTIONS = SIGNALS + RATES + HOLDING

# from the operator, each with its rate
COMMAND_WIRES: Wires = tuple(
    (f"operator_input.{lever}_command{suffix}", f"{part}.{lever}_command{suffix}")
    for lever, part in (("swing", "swing"), ("boom", "boom_stick"), ("stick", "boom_stick"))
    for suffix in ("", "_rate")
)

# from the controller, where it stands in the place of the operator; and what it measures
CONTROL_WIRES: Wires = (
    *((source.replace(OPERATOR.name, CONTROLLER.name), target) for source, target in COMMAND_WIRES),
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

# from and to the supply; without them the drives see an ideal source
DRIVES = ("swing", "boom_stick")
SUPPLY_WIRES: Wires = (
    *(
        (f"supply.{v}", f"{d}.{v}")
        for d in DRIVES
        for v in ("supply_pressure", "supply_pressure_rate", "tank_pressure")
    ),
    *((f"{d}.{v}", f"supply.{v}_{d}") for d in DRIVES for v in ("supply_flow", "return_flow")),
)

# inputs of the machine without operator and the component inputs they feed
INPUTS: Mapping[str, tuple[str, ...]] = {
    **{end.split(".")[1]: (end,) for _, end in COMMAND_WIRES},
    "supply_pressure": ("swing.supply_pressure", "boom_stick.supply_pressure"),
    "supply_pressure_rate": ("swing.supply_pressure_rate", "boom_stick.supply_pressure_rate"),
    "tank_pressure": ("swing.tank_pressure", "boom_stick.tank_pressure"),
}


def parts(**variants: str) -> dict[str, Subsystem]:
    """The parts of the machine by name: the usual ones, or of a part named here the variant of that name.

    parts(boom_stick="detailed", supply="engine_pump"); the supply is among them only if it is named.
    """
    for part, variant in variants.items():
        known = FAMILIES.get(part)
        if known is None or variant not in known:
            expected = (
                f"a variant of {part}: {', '.join(known)}" if known else f"a part: {', '.join(FAMILIES)}"
            )
            raise Problem(f"{part}={variant}: expected {expected}")
    return {**SUBSYSTEMS} | {part: FAMILIES[part][variant] for part, variant in variants.items()}


def wiring(chosen: Mapping[str, Subsystem]) -> tuple[Wires, Mapping[str, tuple[str, ...]]]:
    """Connections and inputs of a machine of these parts; the supply, if there, stands for its inputs."""
    if SUPPLY.name not in chosen:
        return CONNECTIONS, INPUTS
    fed = {target for _, target in SUPPLY_WIRES}
    return CONNECTIONS + SUPPLY_WIRES, {n: ends for n, ends in INPUTS.items() if not fed & set(ends)}
