"""Writes feric.toml, the machine of the paper as the file of a crane, with the numbers of its parts.

    python examples/cranes/feric.py

The head is another one: the paper's is a point mass at the tip.
"""

from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

from fmus.boom_stick import BOOM_STICK
from fmus.contract import nested
from fmus.joints import JointModel
from fmus.manipulator import MANIPULATOR
from fmus.parameters import values
from fmus.supply import SUPPLY
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
"""


def joint(model: JointModel) -> Iterator[str]:
    """Lines of the table of a joint of the arm."""
    p, turn, oil = (nested(sub.parameters, values(sub).p) for sub in (MANIPULATOR, SWING, BOOM_STICK))
    link = model.link(p)
    inertia = link.inertia[2:3] * 3 if model.motor else link.inertia[:3]  # of the column that about z counts
    yield f'[{model.name}]\naxis = "{link.axis}"\nat = {[*link.at]}\nmass = {link.mass}'
    yield f"centre = {[*link.centre]}\ninertia = {[*inertia]}\ndamping = {model.damping(p)}"
    if model.motor:
        of, line, part = turn.swing, turn.swing.line, "swing"
        yield 'drive = "motor"'
        yield f"motor = {{ displacement = {of.motor_displacement}, ratio = {of.gear_ratio} }}"
    else:
        own, line, part = model.drive(p), getattr(oil, model.name).hose, "boom_stick"
        stroke, damping = model.piston(p)
        yield f'drive = "cylinder"\n[{model.name}.cylinder]\nbase = {[*own.base]}\npin = {[*own.rod]}'
        yield f"closed = {own.closed}\nstroke = {stroke}\ndamping = {damping}"
        yield f"bore = {getattr(oil, model.name).bore}\nrod = {getattr(oil, model.name).rod}"
    valve = turn.valve if model.motor else oil.valve
    yield f'[{model.name}.hydraulics]\npart = "{part}"\nhose = {line.length}\nhose_bore = {line.bore}'
    yield f"valve = {valve.area}\ndead_band = {valve.dead_band}\n\n"


def text() -> str:
    """The file."""
    arm, oil, supply = (SimpleNamespace(**values(sub).p) for sub in (MANIPULATOR, BOOM_STICK, SUPPLY))
    joints = "".join("\n".join(joint(model)) for model in MANIPULATOR.model.joints)
    return TEXT.format(joints=joints, arm=arm, oil=oil, supply=supply)


if __name__ == "__main__":
    FILE.write_text(text(), encoding="utf-8")
