"""Which variables of a system the page shows, by their bare names, and where they stand among the columns."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence

from orchestrator.system.system import System
from orchestrator.view.scene.pose import ANGLES

PRESSURES = (
    "boom_head_pressure",
    "boom_rod_pressure",
    "stick_head_pressure",
    "stick_rod_pressure",
    "swing_pressure_a",
    "swing_pressure_b",
)
SHOWN = (
    *ANGLES,
    *PRESSURES,
    *("supply_pressure", "pump_1_pressure", "pump_2_pressure", "tank_pressure"),
    *("swing_speed", "boom_speed", "stick_speed", "boom_velocity", "stick_velocity"),
    *("boom_position", "stick_position", "boom_stop_force", "stick_stop_force"),
    *("tip_x", "tip_y", "tip_height", "tip_radius", "tip_radial_velocity", "tip_vertical_velocity"),
    *("head_x", "head_y", "head_height", "head_side_speed", "head_speed"),
    *("supply_flow", "hydraulic_power", "engine_power", "engine_speed", "engine_torque"),
    *("pump_1_stroke", "pump_2_stroke", "pump_1_flow", "pump_2_flow", "relief_flow"),
    *("swing_command", "boom_command", "stick_command"),
    *("reference_radius", "reference_height", "reference_angle", "tip_error"),
    *("speed_use", "stroke_use", "reference_share"),
)


def watched(system: System, driven: Collection[str] = ()) -> tuple[str, ...]:
    """`component.variable` of the outputs that are shown, as far as the system has them.

    driven   inputs that a hand drives: what else would drive them, such as a program of levers, is not shown
    """
    found = by_bare_name(str(port) for port in system.ports("output"))
    return tuple(dict.fromkeys(found[name] for name in SHOWN if name in found and name not in driven))


def by_bare_name(names: Iterable[str]) -> Mapping[str, str]:
    """Bare name -> full name. Where several have it, the component that the name begins with is meant:
    `supply_flow` is that of `supply`, not what one drive takes."""
    found = dict[str, str]()
    for name in names:
        component, _, bare = name.rpartition(".")
        if bare not in found or (component and bare.startswith(component.rpartition(".")[2])):
            found[bare] = name
    return found


def columns(names: Sequence[str]) -> Mapping[str, int]:
    """Bare name -> place among the names."""
    place = {name: k for k, name in enumerate(names)}
    return {bare: place[full] for bare, full in by_bare_name(names).items()}
