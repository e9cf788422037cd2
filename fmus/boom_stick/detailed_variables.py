"""Variables of the detailed boom and stick drives; their states depend on the number of lumps."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from fmus.boom_stick.variables import BoomStickOutputs, BoomStickState, CylinderParameters
from fmus.components import chamber, hose_line
from fmus.components.detailed_parameters import FluidParameters, ReliefParameters, SpoolParameters
from fmus.components.hose_drive import DriveState
from fmus.components.spool_dynamics import SpoolState
from fmus.contract import Quantity, Scalar, make_group, quantities

AXES = ("boom", "stick")
SIDES = ("head", "rod")


class DetailedParameters(ReliefParameters, FluidParameters, CylinderParameters, SpoolParameters):
    """Constants of the detailed drives; their numbers and sources are in parameters.toml."""

    boom_hose_length: Scalar = Quantity("m", "Length of each boom hose", minimum=1e-3, group="Boom hoses")
    boom_hose_bore: Scalar = Quantity("m", "Bore of each boom hose", 0.01, minimum=1e-4)
    stick_hose_length: Scalar = Quantity("m", "Length of each stick hose", minimum=1e-3, group="Stick hoses")
    stick_hose_bore: Scalar = Quantity("m", "Bore of each stick hose", 0.01, minimum=1e-4)


def drive_names(axis: str, lumps: int, unsteady_friction: bool) -> DriveState:
    """Names of the states of one drive."""
    head, rod = (
        hose_line.names(
            f"{axis}_{side}_valve_flow",
            f"{axis}_{side}_flow",
            f"{axis}_{side}_hose",
            "",
            lumps,
            unsteady_friction,
        )
        for side in SIDES
    )
    spool = SpoolState(f"{axis}_spool_position", f"{axis}_spool_speed")
    return DriveState(spool, head, rod, f"{axis}_head_pressure", f"{axis}_rod_pressure")


def _meanings(axis: str, names: DriveState) -> Iterator[tuple[str, Quantity]]:
    usual = quantities(BoomStickState)
    yield names.spool.position, Quantity("1", f"Spool position of the {axis} valve, share of its stroke")
    yield names.spool.speed, Quantity("1/s", f"Spool speed of the {axis} valve", 10.0)
    for side, hose in zip(SIDES, (names.head_line, names.rod_line), strict=True):
        where = f"the {side} hose of the {axis}"
        yield f"{axis}_{side}_pressure", usual[f"{axis}_{side}_pressure"]
        yield hose.flows[0], Quantity("m3/s", f"Flow from the valve into {where}", 1e-3)
        for k, name in enumerate(hose.flows[1:-1], 1):
            yield name, Quantity("m3/s", f"Flow from lump {k} to {k + 1} of {where}", 1e-3)
        yield hose.flows[-1], usual[f"{axis}_{side}_flow"]
        for k, name in enumerate(hose.pressures, 1):
            yield name, chamber.pressure(f"Pressure of lump {k} of {where}")
        for k, within in enumerate(hose.layers):
            for i, name in enumerate(within, 1):
                text = f"Flow in {where} that friction term {i} of flow {k} remembers"
                yield name, Quantity("m3/s", text, 1e-3)


def states(names: Mapping[str, DriveState]) -> type[Any]:
    """The class of the states of both drives."""
    meanings = [item for axis, of in names.items() for item in _meanings(axis, of)]
    return make_group("DetailedState", dict(meanings))


class DetailedOutputs(BoomStickOutputs):
    """With what happens at the valves, where a machine's sensors sit, and in the relief valves."""

    boom_spool_position: Scalar = Quantity("1", "Spool position of the boom valve, share of its stroke")
    stick_spool_position: Scalar = Quantity("1", "Spool position of the stick valve, share of its stroke")
    boom_head_valve_flow: Scalar = Quantity(
        "m3/s", "Flow from the valve into the head hose of the boom", 1e-3
    )
    boom_rod_valve_flow: Scalar = Quantity("m3/s", "Flow from the valve into the rod hose of the boom", 1e-3)
    stick_head_valve_flow: Scalar = Quantity(
        "m3/s", "Flow from the valve into the head hose of the stick", 1e-3
    )
    stick_rod_valve_flow: Scalar = Quantity(
        "m3/s", "Flow from the valve into the rod hose of the stick", 1e-3
    )
    boom_head_valve_pressure: Scalar = Quantity("Pa", "Pressure at port A of the boom valve", 1e7)
    boom_rod_valve_pressure: Scalar = Quantity("Pa", "Pressure at port B of the boom valve", 1e7)
    stick_head_valve_pressure: Scalar = Quantity("Pa", "Pressure at port A of the stick valve", 1e7)
    stick_rod_valve_pressure: Scalar = Quantity("Pa", "Pressure at port B of the stick valve", 1e7)
    boom_relief_flow: Scalar = Quantity("m3/s", "Flow of both relief valves of the boom cylinder", 1e-3)
    stick_relief_flow: Scalar = Quantity("m3/s", "Flow of both relief valves of the stick cylinder", 1e-3)
    boom_anti_cavitation_flow: Scalar = Quantity(
        "m3/s", "Flow of both anti-cavitation valves of the boom cylinder", 1e-3
    )
    stick_anti_cavitation_flow: Scalar = Quantity(
        "m3/s", "Flow of both anti-cavitation valves of the stick cylinder", 1e-3
    )
    boom_head_bulk_modulus: Scalar = Quantity(
        "Pa", "Effective bulk modulus of the oil at the head side of the boom", 1e9
    )
    boom_rod_bulk_modulus: Scalar = Quantity(
        "Pa", "Effective bulk modulus of the oil at the rod side of the boom", 1e9
    )
    stick_head_bulk_modulus: Scalar = Quantity(
        "Pa", "Effective bulk modulus of the oil at the head side of the stick", 1e9
    )
    stick_rod_bulk_modulus: Scalar = Quantity(
        "Pa", "Effective bulk modulus of the oil at the rod side of the stick", 1e9
    )
