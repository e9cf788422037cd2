"""Boom and stick drives without line dynamics: a valve directly at a single-ended cylinder each.

The equations are those of `fmus.boom_stick.drive` for the boom and for the stick, in the limit of hoses
without inertance. The hoses are volumes, and resistances in series with the open edges. Line flows are not
states but follow from the pressures.
"""

from collections.abc import Iterator

from fmus.boom_stick import drive
from fmus.boom_stick.drive import CylinderDrive
from fmus.boom_stick.variables import (
    AXES,
    BoomStickInputs,
    BoomStickOutputs,
    OilState,
    Preload,
    Pressures,
    QuasistaticDriveParameters,
)
from fmus.components import spool_valve
from fmus.components.chamber import Oil
from fmus.components.cylinder import Cylinder
from fmus.components.hose import LumpedHose, ReferenceHose, VolumeHose
from fmus.components.opening_curve import OpeningCurves
from fmus.components.spool_valve import CurvedValve, Valve
from fmus.contract import Group, Scalar


class Parameters(
    Oil,
    Preload,
    ReferenceHose,
    valve=CurvedValve,
    boom=QuasistaticDriveParameters,
    stick=QuasistaticDriveParameters,
):
    """Parameters of the quasistatic drives; values and sources are in parameters.toml."""


class State(Group, boom=Pressures, stick=Pressures):
    """State of the quasistatic drives: pressures."""


class VolumeDrive(CylinderDrive):
    """A drive whose line flows follow from the pressures."""

    def rates(self) -> Pressures:
        """Time derivative of the state."""
        head, rod = self.pressure_rates()
        return Pressures(head_pressure=head, rod_pressure=rod)

    def hose_heat(self) -> Scalar:
        """None: the ports have the pressures of the chambers, so that of the edges includes it."""
        return 0


def _drives(x: State, u: BoomStickInputs, p: Parameters) -> Iterator[VolumeDrive]:
    """Boom and stick drive from the variables of the subsystem; line flows follow from the pressures."""
    valve, curves = Valve.of(p, "valve"), OpeningCurves.of(p, "valve")
    for axis, inputs in zip(AXES, drive.inputs(u), strict=True):
        hose = LumpedHose(**vars(VolumeHose.of(p, f"{axis}_hose")), inertance=0.0)
        pressures = Pressures.of(x, axis)
        ports = spool_valve.ports_from_pressure(
            *(valve, inputs.command, pressures.head_pressure, pressures.rod_pressure),
            *(inputs.supply_pressure, inputs.tank_pressure, p.density, hose.resistance, curves),
        )
        oil = OilState(**vars(pressures), head_flow=ports[0].line, rod_flow=ports[1].line)
        yield VolumeDrive(Cylinder.of(p, axis), hose, valve, curves, p.bulk_modulus, oil, inputs, ports)


def initial(x: State, u: BoomStickInputs, p: Parameters) -> dict[str, Scalar]:
    """Initial state: pressures in balance with the holding forces."""
    return drive.holding_pressures(u, p)


BOOM_STICK = drive.variant(
    _drives,
    VolumeHose,
    text="Hydraulic drives of boom and stick without line dynamics: spool valves, cylinders",
    parameters=Parameters,
    states=State,
    outputs=BoomStickOutputs,
    initial=initial,
    require=drive.require,
    validity="motions slow compared with the oil in the hoses, below about 10 Hz;"
    " spool faster than the motion",
    stiff=False,
)
