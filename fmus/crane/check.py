"""`harvester crane check`: axes, loads and data sheet of a crane as text, and doubts."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from fmus.crane import sizes
from fmus.crane.axes import SUPPLIES, AxisCheck, Capacity, Speeds, axes_of, lifting_moment, modes
from fmus.crane.controller import controlled
from fmus.crane.description import (
    ADDITIONS,
    DEFAULT,
    DRIVES,
    INERTIA,
    TABLES,
    CraneDescription,
    keys_of,
    read,
)
from fmus.crane.machine import borrowed, components, taken
from fmus.crane.manipulator import contacts, manipulator, resting
from fmus.parameters import Number
from orchestrator.base import toml
from orchestrator.base.errors import Mistakes, Problem
from orchestrator.base.text import TextTable

SMALL_LEVER = 0.25  # of the largest one: below it a joint may run over the dead point beyond an end stop
POSES, SAME = 50, 1e-6  # random poses, and share of a torque that is rounding
SHARES = (0.4, 0.7, 1.0)  # of the largest reach, for which loads are printed


def checked(file: Path) -> tuple[CraneDescription, list[AxisCheck]]:
    """A crane and all axes from its file; Mistakes of the file and of the names of joints at once."""
    try:
        crane = read(file)
    except Mistakes as found:
        joints = (n for n, given in toml.read_file(file).data.items() if isinstance(given, dict))
        raise Mistakes([*found.lines, *_names(file, joints)]) from None
    return crane, check(crane)


def check(crane: CraneDescription) -> list[AxisCheck]:
    """All axes; a Problem with a line for each mistake, also in the names of joints."""
    (of_drives, others), name = components(), crane.file.stem
    wrong = [*_names(crane.file, (j.name for j in crane.joints))]
    listed = ", ".join(sorted(others))
    for j in (j for j in crane.driven if j.part in others):
        wrong.append(f"{crane.file}: [{j.name}.hydraulics] part: expected none of {listed}, got {j.part!r}")
    if name in of_drives | others | {j.part for j in crane.driven}:
        wrong.append(f"{crane.file}: expected another name of the file: {name}.fmu is a part of a machine")
    if wrong:
        raise Mistakes(wrong)
    return axes_of(crane)


def _names(file: Path, joints: Iterable[str]) -> Iterator[str]:
    """A line for each joint with a name that the machine or a language has."""
    used, others = taken(), {*TABLES, "start"}
    for n in (n for n in joints if n in used and n not in others):
        yield f"{file}: [{n}] expected another name of the joint: {used[n]}"


def table(
    crane: CraneDescription, found: Sequence[AxisCheck], loads: Capacity, speeds: Mapping[str, Speeds]
) -> str:
    """The axes, loads and the data sheet as text for a terminal; speeds by joint, or none."""
    moving = ("speed out/in", "compensated", "oil") if speeds else ()
    head = ("joint", "drive", "start", "range", "lever", "push", "pull", "holds with", *moving, "mode")
    pressure = crane.numbers["supply"]["pressure_setting"].value
    title = f"{crane.title}: {len(crane.joints)} joints, {len(found)} driven, {pressure / 1e5:.0f} bar"
    axes = TextTable(head, [_row(a, speeds.get(a.joint.name)) for a in found])
    lines = [title, *axes.lines(), "", *_together(crane, found), *_loads(found, loads)]
    if crane.loads or any(crane.datasheet.values()):
        rows = list[list[str]]()
        for text, told, own in _compared(crane, found, loads):
            off = f"{100 * (own / told - 1):+.1f} %" if own is not None and told else ""
            rows.append([text, f"{told:.4g}", "no pose" if own is None else f"{own:.4g}", off])
        lines += ["", *TextTable(("data sheet", "says", "computed", "off by"), rows).lines()]
    lines += [f"warning: {crane.file}: {text}" for text in _doubts(crane, found)]
    try:
        controlled(crane)
    except Problem as why:
        lines.append(f"note: without a controller of its tip: {why}")
    lines += [f"note: identify cannot tell {text}" for text in _untold(crane, found)]
    lines += [f"assumed: {text}" for text in _assumed(crane)]
    return "\n".join(lines)


def _doubts(crane: CraneDescription, found: Sequence[AxisCheck]) -> Iterator[str]:
    """What is possible but seldom meant."""
    for j in crane.joints:
        weightless = not (j["stiffness"] or any(j[n] for n in INERTIA))
        if j["mass"] == 0 and (weightless or j.cylinder):
            yield f"[{j.name}] has no mass"
        rubs = j["damping"] or any(contacts(j))
        if not j.driven and not j.follows and not rubs:
            yield f"[{j.name}] passive, without damping and friction: it swings for ever"
        if "cushion" in j.additions:
            yield f"[{j.name}] cushion: not in quasistatic and compensated drives, which have no oil columns"
    for a in found:
        if a.levers[0] < SMALL_LEVER * a.levers[1]:
            least, largest = (1e3 * x for x in a.levers)
            yield (
                f"[{a.joint.name}] lever down to {least:.0f} of {largest:.0f} mm near an end of the stroke, "
                "where the end stop may not hold the joint back from the dead point; a shorter stroke does"
            )


def _untold(crane: CraneDescription, found: Sequence[AxisCheck]) -> Iterator[str]:
    """Masses that the torques of the weight tell in no pose of the cylinders, or only together."""
    arm, random = manipulator(crane), np.random.default_rng(0)
    (rest, masses), ends = resting(arm), {a.joint.name: (a.low, a.high) for a in found if a.joint.cylinder}
    free = [j.name for j in arm.model.free]
    poses = np.array([random.uniform(*ends.get(n, (0.0, 0.0)), POSES) for n in free])
    held = [free.index(n) for n in ends]
    table = np.concatenate([np.zeros((1, len(masses))), *(np.array(rest(q)[1])[held] for q in poses.T)])
    size = np.linalg.norm(table, axis=0)
    carried = [n for n, x in zip(masses, size, strict=True) if x]
    if left := [n for n in masses if n not in carried]:
        yield f"{', '.join(left)}: no cylinder carries it"
    _, sizes, directions = np.linalg.svd(table[:, size > 0] / size[size > 0])
    null = directions[np.count_nonzero(sizes > SAME * sizes[0]) :] if carried else np.zeros((0, 0))
    if tied := [n for n, x in zip(carried, np.abs(null).max(axis=0, initial=0.0), strict=True) if x > SAME]:
        yield f"{', '.join(tied)} apart: no pose does"


def _assumed(crane: CraneDescription) -> Iterator[str]:
    """Numbers that the description does not have: of joints and tables, and of the paper's machine."""
    rules = {**DRIVES, **{n: keys_of(n, addition) for n, addition in ADDITIONS.items()}}
    keys = {n: f"{table}.{key}" for table, of in rules.items() for key, r in of.items() for n in r}
    for j in crane.driven:
        own = [(keys[n], x) for n, x in j.numbers.items() if n in keys and x.note == DEFAULT and x.value]
        own = [(key, x) for key, x in own if key != "hydraulics.drop"]
        yield from _listed(f"[{j.name}]", own)
    for table, numbers in crane.numbers.items():
        own = [(key, numbers[n]) for key, r in TABLES[table].items() for n in r if n in numbers]
        yield from _listed(f"[{table}]", [(key, x) for key, x in own if x.note == DEFAULT and x.value])
    for part, some in borrowed(crane).items() if crane.driven else ():
        for scaled, text in ((True, f", {sizes.SCALED}"), (False, "")):
            own = [(n, x) for n, x in some.items() if x.note.startswith(sizes.SCALED) == scaled]
            yield from _listed(f"{part}, as of the paper's machine{text}:", own)


