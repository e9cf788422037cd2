"""Boom and stick drives in detail: moving spools, hoses as lines, oil with air, relief valves.

For each drive, with a single-ended cylinder,

    C_h dP_h/dt = Q_h - A_h x' - Q_relief,h + Q_anti,h        C_h = (V_0 + A_h x) kappa(P_h)
    C_r dP_r/dt = Q_r + A_r x' - Q_relief,r + Q_anti,r        C_r = (V_0 + A_r (L - x)) kappa(P_r)

with the flows Q_h, Q_r out of the hoses of `fmus.components.hose`, kappa of `chamber`, the spool of
`spool_valve` and the relief and anti-cavitation valves of `orifice`, which stand at the cylinder.

`boom_head_flow` and its like are the flows into the cylinder, at the hose's far end; `boom_head_valve_flow`
and its like those at the valve. `detailed` chooses what changes the number of states: the lumps of each
hose and the frequency-dependent friction. Signs as in `fmus.boom_stick.variables`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from fmus.boom_stick import drive, lumped
from fmus.boom_stick.drive import Pair, Surroundings
from fmus.boom_stick.variables import (
    AXES,
    SIDES,
    BoomStickInputs,
    BoomStickState,
    DetailedBoomStickOutputs,
    DetailedBoomStickParameters,
)
from fmus.components import chamber, cylinder, hose, orifice, spool_valve
from fmus.components.chamber import Fluid
from fmus.components.cylinder import Cylinder
from fmus.components.hose import Hose, Line, LineState
from fmus.components.orifice import PressureValve
from fmus.components.spool_valve import EdgeFlows, Edges, Spool, SpoolState
from fmus.contract import Quantity, Scalar, Subsystem, family, make_group, quantities
from fmus.parameters import read

NUMBERS = Path(__file__).with_name("parameters.toml")


@dataclass(frozen=True)
class DriveState:
    """Spool, both hoses and the pressures [Pa] of both chambers; also their rates, or their names."""

    spool: SpoolState
    lines: tuple[LineState, LineState]
    pressures: tuple[Any, Any]

    def all(self) -> tuple[Any, ...]:
        """All entries in order."""
        head, rod = self.lines
        return (*self.pressures, *head.all(), *rod.all(), self.spool.position, self.spool.speed)


@dataclass(frozen=True)
class DetailedDrive:
    """One drive at one instant: its parts, its state, what it sees, and what follows at once.

    ports    of the valve; A feeds the head, B the rod side
    relief   flows of the relief valves of both chambers [m3/s]
    drawn    flows of the anti-cavitation valves [m3/s]
    """

    cylinder: Cylinder
    line: Line
    spool: Spool
    full_command: Scalar
    x: DriveState
    u: Surroundings
    ports: tuple[EdgeFlows, EdgeFlows]
    relief: Pair
    drawn: Pair

    @property
    def volumes(self) -> Pair:
        """Volumes [m3] of the chambers."""
        return self.cylinder.volumes(self.u.position)

    def pressure_rates(self) -> Pair:
        """dP/dt [Pa/s] of both chambers."""
        a_head, a_rod = self.cylinder.areas
        moved = (-a_head * self.u.velocity, a_rod * self.u.velocity)
        head, rod = (
            chamber.pressure_rate(
                p, of.flows[-1] + swept - relief + drawn, v * chamber.compliance(self.line.fluid, p)
            )
            for p, of, swept, relief, drawn, v in zip(
                self.x.pressures, self.x.lines, moved, self.relief, self.drawn, self.volumes, strict=True
            )
        )
        return head, rod

    def rates(self) -> DriveState:
        """Time derivative of the state."""
        wanted = spool_valve.commanded_position(self.u.command, self.full_command)
        head, rod = (
            hose.rates(self.line, of, port.pressure, p)
            for of, port, p in zip(self.x.lines, self.ports, self.x.pressures, strict=True)
        )
        spool = spool_valve.spool_rates(self.spool, self.x.spool, wanted)
        return DriveState(spool, (head, rod), self.pressure_rates())

    def observe(self) -> dict[str, Scalar]:
        """Outputs, without the name of the axis; those in `drive.TOTALS` count for both together."""
        (head, rod), (p_head, p_rod) = self.cylinder.areas, self.x.pressures
        fluid, tank = self.line.fluid, self.u.tank_pressure
        relieved = tuple(out - back for out, back in zip(self.relief, self.drawn, strict=True))
        densities = tuple(chamber.energy_density(fluid, p) for p in self.x.pressures)
        compression = sum(
            v * e + chamber.stored_energy(p, 0.0)
            for v, e, p in zip(self.volumes, densities, self.x.pressures, strict=True)
        )
        edges = sum(spool_valve.throttling_loss(n, self.u.supply_pressure, tank) for n in self.ports)
        safety = (p_head - tank) * relieved[0] + (p_rod - tank) * relieved[1]
        shown = {
            "force": cylinder.force(head, rod, p_head, p_rod),
            "force_rate": cylinder.force(head, rod, *self.pressure_rates()),
            "void_volume": sum(map(chamber.cavity_volume, self.x.pressures))
            + sum(map(hose.cavity_volume, self.x.lines)),
            "spool_position": self.x.spool.position,
            "relief_flow": sum(self.relief),
            "anti_cavitation_flow": sum(self.drawn),
            "supply_flow": sum(n.supply for n in self.ports),
            "return_flow": sum(n.tank for n in self.ports) + sum(relieved),
            "stored_energy": compression + sum(hose.stored_energy(self.line, of) for of in self.x.lines),
            "dissipated_power": edges + safety + sum(hose.heat(self.line, of) for of in self.x.lines),
            "convected_power": (head * densities[0] - rod * densities[1]) * self.u.velocity,
        }
        for side, p, port, of in zip(SIDES, self.x.pressures, self.ports, self.x.lines, strict=True):
            shown |= {
                f"{side}_pressure": p,
                f"{side}_flow": of.flows[-1],
                f"{side}_valve_flow": of.flows[0],
                f"{side}_valve_pressure": port.pressure,
                f"{side}_bulk_modulus": chamber.bulk_modulus(fluid, p),
            }
        return shown


def line(p: DetailedBoomStickParameters, axis: str) -> Line:
    """Each of the two hoses of a drive."""
    return Line(**vars(Hose.of(p, f"{axis}_hose")), wall_modulus=p.hose_wall_modulus, fluid=Fluid.of(p))


def _drives(
    names: Mapping[str, DriveState], x: Any, u: BoomStickInputs, p: DetailedBoomStickParameters
) -> Iterator[DetailedDrive]:
    """Boom and stick from the flat variables."""
    edges, spool = Edges.of(p, "valve"), Spool.of(p, "spool")
    relief, anti = PressureValve.of(p, "relief"), PressureValve.of(p, "anti_cavitation")
    for (axis, n), at in zip(names.items(), drive.surroundings(u), strict=True):
        head, rod = (of.apply(partial(getattr, x)) for of in n.lines)
        now = DriveState(
            SpoolState(getattr(x, n.spool.position), getattr(x, n.spool.speed)),
            (head, rod),
            (getattr(x, n.pressures[0]), getattr(x, n.pressures[1])),
        )
        over = tuple(pressure - at.tank_pressure for pressure in now.pressures)
        yield DetailedDrive(
            *(Cylinder.of(p, axis), line(p, axis), spool, edges.full_command, now, at),
            ports=spool_valve.spool_ports(
                *(edges, spool, now.spool.position, head.flows[0], rod.flows[0]),
                *(at.supply_pressure, at.tank_pressure, p.density),
            ),
            relief=(orifice.relief_flow(relief, over[0]), orifice.relief_flow(relief, over[1])),
            drawn=(orifice.relief_flow(anti, -over[0]), orifice.relief_flow(anti, -over[1])),
        )


def _names(axis: str, lumps: int, unsteady_friction: bool) -> DriveState:
    """Names of the states of one drive."""
    head, rod = (
        hose.state_names(
            *(f"{axis}_{side}_valve_flow", f"{axis}_{side}_flow", f"{axis}_{side}_hose", ""),
            *(lumps, unsteady_friction),
        )
        for side in SIDES
    )
    spool = SpoolState(f"{axis}_spool_position", f"{axis}_spool_speed")
    return DriveState(spool, (head, rod), (f"{axis}_head_pressure", f"{axis}_rod_pressure"))


def _states(axis: str, names: DriveState) -> Iterator[tuple[str, Quantity]]:
    """The states of one drive."""
    usual = quantities(BoomStickState)
    yield names.spool.position, Quantity("1", f"Spool position of the {axis} valve, share of its stroke")
    yield names.spool.speed, Quantity("1/s", f"Spool speed of the {axis} valve", 10.0)
    for side, of, pressure in zip(SIDES, names.lines, names.pressures, strict=True):
        where = f"the {side} hose of the {axis}"
        first = Quantity("m3/s", f"Flow from the valve into {where}", 1e-3)
        yield pressure, usual[pressure]
        yield from hose.state_quantities(of, where, first, usual[of.flows[-1]])


def _initial(
    names: Mapping[str, DriveState], x: Any, u: BoomStickInputs, p: DetailedBoomStickParameters
) -> dict[str, Scalar]:
    """Pressures that carry the holding forces, all along the hoses; no flow; the spool where it is told."""
    chambers = drive.holding_pressures(u, p)
    state: dict[str, Scalar] = {}
    for n, command in zip(names.values(), (u.boom_command, u.stick_command), strict=True):
        state |= dict.fromkeys(n.all(), 0.0)
        state[n.spool.position] = spool_valve.commanded_position(command, p.valve_full_command)
        for pressure, of in zip(n.pressures, n.lines, strict=True):
            state |= dict.fromkeys((pressure, *of.pressures), chambers[pressure])
    return state


def default_lumps() -> dict[str, int]:
    """Lumps per hose by axis with the numbers of parameters.toml."""
    found = read(NUMBERS)["parameters"]
    p = DetailedBoomStickParameters(
        **{name: found[name].value for name in quantities(DetailedBoomStickParameters)}
    )
    return {axis: hose.default_lumps(line(p, axis)) for axis in AXES}


def detailed(lumps: int | Mapping[str, int] | None = None, unsteady_friction: bool = False) -> Subsystem:
    """The detailed drives.

    lumps               T-lumps per hose, or by axis; by default what `hose.lumps_needed` advises up to 75 Hz
    unsteady_friction   with the frequency-dependent friction of the hoses: three more states for each flow
    """
    count = default_lumps() if lumps is None else lumps
    each = {axis: count if isinstance(count, int) else count[axis] for axis in AXES}
    names = {axis: _names(axis, n, unsteady_friction) for axis, n in each.items()}
    state = make_group(
        "DetailedBoomStickState", dict(q for axis, n in names.items() for q in _states(axis, n))
    )

    def dynamics(x: Any, u: BoomStickInputs, p: DetailedBoomStickParameters) -> Any:
        """Time derivative of the state."""
        both = zip(names.values(), _drives(names, x, u, p), strict=True)
        return state(**{n: r for own, d in both for n, r in zip(own.all(), d.rates().all(), strict=True)})

    def observe(x: Any, u: BoomStickInputs, p: DetailedBoomStickParameters) -> DetailedBoomStickOutputs:
        """Outputs; forces depend on the state alone, their rates and the flows on the inputs too."""
        boom, stick = (d.observe() for d in _drives(names, x, u, p))
        return drive.together(DetailedBoomStickOutputs, boom, stick)

    sub = Subsystem(
        name="boom_stick",
        text="Hydraulic drives of boom and stick in detail: moving spools, lines, air, relief valves",
        parameters=DetailedBoomStickParameters,
        states=state,
        inputs=BoomStickInputs,
        outputs=DetailedBoomStickOutputs,
        dynamics=dynamics,
        observe=observe,
        initial=partial(_initial, names),
        require=drive.room,
        derive=partial(drive.derive, Hose),
        values=NUMBERS,
        validity="modes of the hoses up to 75 Hz within 5 %; no flow forces on spools, one temperature",
        terminals=drive.TERMINALS,
    )
    return family("boom_stick", lumped=lumped.BOOM_STICK, detailed=sub)["detailed"]


BOOM_STICK = detailed()
