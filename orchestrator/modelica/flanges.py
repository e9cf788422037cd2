"""Which signals of an FMU make a mechanical flange, and the model that offers it in place of the signals.

A rod is signals with one stem: NAME_force [N], NAME_position [m], NAME_velocity [m/s] and, from the side that
moves, NAME_acceleration [m/s2]. A shaft likewise: NAME_torque [N.m], NAME_speed [rad/s] and, from the side
that moves, NAME_angle [rad] and NAME_acceleration [rad/s2].
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

from orchestrator.fmi.description import FmuVariable
from orchestrator.modelica.block import FmuBlock, placement, places, signals
from orchestrator.modelica.syntax import Scope, quoted


@dataclass(frozen=True)
class FlangeType:
    """A flange: its adapter, and the words of its signals with unit and causality."""

    adapter: str
    connector: str
    signals: tuple[tuple[str, str, str], ...]


ROD, SHAFT = (
    "Modelica.Mechanics.Translational.Interfaces.Flange",
    "Modelica.Mechanics.Rotational.Interfaces.Flange",
)
KINDS = (
    FlangeType(
        "MovedRod",
        f"{ROD}_a",
        (
            ("force", "N", "input"),
            ("position", "m", "output"),
            ("velocity", "m/s", "output"),
            ("acceleration", "m/s2", "output"),
        ),
    ),
    FlangeType(
        "PushedRod",
        f"{ROD}_b",
        (("force", "N", "output"), ("position", "m", "input"), ("velocity", "m/s", "input")),
    ),
    FlangeType(
        "MovedShaft",
        f"{SHAFT}_a",
        (
            ("torque", "N.m", "input"),
            ("angle", "rad", "output"),
            ("speed", "rad/s", "output"),
            ("acceleration", "rad/s2", "output"),
        ),
    ),
    FlangeType("DrivenShaft", f"{SHAFT}_b", (("torque", "N.m", "output"), ("speed", "rad/s", "input"))),
)


def flanges(m: FmuBlock) -> dict[str, FlangeType]:
    """The flanges of an FMU by their stems."""
    shown = {v.name: v for v in [*m.inputs, *m.outputs]}
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


def with_flanges(m: FmuBlock, wanted: Collection[str]) -> str:
    """A model with the FMU's block and flanges in place of their signals; empty where there is none.

    wanted   outputs that are connectors of the model, too; all others are read from its block
    """
    found = flanges(m)
    if not found:
        return ""
    taken = {f"{stem}_{word}" for stem, kind in found.items() for word, *_ in kind.signals}
    inputs = [v for v in m.inputs if v.name not in taken]
    outputs = [v for v in m.outputs if v.name in wanted and v.name not in taken]
    scope = Scope()
    scope.taken |= m.scope.taken
    ends = {stem: (scope.add(stem), scope.add(f"{stem}_adapter")) for stem in found}
    text = [f"model {m.name} {quoted(m.interface.description)}\n  extends Modelica.Blocks.Icons.Block;\n"]
    text += [p.text for p in m.parameters]
    text += [m.optional[v.name].text for v in inputs if v.name in m.optional]
    text += signals(m, inputs, outputs, at_sides=False)
    for (stem, kind), place in zip(found.items(), places(len(found)), strict=True):
        x = -110.0 if kind.connector.endswith("_a") else 110.0
        text.append(f"  {kind.connector} {ends[stem][0]}\n    annotation({placement(x, place)});\n")
    text.append(f'  FMUs.{m.name} block_(\n{_passed(m, inputs)}) "The FMU";\nprotected\n')
    text += [f"  Flanges.{kind.adapter} {ends[stem][1]};\n" for stem, kind in found.items()]
    text.append("equation\n")
    text += [_connect(m.names[v.name], f"block_.{m.names[v.name]}") for v in [*inputs, *outputs]]
    for stem, kind in found.items():
        flange, adapter = ends[stem]
        text.append(_connect(flange, f"{adapter}.flange"))
        text += [_connect(f"block_.{m.names[f'{stem}_{w}']}", f"{adapter}.{w}") for w, *_ in kind.signals]
    return "".join([*text, f"end {m.name};\n"])


def _passed(m: FmuBlock, inputs: Sequence[FmuVariable]) -> str:
    """Parameters of the block that are those of the model."""
    held = [m.optional[v.name] for v in inputs if v.name in m.optional]
    names = [p.name for p in m.parameters] + [name for h in held for name in (h.use, h.constant)]
    return ",\n".join(f"    {name} = {name}" for name in names)


def _connect(a: str, b: str) -> str:
    return f"  connect({a}, {b});\n"
