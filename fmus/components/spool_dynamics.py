"""A spool that follows its command: second order, limited in speed and stroke; four edges with overlaps.

    dx/dt = v        dv/dt = 2 z w (v_c - v)        v_c = min(max(s(w/(2 z) (u - x)), -c (1 + x)), c (1 - x))

x is the position as share of the stroke, u the command likewise, w the natural frequency, z the damping
ratio, s a saturation at the largest speed v_max: exactly linear up to 0.9 v_max, twice continuously
differentiable, so that small motions obey x'' + 2 z w x' + w^2 x = w^2 u. The last two limits, with
c = z w/2, keep the spool inside its stroke: its speed towards an end stays below z w times the way left. No
command makes it hit a stop, so no stop has to be modelled. They act closer than v_max/c to an end.
|v| <= v_max stays true as well.

Reference: the second-order model of data sheets; B. Petrovic and J. Mattila 2022 give 30 Hz and 0.707. Edges
as in `fmus.components.spool_valve`, each open from its own overlap on.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from fmus.components import spool_valve
from fmus.components.smooth import ramp
from fmus.components.spool_valve import PortFlow
from fmus.contract import Scalar


@dataclass(frozen=True)
class Spool:
    """Natural frequency w [rad/s], damping ratio z [1], largest speed v_max [1/s]."""

    frequency: Scalar
    damping: Scalar
    speed: Scalar


@dataclass(frozen=True)
class SpoolState:
    """Position [1] and speed [1/s]; also their rates, or their names."""

    position: Scalar
    speed: Scalar


def saturation(z: Scalar) -> Scalar:
    """z up to 0.9, +-1 beyond 1.1, a smooth bend in between."""
    return z - ramp(z - 0.9, 0.2) + ramp(-z - 0.9, 0.2)


def share(command: Scalar, full_command: Scalar) -> Scalar:
    """Position [1] that a command [V] asks for: full stroke from the full command on."""
    return ca.fmax(-1, ca.fmin(1, command / full_command))


def rates(spool: Spool, x: SpoolState, wanted: Scalar) -> SpoolState:
    """Time derivative of the state for a wanted position [1]."""
    lag = 2 * spool.damping * spool.frequency
    closing = lag / 4
    free = spool.speed * saturation(spool.frequency**2 / lag * (wanted - x.position) / spool.speed)
    limited = ca.fmin(ca.fmax(free, -closing * (1 + x.position)), closing * (1 - x.position))
    return SpoolState(x.speed, lag * (limited - x.speed))


@dataclass(frozen=True)
class Edges:
    """Four metering edges: area [m2] at full stroke, overlaps and rounding as shares of the stroke [1]."""

    area: Scalar
    discharge_coefficient: Scalar
    overlap_pa: Scalar
    overlap_at: Scalar
    overlap_pb: Scalar
    overlap_bt: Scalar
    rounding: Scalar
    leakage: Scalar
    transition_flow: Scalar


def ports(
    edges: Edges,
    position: Scalar,
    flow_a: Scalar,
    flow_b: Scalar,
    supply_pressure: Scalar,
    tank_pressure: Scalar,
    density: Scalar,
) -> tuple[PortFlow, PortFlow]:
    """Both port nodes at a spool position and the line flows [m3/s] out of A and B."""
    full = spool_valve.flow_gain(edges.area, edges.discharge_coefficient, density)

    def gain(x: Scalar, overlap: Scalar) -> Scalar:
        return full * spool_valve.opening(x, overlap, 1.0, edges.rounding)

    rest = (edges.leakage, edges.transition_flow, supply_pressure, tank_pressure)
    return (
        spool_valve.port(flow_a, gain(position, edges.overlap_pa), gain(-position, edges.overlap_at), *rest),
        spool_valve.port(flow_b, gain(-position, edges.overlap_pb), gain(position, edges.overlap_bt), *rest),
    )