def _together(crane: CraneDescription, found: Sequence[AxisCheck]) -> Iterator[str]:
    if found:
        yield f"modes of all axes together {', '.join(f'{f:.3g}' for f in modes(crane, found))} Hz"


def _listed(where: str, numbers: Sequence[tuple[str, Number]]) -> Iterator[str]:
    if numbers:
        texts = (f"{key} {x.value:.4g} {x.unit}".removesuffix(" 1") for key, x in numbers)
        yield f"{where} {', '.join(texts)}"


def _loads(found: Sequence[AxisCheck], loads: Capacity) -> Iterator[str]:
    nearest, farthest = (reach for _, reach in loads.ends)
    low, high = loads.values[1].min(), loads.values[1].max()
    yield f"reach {nearest:.2f} to {farthest:.2f} m, height {low:.2f} to {high:.2f} m"
    held = {share * farthest: loads.at(share * farthest) for share in SHARES}
    at = ", ".join(f"{'no pose' if x is None else f'{x:.0f} kg'} at {r:.2f} m" for r, x in held.items())
    yield f"lifting moment {lifting_moment(found) / 1e3:.1f} kN.m gross; load that can be held {at}"


def _compared(
    crane: CraneDescription, found: Sequence[AxisCheck], loads: Capacity
) -> Iterator[tuple[str, float, float | None]]:
    """What the data sheet says: text, its number, that of the file."""
    if moment := crane.datasheet["lifting_moment"]:
        yield "lifting moment, gross [kN.m]", moment / 1e3, lifting_moment(found) / 1e3
    if reach := crane.datasheet["reach"]:
        yield "reach [m]", reach, loads.ends[1][1]
    for reach, load in crane.loads:
        yield f"load at {reach:g} m [kg]", load, loads.at(reach)


def _row(a: AxisCheck, speeds: Speeds | None) -> list[str]:
    unit, scale, digits = ("deg", 180 / math.pi, 1) if a.joint.revolute else ("m", 1.0, 2)
    force, lever = ("kN.m", "1") if a.joint.motor else ("kN", "{:.3f} to {:.3f} m".format(*a.levers))
    low, high = (round(scale * x, digits) + 0.0 for x in (a.low, a.high))  # no -0.0
    ends = f"{low:.{digits}f} to {high:.{digits}f} {unit}" if math.isfinite(low) else "no end"
    moving = list[str]()
    if speeds:
        moving = ["/".join(f"{scale * x:.3g}" for x in speeds[v][:2]) + f" {unit}/s" for v in SUPPLIES]
        moving.append(f"{speeds['lumped'][2]:.1f} m/s")
    return [
        a.joint.name,
        a.joint.drive,
        f"{scale * a.joint.start.value:.{digits}f} {unit}",
        ends,
        lever,
        *(f"{x / 1e3:.3g} {force}" for x in (a.push, a.pull)),
        f"{round(a.holding / 1e5)} bar",  # no -0
        *moving,
        f"{a.mode:.1f} Hz",
    ]
