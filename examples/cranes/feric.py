"""Writes feric.toml, the machine of the paper as the file of a crane, with the numbers of its parts.

    python examples/cranes/feric.py

The head is another one: the paper's is a point mass at the tip.
"""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

from fmus.boom_stick import BOOM_STICK
from fmus.contract import nested
from fmus.joints import JointModel
from fmus.manipulator import MANIPULATOR
from fmus.parameters import values
from fmus.supply import SUPPLY, VARIANTS
from fmus.swing import SWING

FILE = Path(__file__).with_name("feric.toml")
TEXT = """\
# The machine of the paper in the words of a crane file, in SI units; written by feric.py
title = "FERIC harvester (slew, boom, stick)"
source = "literature"
note = "fmus/manipulator/parameters.toml has the source of each number"

{joints}[head]
axis = "y"
at = [{arm.stick_length}, 0, 0]
mass = {arm.head_mass}
centre = [0, 0, "-0.5 m"]
inertia = [20, 20, 10]
damping = 50

[payload]
on = "head"
at = [0, 0, "-0.5 m"]

[start]
boom = {arm.initial_boom_angle}
stick = {arm.initial_stick_angle}

[oil]
density = {oil.density}
viscosity = {oil.viscosity}
bulk_modulus = {oil.bulk_modulus}

[supply]
pressure = {supply.pressure_setting}

[pump]
displacement = {pump.main_pump_displacement}

[engine]
speed = {pump.engine_rated_speed}
power = {power}
"""


def inline(**keys: object) -> str:
    """A table on one line."""
    return f"{{ {', '.join(f'{n} = {x}' for n, x in keys.items())} }}"


def joint(model: JointModel) -> str:
    """The table of a joint of the arm."""
    p, turn, arm = (nested(sub.parameters, values(sub).p) for sub in (MANIPULATOR, SWING, BOOM_STICK))
    link = replace(model.link(p), **model.body(p))
    of = turn.swing if model.motor else getattr(arm, model.name)
    if model.motor:
        inertia = link.inertia[2:3] * 3  # only that about z counts
        part, valve, line = "swing", turn.valve, of.line
        size = {"displacement": of.motor_displacement, "ratio": of.gear_ratio, "volume": of.motor_volume}
        drive = {"motor": inline(**size)}
    else:
        part, valve, line, inertia = "boom_stick", arm.valve, of.hose, link.inertia[:3]
        mount, (stroke, damping) = model.drive(p), model.piston(p)
        pins = {
            "damping": damping,
            "base": [*mount.base],
            "pin": [*mount.rod],
            "closed": mount.closed,
            "stroke": stroke,
        }
        drive = {"cylinder": inline(**pins, **{n: getattr(of, n) for n in ("bore", "rod", "dead_volume")})}
    keys = {"axis": f'"{link.axis}"', "at": [*link.at], "mass": link.mass, "centre": [*link.centre]}
    keys |= {"inertia": [*inertia], "damping": model.damping(p), "drive": f'"{next(iter(drive))}"', **drive}
    tubes = {"hose": line.length, "hose_bore": line.bore}
    edges = {"valve": valve.area, "dead_band": valve.dead_band, "leakage": valve.leakage}
    keys["hydraulics"] = inline(part=f'"{part}"', **edges, **tubes)
    return f"[{model.name}]\n" + "".join(f"{n} = {x}\n" for n, x in keys.items()) + "\n"


def text() -> str:
    """The file."""
    arm, oil, supply = (SimpleNamespace(**values(sub).p) for sub in (MANIPULATOR, BOOM_STICK, SUPPLY))
    joints = "".join(map(joint, MANIPULATOR.model.joints))
    pump = SimpleNamespace(**values(VARIANTS["load_sensing"]).p)
    power = pump.engine_rated_torque * pump.engine_rated_speed
    return TEXT.format(joints=joints, arm=arm, oil=oil, supply=supply, pump=pump, power=power)


if __name__ == "__main__":
    FILE.write_text(text(), encoding="utf-8")
