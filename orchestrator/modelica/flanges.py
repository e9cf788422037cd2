"""Which signals of an FMU make a mechanical flange, and the model that offers it in place of the signals.

A rod is signals with one stem: NAME_force [N], NAME_position [m], NAME_velocity [m/s] and, from the side that
moves, NAME_acceleration [m/s2]. A shaft likewise: NAME_torque [N.m], NAME_speed [rad/s] and, from the side
that moves, NAME_angle [rad] and NAME_acceleration [rad/s2].
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

from orchestrator.modelica.block import (
    Model,
    choice,
    connector,
    identifier,
    number,
    parameters,
    places,
    quoted,
)
from orchestrator.system.interface import Variable


@dataclass(frozen=True)
class Kind:
    """A flange: its adapter, and the words of its signals with unit and causality."""

    adapter: str
    connector: str
    signals: tuple[tuple[str, str, str], ...]


ROD, SHAFT = (
    "Modelica.Mechanics.Translational.Interfaces.Flange",
    "Modelica.Mechanics.Rotational.Interfaces.Flange",
)
KINDS = (
    Kind(
        "MovedRod",
        f"{ROD}_a",
        (
            ("force", "N", "input"),
            ("position", "m", "output"),
            ("velocity", "m/s", "output"),
            ("acceleration", "m/s2", "output"),
        ),
    ),
    Kind(
        "PushedRod",
        f"{ROD}_b",
        (("force", "N", "output"), ("position", "m", "input"), ("velocity", "m/s", "input")),
    ),
    Kind(
        "MovedShaft",
        f"{SHAFT}_a",
        (
            ("torque", "N.m", "input"),
            ("angle", "rad", "output"),
            ("speed", "rad/s", "output"),
            ("acceleration", "rad/s2", "output"),
        ),
    ),
    Kind("DrivenShaft", f"{SHAFT}_b", (("torque", "N.m", "output"), ("speed", "rad/s", "input"))),
)


def flanges(m: Model) -> dict[str, Kind]:
    """The flanges of an FMU by their stems."""
    shown = {v.name: v for v in [*m.moving, *m.outputs]}
    found = {}
    for kind in KINDS:
        first = f"_{kind.signals[0][0]}"
        for stem in [name.removesuffix(first) for name in shown if name.endswith(first)]:
            signals = [
                (shown.get(f"{stem}_{word}"), unit, causality) for word, unit, causality in kind.signals
            ]
            if all(v and v.unit and (v.unit.name, v.causality) == (u, c) for v, u, c in signals):
                found[stem] = kind
    return found


def with_flanges(m: Model, wanted: Collection[str]) -> str:
    """A model with the FMU's block and flanges in place of their signals; empty where there is none.

    wanted   outputs that are connectors of the model, too; all others are read from its block
    """
    found = flanges(m)
    if not found:
        return ""
    taken = {f"{stem}_{word}" for stem, kind in found.items() for word, *_ in kind.signals}
    inputs = [v for v in m.moving if v.name not in taken]
    outputs = [v for v in m.outputs if v.name in wanted and v.name not in taken]
    text = [f"model {m.name} {quoted(m.face.text)}\n  extends Modelica.Blocks.Icons.Block;\n"]
    text.append(_signals(m, inputs, outputs))
    ends = places(len(found))
    for (stem, kind), place in zip(found.items(), ends, strict=True):
        x = -110.0 if kind.connector.endswith("_a") else 110.0
        text.append(
            f"  {kind.connector} {stem}\n    annotation(Placement(transformation("
            f"extent = {{{{{x - 10:g}, {place - 10:g}}}, {{{x + 10:g}, {place + 10:g}}}}})));\n"
        )
    held = "".join(f", use_{v.name}_in = use_{v.name}_in" for v in inputs if v.name in m.held)
    text.append(f'  FMUs.{m.name} block_(\n{_passed(m)}{held}) "The FMU";\nprotected\n')
    text += [f"  Flanges.{kind.adapter} {stem}_adapter;\n" for stem, kind in found.items()]
    text.append("equation\n")
    text += [_connect(identifier(v.name), f"block_.{identifier(v.name)}") for v in [*inputs, *outputs]]
    for stem, kind in found.items():
        text.append(_connect(stem, f"{stem}_adapter.flange"))
        text += [_connect(f"block_.{stem}_{w}", f"{stem}_adapter.{w}") for w, *_ in kind.signals]
    return "".join([*text, f"end {m.name};\n"])


def _signals(m: Model, inputs: Sequence[Variable], outputs: Sequence[Variable]) -> str:
    text = [
        f"  parameter Real {name} = {number(value)} {quoted(v.text)};\n"
        for name, (v, value) in parameters(m).items()
    ]
    for v in inputs:
        if v.name in m.held:
            text.append(choice(v.name))
    for v, x in zip(inputs, places(max(len(inputs), 1)), strict=False):
        text.append(connector(v, "RealInput", x, -110.0, f" if use_{v.name}_in" if v.name in m.held else ""))
    for v, x in zip(outputs, places(max(len(outputs), 1)), strict=False):
        text.append(connector(v, "RealOutput", x, 110.0))
    return "".join(text)


def _passed(m: Model) -> str:
    return ",\n".join(f"    {name} = {name}" for name in parameters(m))


def _connect(a: str, b: str) -> str:
    return f"  connect({a}, {b});\n"
