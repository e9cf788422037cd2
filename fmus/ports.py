"""Ports of the subsystems: declarations of shared signals, and terminals with the same names on both sides.

drives: True for the terminal of a hydraulic drive, False for that of the mechanics. Force and torque flow out
of the drive and into the mechanics.
"""

from dataclasses import replace
from typing import Literal

from fmus.contract import Group, Member, Quantity, Scalar, Terminal

# of a drive without the pressure of the line: its compensators hold their setting whatever is left
NOT_SHARED = "flow is not shared with the other drives while the supply is saturated"
# of a temperature of the oil; 0 K is an open input, or one of FMPy in its first step
BEYOND = (
    "oil: viscosity holds from -20 to 100 degC (0 K: 60), lags, check valves and friction do not follow it"
)


def rate_input(name: str, unit: str, nominal: float = 1.0) -> Quantity:
    """Declaration of an input that carries the exact time derivative of another one."""
    return Quantity(unit, f"Rate port: time derivative of {name}, may stay unconnected", nominal)


def rate_output(name: str, unit: str, nominal: float = 1.0) -> Quantity:
    """Declaration of an output that is the exact time derivative of another one."""
    return Quantity(unit, f"Rate port: exact time derivative of {name}", nominal)


def command(valve: str, meaning: str, rate: str) -> Quantity:
    """Declaration of the command to a valve as an input; rate: name of its rate input."""
    text = f"Command to the {valve} valve, positive {meaning}"
    beyond = f"more than the full command of the {valve} valve"
    return Quantity("V", text, 10.0, rate=rate, warn_above=10.0, meaning=beyond)


def oil_temperature(text: str, held: bool = False, optional: str = "") -> Quantity:
    """Declaration of the temperature of the oil; without bounds, because of 0 K; its source warns of cold."""
    known = Quantity("K", text, 300.0, warn_above=373.15, meaning=f"hot {BEYOND}", below=f"cold {BEYOND}")
    return replace(known, held=held, optional=optional)


class LineInputs(Group):
    """Pressures of the lines to a drive; the rate inputs are exact time derivatives."""

    supply_pressure: Scalar = Quantity("Pa", "Pressure of the supply line", 1e7, rate="supply_pressure_rate")
    supply_pressure_rate: Scalar = rate_input("supply_pressure", "Pa/s", 1e8)
    tank_pressure: Scalar = Quantity("Pa", "Pressure of the return line", 1e5, rate="tank_pressure_rate")
    tank_pressure_rate: Scalar = rate_input("tank_pressure", "Pa/s", 1e7)
    load_sensing_pressure: Scalar = Quantity(
        "Pa",
        "Pressure of the load-sensing line, only used by compensated drives",
        1e7,
        rate="load_sensing_pressure_rate",
        optional=NOT_SHARED,
    )
    load_sensing_pressure_rate: Scalar = rate_input("load_sensing_pressure", "Pa/s", 1e8)
    oil_temperature: Scalar = oil_temperature(
        "Temperature of the oil from the supply line", held=True, optional="the oil stays at 60 degC"
    )


def shaft(axis: str, drives: bool, *others: str) -> Terminal:
    """Rotating shaft: torque and its rate to the mechanics, speed, acceleration and others to the drive."""
    text = f"{axis.capitalize()} shaft: torque on the mechanics, speed of the mechanics"
    return _power_port(axis, "shaft", text, drives, "torque", "torque_rate", "speed", "acceleration", *others)


def rod(axis: str, drives: bool) -> Terminal:
    """Piston rod: force and its rate to the mechanics, piston motion and holding force to the drive."""
    text = f"Rod of the {axis} cylinder: force on the mechanics, motion of the piston"
    motion = ("position", "velocity", "acceleration", "holding_force")
    return _power_port(axis, "rod", text, drives, "force", "force_rate", *motion)


def _power_port(axis: str, kind: str, text: str, drives: bool, effort: str, *others: str) -> Terminal:
    flow = Member(effort, f"{axis}_{effort}", "out" if drives else "in")
    return Terminal(f"{axis}_{kind}", kind, text, (flow, *(Member(n, f"{axis}_{n}") for n in others)))


def lever(axis: str, part: str = "") -> Terminal:
    """Command to a valve and its rate; part: at the actuation of the valve, that of this part."""
    name, end = (f"{axis}_valve_command", f"_{part}") if part else (f"{axis}_command", "")
    members = (Member("command", name), Member("command_rate", f"{name}_rate"))
    return Terminal(f"{axis}_lever{end}", "lever", f"Command to the {axis} valve", members)


def grip() -> Terminal:
    """Payload of the head."""
    return Terminal("grip", "grip", "Payload that the head is to hold", (Member("mass", "payload_mass"),))


def supply_line(to: str = "") -> Terminal:
    """Supply line at the valves of a drive; `to`: at the pumps, for this drive."""
    text = f"Supply line to {to}" if to else "Supply line: pressure, and flow into the drive"
    return _line("supply", "supply", text, to, "out" if to else "in")


def return_line(of: str = "") -> Terminal:
    """Return line at the valves of a drive; `of`: at the tank, for this drive."""
    text = f"Return line from {of}" if of else "Return line: pressure, and flow out of the drive"
    return _line("return", "tank", text, of, "in" if of else "out")


def _line(name: str, pressure: str, text: str, drive: str, direction: Literal["in", "out"]) -> Terminal:
    end = f"_{drive}" if drive else ""
    members = (
        Member("pressure", f"{pressure}_pressure"),
        Member("pressure_rate", f"{pressure}_pressure_rate"),
        Member("flow", f"{name}_flow{end}", direction),
    )
    oil = (Member("temperature", "oil_temperature"),) if name == "supply" else ()
    return Terminal(f"{name}_line{end}", "line", text, (*members, *oil))


def load_sensing_line(drive: str, supply: bool = False) -> Terminal:
    """Load-sensing line of a drive: its load pressure, and the highest one of all drives.

    supply   whether the terminal is that at the supply, else that at the valves of the drive
    """
    text = "Load-sensing line: load pressure of the drive, and pressure of the line"
    members = (
        Member("pressure", "load_sensing_pressure"),
        Member("pressure_rate", "load_sensing_pressure_rate"),
        Member("load_pressure", f"{drive}_load_pressure"),
        Member("load_pressure_rate", f"{drive}_load_pressure_rate"),
    )
    if supply:
        return Terminal(f"load_sensing_line_{drive}", "line", f"Load-sensing line from {drive}", members)
    return Terminal("load_sensing_line", "line", text, members)
