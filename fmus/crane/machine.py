"""A crane as a machine: manipulator, drives by part, a supply, an operator with a lever for each drive.

The hydraulics are those of the paper's machine (`fmus.drives`, `fmus.supply`), one axis for each driven joint
with a valve of its own. Numbers that the description does not have are those of the paper's boom and swing,
or follow from those that it has (`_settings`, `_sized`).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import cache, lru_cache, partial
from keyword import kwlist
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from fmus import boom_stick, swing
from fmus import supply as supplies
from fmus.components import spool_valve
from fmus.components.additions import CushionWithoutColumn
from fmus.components.cylinder import areas
from fmus.components.opening_curve import EDGES
from fmus.contract import Quantity, Subsystem, family, nested, quantities
from fmus.crane import sizes
from fmus.crane.axes import at_start
from fmus.crane.controller import controlled, controller
from fmus.crane.description import (
    ADDITIONS,
    COMPENSATED,
    NEW,
    OF_MOTOR,
    OF_SUPPLY,
    CraneDescription,
    JointDescription,
    read,
)
from fmus.crane.manipulator import NAME, Dry, manipulator
from fmus.crane.view import page_files
from fmus.drives import cylinder, motor
from fmus.drives.cylinder import CYLINDER
from fmus.drives.detailed import needed
from fmus.drives.drive import Axis, part
from fmus.drives.motor import MOTOR
from fmus.drives.variants import fidelity
from fmus.faults import CYLINDER_ADDITIONS, MOTOR_ADDITIONS
from fmus.machine.build import Build, with_values
from fmus.machine.machine import Machine, with_faults
from fmus.machine.one_block import one_block
from fmus.machine.parts import DRIVES, feric
from fmus.machine.ssp import SystemPlan
from fmus.operator_input.model import AXES, operator
from fmus.operator_input.work_cycle import Move, Stem, with_program
from fmus.parameters import Number, numbers, parameters
from fmus.supply import SUPPLY, supply
from fmus.valve_actuation import actuation
from orchestrator.base.errors import Problem
from orchestrator.base.files import Location
from orchestrator.base.text import MODELICA
from orchestrator.check.rules.variables import C

if TYPE_CHECKING:  # paths need pictures and runs, which the check of a crane does not
    from fmus.machine.feasible import Mechanics
    from fmus.machine.path_following import TrackedMachine
    from orchestrator.ssp.system import System

FIDELITIES = {  # variant of the drives -> text and range of validity
    "lumped": ("spool valves, hoses, cylinders and motors", "below the first mode of the longest hose"),
    "quasistatic": ("without line dynamics", "motions below about 10 Hz"),
    "detailed": (
        "spool dynamics, lines, air, relief valves",
        "modes of the hoses up to 75 Hz within 5 %; no flow forces on spools, one temperature",
    ),
    "compensated": (
        "compensated sections, counterbalance valves, crossover reliefs and holding brakes",
        "motions below about 10 Hz; no spool dynamics",
    ),
}
OIL_COLUMNS = ("lumped", "detailed")  # whose lines a cushion needs
RENAMED = {"line_length": "hose_length", "line_bore": "hose_bore"}  # lines of a motor
STOP = 20.0  # stop time of the systems [s]
FIRST, APART = 1.0, 2.5  # s: begin of the first stroke of the program, and from one to the next
STROKE, RAMPS = 3.0, (0.5, 0.5, 0.5)  # V; s, rise, hold and fall; the next one goes back
HELD = 1e6  # s, for which a payload of the description is held
SOURCE = "crane.toml"  # the description, in the resources of a system
SETTINGS = (  # that the paper's machine has as multiples of its supply pressure
    *("pressure_cut_off", "pump_1_pressure_setting", "pump_2_pressure_setting"),
    *("relief_pressure", "port_relief_pressure", "counterbalance_pressure", "counterbalance_band"),
)
# numbers of a joint for its section, 0 if they follow from others
OF_SECTION = ("rod_rated_flow", "head_return_area", "rod_return_area", "head_pilot_ratio", "rod_pilot_ratio")
LINE = ("valve_dead_band", "valve_command_rounding")
HEAVY = 1 / 8  # of the supply pressure: a side that carries more at the start has a low pilot ratio

# of an axis: name, whether a motor moves it, additions, sides with a counterbalance valve
_Key: TypeAlias = tuple[str, bool, tuple[str, ...], tuple[str, ...]]


def crane_machine(crane: CraneDescription, faults: bool = False) -> Machine:
    """The machine of a description; faults: whether its parts have faults as inputs."""
    parts = {NAME: {"rigid": manipulator(crane)}}
    names, pose = list(dict.fromkeys(j.part for j in crane.driven)), at_start(crane)
    for name in names:
        joints = [j for j in crane.driven if j.part == name]
        made = {v: drives(crane, name, joints, pose, v, faults) for v in FIDELITIES}
        parts = {name: family(name, **made), **parts}
    added = {
        n: a for n, a in OF_SUPPLY.items() if f"{n}_{next(iter(quantities(a)))}" in crane.numbers["supply"]
    }
    supplies = {v: with_pressures(sub, crane) for v, sub in supply(names, additions=added).items()}
    machine = Machine(crane.file.stem, parts, {"supply": supplies}, _operator(crane))
    moved: tuple[JointDescription, ...] = ()
    with suppress(Problem):  # the arm is none that a controller knows
        moved = controlled(crane)
    if moved:
        levers = {j.name: (motor.SENSE if j.motor else cylinder.SENSE, j.part) for j in moved}
        head = actuation(levers, conditions=faults)
        machine = replace(machine, controller=controller(crane, machine), actuation=head)
    return with_faults(machine) if faults else machine


_paper = cache(partial(feric, faults=True))


@cache
def components() -> tuple[frozenset[str], frozenset[str]]:
    """Names of the FMUs of a machine: of drives, and of the others."""
    m = _paper()
    return frozenset(DRIVES), frozenset({*m.components, *(sub.name for sub in m.drivers)} - {*DRIVES})


@cache
def taken() -> dict[str, str]:
    """Words that are no names of joints -> why: other names begin with them, or a language has them.

    The drives are the cylinders of the paper's machine, in which names of the part itself are the same.
    """
    crane, m = read(NEW), _paper()
    variants = [sub for family in m.families.values() for sub in family.values()]
    others = (*variants, *m.components.values(), *m.drivers)
    shipped = [sub for sub in others if sub.component not in (NAME, swing.SWING.component)]
    subs = [manipulator(crane), *shipped]
    names = [n for s in subs for g in (s.parameters, s.states, s.inputs, s.outputs) for n in quantities(g)]
    names += [n for s in subs for n in (s.component, *(t.name for t in s.terminals))] + [*quantities(Dry)]
    joints = {*AXES, *(j.name for j in crane.joints)}  # and those of the paper's machine
    joints |= {j.name for sub in m.families[NAME].values() for j in sub.model.joints}
    words = {n.partition("_")[0]: f"the machine has the name {n}" for n in reversed(names)}
    for language, keywords in {"Modelica": MODELICA, "C": C, "Python": kwlist}.items():
        words |= dict.fromkeys(keywords, f"{language} has it as a keyword")
    return {w: why for w, why in words.items() if w not in joints}


def with_pressures(sub: Subsystem, crane: CraneDescription) -> Subsystem:
    """A supply with the pressures of the crane, as far as it has them."""
    tables = numbers(sub)
    own = {**_settings(crane, tables["parameters"]), **crane.numbers["supply"]}
    own |= sizes.of_supply(crane, COMPENSATED)
    found = {n: own.get(n, number) for n, number in tables["parameters"].items()}
    return replace(sub, numbers={**tables, "parameters": found})


def drives(
    crane: CraneDescription,
    name: str,
    joints: Sequence[JointDescription],
    pose: Mapping[str, float],
    variant: str,
    faults: bool = False,
) -> Subsystem:
    """The hydraulics of some joints."""
    key = tuple((j.name, j.motor, j.additions, j.held) for j in joints)
    sub, of_variant = _structure(name, key, variant, faults), fidelity(variant)
    of_swing, of_arm = swing.VARIANTS[variant], boom_stick.VARIANTS[variant]
    common = {**numbers(of_swing)["parameters"], **numbers(of_arm)["parameters"]}
    largest = max(sizes.section_flow(crane, j, COMPENSATED) for j in joints)
    common |= {**_settings(crane, common), **crane.numbers["oil"], **sizes.of_drives(largest, common)}
    common |= {n: x for n, x in crane.numbers["counterbalance"].items() if x.value}
    sized = {j.name: {**j.numbers, **_sized(crane, j, common, pose)} for j in joints}
    declared, found = quantities(sub.parameters), dict[str, Number]()
    names = nested(sub.parameters, {n: n for n in declared})
    for j in joints:  # default: the number at the same place in the paper's swing or boom, or in their valve
        shipped, axis = (of_swing, swing.AXES) if j.motor else (of_arm, boom_stick.AXES)
        known = nested(shipped.parameters, numbers(shipped)["parameters"])
        like = vars(getattr(known, axis[0].name)) | {n: getattr(known, n) for n in of_variant.of_valve("")}
        for full, default in _alike(getattr(names, j.name), like):
            short = full.removeprefix(f"{j.name}_")
            found[full] = sized[j.name].get(RENAMED.get(short, short)) or default or healthy(declared[full])
    found |= {n: common[n] for n in declared if n not in found}
    # of an FMU alone, whose inputs are not connected: the start pose, at rest while rate inputs are open, the
    # pressure of the supply, warm oil
    start = {"supply_pressure": crane.numbers["supply"]["pressure_setting"]}
    start["oil_temperature"] = numbers(boom_stick.BOOM_STICK)["start"]["oil_temperature"]
    inputs = quantities(sub.inputs)
    rates = {x.rate for x in inputs.values()} - {n for n, x in inputs.items() if x.rate}
    for n, x in inputs.items():
        if pose.get(n) and n not in rates:
            start[n] = Number(pose[n], x.unit, "derived", "of the manipulator at the start")
    sub = replace(sub, numbers={"parameters": found, "start": start})
    if variant == "detailed":
        p = parameters(sub)
        lumps = tuple(needed(_axis(one, variant, faults), p) for one in key)
        sub = replace(_structure(name, key, variant, faults, lumps), numbers=sub.numbers)
    return sub


def _axis(key: _Key, variant: str, faults: bool) -> Axis:
    name, is_motor, additions, held = key
    kind, moved = (MOTOR, motor.HeldInputs) if is_motor else (CYLINDER, cylinder.Inputs)
    added = (MOTOR_ADDITIONS if is_motor else CYLINDER_ADDITIONS) if faults else ()
    known = {**ADDITIONS, **({} if variant in OIL_COLUMNS else {"cushion": CushionWithoutColumn})}
    known |= OF_MOTOR if is_motor else {}
    return Axis(name, kind, moved, None, True, (*added, *((n, known[n]) for n in additions)), held)


@lru_cache(maxsize=32)
def _structure(
    name: str, keys: tuple[_Key, ...], variant: str, faults: bool, lumps: tuple[int, ...] = ()
) -> Subsystem:
    """The hydraulics without numbers; lumps: of the line of each axis in detailed ones."""
    axes, (text, validity) = [_axis(key, variant, faults) for key in keys], FIDELITIES[variant]
    if variant not in OIL_COLUMNS and any("cushion" in additions for _, _, additions, _ in keys):
        validity += "; no cushions"
    of = dict(zip((a.name for a in axes), lumps, strict=True)) if lumps else {}
    of_variant = fidelity(variant, lambda axis: of[axis.name]) if lumps else fidelity(variant)
    drives = f"Hydraulic drives of {', '.join(a.name for a in axes)}: {text}"
    return part(name, axes, of_variant, text=drives, validity=validity)


def _alike(names: Any, numbers: Mapping[str, Any]) -> Iterator[tuple[str, Number | None]]:
    """The names in a group, each with the number at the same place in another one; None: there is none."""
    for n, name in vars(names).items():
        if isinstance(name, str):
            yield name, numbers.get(n)
        else:
            yield from _alike(name, vars(numbers[n]) if n in numbers else {})


def healthy(declared: Quantity) -> Number:
    """Of a component that is only there with faults: the value that it declares, which does nothing."""
    if declared.value is None:
        raise Problem(f"{declared.text}: expected a value in its declaration, got none")
    return Number(declared.value, declared.unit, "derived", "healthy")


def _derived(value: float, unit: str, note: str) -> Number:
    return Number(value, unit, "derived", note)


def _settings(crane: CraneDescription, shipped: Mapping[str, Number]) -> dict[str, Number]:
    """Settings of valves and pumps that follow the pressure of the supply."""
    times = crane.numbers["supply"]["pressure_setting"].value
    times /= numbers(SUPPLY)["parameters"]["pressure_setting"].value
    note = "the multiple of supply.pressure that the paper's machine has"
    return {n: _derived(times * shipped[n].value, "Pa", note) for n in SETTINGS if n in shipped}


def _sized(
    crane: CraneDescription,
    joint: JointDescription,
    common: Mapping[str, Number],
    pose: Mapping[str, float],
) -> dict[str, Number]:
    """Numbers of spool, compensated section and brake that follow from the file; common: of the variant."""
    share = joint["valve_dead_band"] / common["valve_full_command"].value
    overlap = _derived(share, "1", "hydraulics.dead_band over valve_full_command")
    found = {f"valve_spool_overlap_{edge}": overlap for edge in EDGES}
    if joint.motor:
        found |= sizes.of_motor(joint)
    if "compensator_setting" not in common:
        return found if joint.motor else found | _edges(joint, common)
    pressure = crane.numbers["supply"]["pressure_setting"].value
    jet = common["valve_discharge_coefficient"].value * math.sqrt(2 / common["density"].value)
    flow = sizes.section_flow(crane, joint, common["compensator_setting"].value)
    note = "hydraulics.flow" if joint["rated_flow"] else "of hydraulics.valve at compensator_setting"
    found["section_flow"] = _derived(flow, "m3/s", note)
    if joint.motor:
        turn = joint["motor_displacement"] * joint["gear_ratio"]
        torque, speed = turn * pressure, flow / turn
        area, text = flow / (jet * math.sqrt(28e5)), "28 bar at full command, as of the paper's swing"
        return found | {
            "return_area": _derived(area, "m2", text),
            "brake_holding_torque": _derived(1.3 * torque, "N.m", "1.3 times the torque of the motor"),
            "brake_stiffness": _derived(torque / 3e-3, "N.m/rad", "3 mrad at the torque of the motor"),
            "brake_drag": _derived(0.01 * torque / speed, "N.m.s/rad", "1 % of that torque at full speed"),
        }
    own = {n: x for n, x in joint.numbers.items() if n in OF_SECTION and x.value}
    of_edge = found["section_flow"]
    if (share := joint.edges["pb"].value / joint["valve_area"]) != 1:
        of_edge = _derived(share * flow, "m3/s", "section_flow times hydraulics.rod_valve over valve")
    found["rod_section_flow"] = to_rod = own.pop("rod_rated_flow", of_edge)
    head, rod = (float(x) for x in areas(joint["bore"], joint["rod"]))
    force = pose[f"{joint.name}_holding_force"]
    for side, emptied, held in (
        ("head", to_rod.value * head / rod, force / head),
        ("rod", flow * rod / head, -force / rod),
    ):
        area, text = emptied / (jet * math.sqrt(pressure / 2)), "half of supply.pressure at full command"
        found[f"{side}_return_area"] = _derived(area, "m2", text)
        as_of = "boom_head" if held > HEAVY * pressure else "boom_rod"
        found[f"{side}_pilot_ratio"] = common[f"{as_of}_pilot_ratio"]
    return found | own


def _edges(joint: JointDescription, common: Mapping[str, Number]) -> dict[str, Number]:
    """Area of a spool valve: that of its widest edge, and curves of the edges that are narrower."""
    dead, rounding = map(joint.__getitem__, LINE)
    areas = {edge: x.value for edge, x in joint.edges.items()}
    shape = dead, rounding, common["valve_full_command"].value
    curves = edge_curves(areas, dict.fromkeys(areas, dead), *shape)
    notes = {"V": "hydraulics.dead_band, rounding", "1": "area of the edge over the widest one"}
    found = {n: _derived(x, unit, notes[unit]) for n, (x, unit) in curves.items()}
    return found | {"valve_area": max(joint.edges.values(), key=lambda x: x.value)}


def edge_curves(
    areas: Mapping[str, float], dead_bands: Mapping[str, float], dead: float, rounding: float, full: float
) -> dict[str, tuple[float, str]]:
    """Points, with units, of the curves of edges narrower than the widest one, or of another dead band.

    areas, dead_bands       by edge [m2], [V]
    dead, rounding, full    of the valve [V]
    """
    widest, found = max(areas.values()), dict[str, tuple[float, str]]()
    for edge in (e for e in areas if (areas[e], dead_bands[e]) != (widest, dead)):
        own = dead_bands[edge]
        start = min(rounding, (full - own) / 4)  # points on a line give this line from the third one on
        for k, volts in enumerate((own, own + start, own + 2 * start, full), 1):
            opening = areas[edge] / widest * float(spool_valve.opening(volts, own, full, rounding))
            found[f"valve_{edge}_command_{k}"] = volts, "V"
            found[f"valve_{edge}_opening_{k}"] = opening, "1"
    return found


def borrowed(crane: CraneDescription) -> dict[str, dict[str, Number]]:
    """Numbers of the paper's machine that supplies and drives have; those of joints without their names."""
    known = (numbers(s) for of in (swing, boom_stick, supplies) for s in of.VARIANTS.values())
    shipped = {x for tables in known for x in tables["parameters"].values()}
    names, pose, found = [j.name for j in crane.driven], at_start(crane), {}
    parts = {j.part: [other for other in crane.driven if other.part == j.part] for j in crane.driven}
    for kind, subs in {
        "supply": [with_pressures(sub, crane) for sub in supplies.VARIANTS.values()],
        "drives": [drives(crane, n, of, pose, v) for n, of in parts.items() for v in FIDELITIES],
    }.items():
        own_of = {n: x for s in subs for n, x in numbers(s)["parameters"].items()}
        listed = {n: x for n, x in own_of.items() if x in shipped or x.note.startswith(sizes.SCALED)}
        own = {n.partition("_"): x for n, x in listed.items()}
        found[kind] = {n[2] if n[0] in names else "".join(n): x for n, x in own.items() if x.value}
    return found


