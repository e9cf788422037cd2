"""The ports between subsystems: which variables belong together, named alike on both sides.

`drives` tells the side: a hydraulic drive gives force and torque to the mechanics, which receive them.
"""

from __future__ import annotations

from typing import Literal

from fmus.contract import Member, Terminal


def _given(drives: bool) -> Literal["in", "out"]:
    return "out" if drives else "in"


def shaft(axis: str, drives: bool) -> Terminal:
    """A turning shaft: torque and its rate one way, speed and acceleration the other."""
    return Terminal(
        f"{axis}_shaft",
        "shaft",
        f"{axis.capitalize()} shaft: torque on the mechanics, speed of the mechanics",
        (
            Member("torque", f"{axis}_torque", _given(drives)),
            Member("torque_rate", f"{axis}_torque_rate"),
            Member("speed", f"{axis}_speed"),
            Member("acceleration", f"{axis}_acceleration"),
        ),
    )


def rod(axis: str, drives: bool) -> Terminal:
    """A piston rod: force and its rate one way, the piston's motion and the holding force the other."""
    return Terminal(
        f"{axis}_rod",
        "rod",
        f"Rod of the {axis} cylinder: force on the mechanics, motion of the piston",
        (
            Member("force", f"{axis}_force", _given(drives)),
            Member("force_rate", f"{axis}_force_rate"),
            Member("position", f"{axis}_position"),
            Member("velocity", f"{axis}_velocity"),
            Member("acceleration", f"{axis}_acceleration"),
            Member("holding_force", f"{axis}_holding_force"),
        ),
    )


def lever(axis: str) -> Terminal:
    """A command and its rate."""
    members = (Member("command", f"{axis}_command"), Member("command_rate", f"{axis}_command_rate"))
    return Terminal(f"{axis}_lever", "lever", f"Command to the {axis} valve", members)


def supply_line() -> Terminal:
    """The line that feeds the valves of a drive."""
    members = (
        Member("pressure", "supply_pressure"),
        Member("pressure_rate", "supply_pressure_rate"),
        Member("flow", "supply_flow", "in"),
    )
    return Terminal("supply_line", "line", "Supply line: its pressure, the flow taken from it", members)


def return_line() -> Terminal:
    """The line from the valves of a drive to the tank."""
    members = (Member("pressure", "tank_pressure"), Member("flow", "return_flow", "out"))
    return Terminal("return_line", "line", "Return line: its pressure, the flow given to it", members)


def supply_line_to(drive: str) -> Terminal:
    """The end of the supply line at the pumps, for one of the drives; it fits `supply_line`."""
    members = (
        Member("pressure", "supply_pressure"),
        Member("pressure_rate", "supply_pressure_rate"),
        Member("flow", f"supply_flow_{drive}", "out"),
    )
    return Terminal(f"supply_line_{drive}", "line", f"Supply line to {drive}", members)


def return_line_from(drive: str) -> Terminal:
    """The end of the return line at the tank, for one of the drives; it fits `return_line`."""
    members = (Member("pressure", "tank_pressure"), Member("flow", f"return_flow_{drive}", "in"))
    return Terminal(f"return_line_{drive}", "line", f"Return line from {drive}", members)
