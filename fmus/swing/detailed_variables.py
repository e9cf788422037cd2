"""Variables of the detailed swing drive; its states depend on the number of lumps."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from fmus.components import chamber, hose_line
from fmus.components.detailed_parameters import FluidParameters, ReliefParameters, SpoolParameters
from fmus.components.hose_line import LineState
from fmus.contract import Quantity, Scalar, make_group, quantities
from fmus.swing.variables import LineParameters, MotorParameters, SwingOutputs, SwingState

SIDES = ("a", "b")


class DetailedParameters(ReliefParameters, FluidParameters, MotorParameters, LineParameters, SpoolParameters):
    """Constants of the detailed drive; their numbers and sources are in parameters.toml."""

    bulk_modulus: Scalar = Quantity("Pa", "Bulk modulus of the oil", 1e9, minimum=1e7, group="Oil")
    line_length: Scalar = Quantity("m", "Length of each swing line", minimum=1e-3, group="Swing lines")
    line_bore: Scalar = Quantity("m", "Bore of each swing line", 0.01, minimum=1e-4)
    motor_volume: Scalar = Quantity(
        "m3", "Volume of each motor side, without the line", 1e-3, minimum=1e-9, group="Swing motor and gear"
    )


def line_names(lumps: int, unsteady_friction: bool) -> tuple[LineState, LineState]:
    """Names of the states of both lines."""
    a, b = (
        hose_line.names(
            f"swing_flow_{side}",
            f"swing_motor_flow_{side}",
            "swing_line",
            f"_{side}",
            lumps,
            unsteady_friction,
        )
        for side in SIDES
    )
    return a, b


def _meanings(side: str, names: LineState) -> Iterator[tuple[str, Quantity]]:
    usual, where = quantities(SwingState), f"swing line {side.upper()}"
    yield f"swing_pressure_{side}", usual[f"swing_pressure_{side}"]
    yield names.flows[0], usual[f"swing_flow_{side}"]
    for k, name in enumerate(names.flows[1:-1], 1):
        yield name, Quantity("m3/s", f"Flow from lump {k} to {k + 1} of {where}", 1e-3)
    yield names.flows[-1], Quantity("m3/s", f"Flow from {where} to the motor", 1e-3)
    for k, name in enumerate(names.pressures, 1):
        yield name, chamber.pressure(f"Pressure of lump {k} of {where}")
    for k, within in enumerate(names.layers):
        for i, name in enumerate(within, 1):
            text = f"Flow in {where} that friction term {i} of flow {k} remembers"
            yield name, Quantity("m3/s", text, 1e-3)


def states(names: tuple[LineState, LineState]) -> type[Any]:
    """The class of the states."""
    meanings = [
        ("swing_spool_position", Quantity("1", "Spool position of the swing valve, share of its stroke")),
        ("swing_spool_speed", Quantity("1/s", "Spool speed of the swing valve", 10.0)),
    ]
    for side, of in zip(SIDES, names, strict=True):
        meanings += _meanings(side, of)
    return make_group("DetailedState", dict(meanings))


class DetailedOutputs(SwingOutputs):
    """With what happens at both ends of the lines and in the relief valves."""

    swing_spool_position: Scalar = Quantity("1", "Spool position of the swing valve, share of its stroke")
    swing_motor_flow_a: Scalar = Quantity("m3/s", "Flow from swing line A to the motor", 1e-3)
    swing_motor_flow_b: Scalar = Quantity("m3/s", "Flow from swing line B to the motor", 1e-3)
    swing_valve_pressure_a: Scalar = Quantity("Pa", "Pressure at port A of the swing valve", 1e7)
    swing_valve_pressure_b: Scalar = Quantity("Pa", "Pressure at port B of the swing valve", 1e7)
    swing_relief_flow: Scalar = Quantity(
        "m3/s", "Flow of the cross-port relief valves from line A to line B", 1e-3
    )
    swing_anti_cavitation_flow: Scalar = Quantity(
        "m3/s", "Flow of both anti-cavitation valves of the swing motor", 1e-3
    )
    swing_bulk_modulus_a: Scalar = Quantity("Pa", "Effective bulk modulus of the oil at motor port A", 1e9)
    swing_bulk_modulus_b: Scalar = Quantity("Pa", "Effective bulk modulus of the oil at motor port B", 1e9)