def _operator(crane: CraneDescription) -> Subsystem:
    """Each lever in turn, to and fro; the payload of the description is held."""
    moves: list[Move | Stem] = [Stem(0.0, crane.numbers["payload"]["payload_mass"].value, HELD)]
    for k, (j, sign) in enumerate((j, sign) for j in crane.driven for sign in (1, -1)):
        moves.append(Move(j.name, FIRST + APART * k, sign * STROKE, *RAMPS))
    return with_program(operator({j.name: "" for j in crane.driven}), moves, "program of a crane")


def crane_build(crane: CraneDescription, parameters: Path | None = None, faults: bool = False) -> Build:
    """What is built of a crane; the arguments are those of `fmus.machine.build.harvester`."""
    machine = with_values(crane_machine(crane, faults), parameters, partial(controller, crane))
    whole, plan = one_block(machine, f"Crane as one block: {crane.title}"), SystemPlan(STOP)
    files, note = {**page_files(crane), SOURCE: Location(crane.file).read()}, ""
    try:
        controlled(crane)
    except Problem as why:
        note = f"without a controller: {why}"
    return Build(machine, whole, plan, plan, files, note=note)


def tracked(system: System) -> tuple[TrackedMachine, Mechanics] | None:
    """Names and mechanics of a crane that follows paths; None: the system is none of a crane."""
    from fmus.machine.feasible import Mechanics
    from fmus.machine.path_following import TrackedMachine
    from fmus.machine.ssp import CONTROLLED, SENSED

    if (file := system.resources.get(SOURCE)) is None:
        return None
    crane = read(Path(str(file)), file.read())
    controlled(crane)  # tells why the machine has no controller
    machine, name = crane_machine(crane), system.name.removesuffix(CONTROLLED).removesuffix(SENSED)
    tip = tuple(f"{NAME}.crane_tip_{n}" for n in ("radius", "height", "angle"))
    own = TrackedMachine(example=f"{name}{CONTROLLED}.ssp", alone="drives=lumped", tip=tip)
    assert machine.controller is not None
    return own, Mechanics(machine.controller, machine.parts[NAME])
