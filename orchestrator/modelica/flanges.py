"""Detects the signals of mechanical flanges in an FMU, and writes its model with flanges in Modelica.

The signals of a rod are NAME_force [N], NAME_position [m], NAME_velocity [m/s] and, if the FMU computes the
motion, NAME_acceleration [m/s2]. The signals of a shaft are NAME_torque [N.m], NAME_speed [rad/s] and, if the
FMU computes the motion, NAME_angle [rad] and NAME_acceleration [rad/s2].
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass

from orchestrator.fmi.description import FmuVariable
from orchestrator.modelica.block import FmuBlock, connectors, placement, positions
from orchestrator.modelica.syntax import Scope, quoted


@dataclass(frozen=True)
class FlangeType:
    """A flange: its adapter and connector, and the (suffix, unit, causality) of its signals."""

    adapter: str
    connector: str
    signals: tuple[tuple[str, str, str], ...]


ROD, SHAFT = (
    "Modelica.Mechanics.Translational.Interfaces.Flange",
    "Modelica.Mechanics.Rotational.Interfaces.Flange",
)
FLANGE_TYPES = (
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


def find_flanges(block: FmuBlock) -> dict[str, FlangeType]:
    """The flanges of an FMU by the common prefix of their signals."""
    variables = {v.name: v for v in [*block.inputs, *block.outputs]}
    result = {}
    for type_ in FLANGE_TYPES:
        first = f"_{type_.signals[0][0]}"
        for prefix in [name.removesuffix(first) for name in variables if name.endswith(first)]:
            signals = [
                (variables.get(f"{prefix}_{suffix}"), unit, causality)
                for suffix, unit, causality in type_.signals
            ]
            if all(v and v.unit and (v.unit.name, v.causality) == (u, c) for v, u, c in signals):
                result[prefix] = type_
    return result


def model_with_flanges(block: FmuBlock, connected_outputs: Collection[str]) -> str:
    """Code of a model with the block of the FMU, and flanges instead of their signals; empty without flanges.

    connected_outputs   outputs that become connectors of the model; the others can be read from its block
    """
    flanges = find_flanges(block)
    if not flanges:
        return ""
    flange_signals = {
        f"{prefix}_{suffix}" for prefix, type_ in flanges.items() for suffix, *_ in type_.signals
    }
    inputs = [v for v in block.inputs if v.name not in flange_signals]
    outputs = [v for v in block.outputs if v.name in connected_outputs and v.name not in flange_signals]
    scope = Scope()
    scope.identifiers |= block.scope.identifiers
    names = {prefix: (scope.add(prefix), scope.add(f"{prefix}_adapter")) for prefix in flanges}
    text = [
        f"model {block.name} {quoted(block.interface.description)}\n  extends Modelica.Blocks.Icons.Block;\n"
    ]
    text += [p.declaration for p in block.parameters]
    text += [block.optional[v.name].declarations for v in inputs if v.name in block.optional]
    text += connectors(block, inputs, outputs, at_sides=False)
    for (prefix, type_), y in zip(flanges.items(), positions(len(flanges)), strict=True):
        x = -110.0 if type_.connector.endswith("_a") else 110.0
        text.append(f"  {type_.connector} {names[prefix][0]}\n    annotation({placement(x, y)});\n")
    text.append(f'  FMUs.{block.name} block_(\n{_modifiers(block, inputs)}) "The FMU";\nprotected\n')
    text += [f"  Flanges.{type_.adapter} {names[prefix][1]};\n" for prefix, type_ in flanges.items()]
    text.append("equation\n")
    text += [_connect(block.names[v.name], f"block_.{block.names[v.name]}") for v in [*inputs, *outputs]]
    for prefix, type_ in flanges.items():
        flange, adapter = names[prefix]
        text.append(_connect(flange, f"{adapter}.flange"))
        text += [
            _connect(f"block_.{block.names[f'{prefix}_{suffix}']}", f"{adapter}.{suffix}")
            for suffix, *_ in type_.signals
        ]
    return "".join([*text, f"end {block.name};\n"])


def _modifiers(block: FmuBlock, inputs: Sequence[FmuVariable]) -> str:
    """Modifiers that set the parameters of the block to those of the model."""
    optional = [block.optional[v.name] for v in inputs if v.name in block.optional]
    names = [p.name for p in block.parameters] + [name for o in optional for name in (o.use, o.constant)]
    return ",\n".join(f"    {name} = {name}" for name in names)


def _connect(a: str, b: str) -> str:
    return f"  connect({a}, {b});\n"
