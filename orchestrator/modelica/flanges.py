"""Detects the signals of mechanical flanges in an FMU, for its model with flanges in Modelica.

The signals of a rod are NAME_force [N], NAME_position [m], NAME_velocity [m/s] and, if the FMU computes the
motion, NAME_acceleration [m/s2]. The signals of a shaft are NAME_torque [N.m], NAME_speed [rad/s] and, if the
FMU computes the motion, NAME_angle [rad] and NAME_acceleration [rad/s2].
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from orchestrator.fmi.description import FmuVariable
from orchestrator.modelica.block import FmuBlock, OptionalInput
from orchestrator.modelica.syntax import Scope


@dataclass(frozen=True)
class FlangeType:
    """A flange.

    moves   whether the FMU computes the motion; then it gets the force
    units   suffix of each signal -> its unit; first the force or torque
    """

    adapter: str
    connector: str
    moves: bool
    units: Mapping[str, str]

    def fits(self, suffix: str, v: FmuVariable | None) -> bool:
        """Whether a variable is this signal."""
        received = (suffix == next(iter(self.units))) == self.moves
        expected = self.units[suffix], "input" if received else "output"
        return v is not None and v.unit is not None and (v.unit.name, v.causality) == expected


ROD = "Modelica.Mechanics.Translational.Interfaces.Flange"
SHAFT = "Modelica.Mechanics.Rotational.Interfaces.Flange"
FORCE = {"force": "N", "position": "m", "velocity": "m/s"}
TORQUE = {"torque": "N.m", "angle": "rad", "speed": "rad/s", "acceleration": "rad/s2"}
FLANGE_TYPES = (
    FlangeType("MovedRod", f"{ROD}_a", True, {**FORCE, "acceleration": "m/s2"}),
    FlangeType("PushedRod", f"{ROD}_b", False, FORCE),
    FlangeType("MovedShaft", f"{SHAFT}_a", True, TORQUE),
    FlangeType("DrivenShaft", f"{SHAFT}_b", False, {"torque": "N.m", "speed": "rad/s"}),
)


def find_flanges(block: FmuBlock) -> dict[str, FlangeType]:
    """The flanges of an FMU by the common prefix of their signals."""
    variables = {v.name: v for v in [*block.inputs, *block.outputs]}
    result = {}
    for type_ in FLANGE_TYPES:
        first = f"_{next(iter(type_.units))}"
        for prefix in [name.removesuffix(first) for name in variables if name.endswith(first)]:
            if all(type_.fits(suffix, variables.get(f"{prefix}_{suffix}")) for suffix in type_.units):
                result[prefix] = type_
    return result


class Flange(NamedTuple):
    """A flange of a model: prefix of its signals, identifiers of itself and its adapter."""

    type: FlangeType
    prefix: str
    name: str
    adapter: str


@dataclass(frozen=True)
class ModelWithFlanges:
    """A model with the block of the FMU, and flanges instead of their signals.

    outputs   that become connectors of the model; the others can be read from its block
    """

    block: FmuBlock
    flanges: Sequence[Flange]
    inputs: Sequence[FmuVariable]
    outputs: Sequence[FmuVariable]

    @property
    def optional(self) -> list[OptionalInput]:
        """The inputs that need not be connected."""
        return [self.block.optional[v.name] for v in self.inputs if v.name in self.block.optional]

    @property
    def modifiers(self) -> list[str]:
        """Modifiers that set the parameters of the block to those of the model."""
        names = [p.name for p in self.block.parameters]
        names += [name for o in self.optional for name in (o.use, o.constant)]
        return [f"{name} = {name}" for name in names]


def model_with_flanges(block: FmuBlock, connected_outputs: Collection[str]) -> ModelWithFlanges | None:
    """The model with flanges; None without flanges."""
    scope = Scope()
    scope.identifiers |= block.scope.identifiers
    flanges = [
        Flange(type_, prefix, scope.add(prefix), scope.add(f"{prefix}_adapter"))
        for prefix, type_ in find_flanges(block).items()
    ]
    signals = {f"{flange.prefix}_{suffix}" for flange in flanges for suffix in flange.type.units}
    inputs = [v for v in block.inputs if v.name not in signals]
    outputs = [v for v in block.outputs if v.name in connected_outputs and v.name not in signals]
    return ModelWithFlanges(block, flanges, inputs, outputs) if flanges else None
