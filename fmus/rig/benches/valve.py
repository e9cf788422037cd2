"""Valve bench: one metering edge at a time, its other port shut.

    supply --P-A-- port --line-- block --throttle-- return line        the edges from the supply
    supply --throttle-- block --line-- port --B-T-- return line        the edges to the tank

The oil block of 0.5 L and the line, 0.5 m of the stick's hose, are of the bench, not of the machine. The
throttle lets 271 L/min through at 10 V, inside the meter's range, and leaves 16 MPa to the edge; at smaller
openings the edge takes nearly the whole 20 MPa, so its drop is well measured everywhere.
"""

from __future__ import annotations

from fmus.components import chamber, hose
from fmus.rig.benches.bench import RETURN, SUPPLY, Array, Named, detailed, lumped, run, start_flow, throttle
from fmus.rig.benches.spool import bench_valve

EDGES = {"P-A": 1, "B-T": 1, "P-B": -1, "A-T": -1}  # the sign of the command that opens each
THROTTLE = 2.0e11  # C_R [Pa.s2/m6]
LINE = 0.5  # m
BLOCK = 0.5e-3  # m3


def valve(machine: str, edge: str, time: Array, command: Array) -> dict[str, Array]:
    """Pressures before and behind the edge [Pa] and the flow through it [m3/s], for commands [V]."""
    spool, p = bench_valve(machine), lumped()
    feeds, at_a = edge.startswith("P"), "A" in edge
    far = RETURN if feeds else SUPPLY
    share = LINE / detailed().stick_hose_length
    friction = (hose.scaled_resistance(p.stick_hose_resistance, share, 1.0), p.valve_transition_flow)

    def equations(x: Named, u: Named) -> tuple[Named, Named]:
        flow, block = x["flow"], x["block"]  # out of the port
        at_ports = (flow if at_a else 0.0, 0.0 if at_a else flow)
        ports = spool.ports(x, u["command"], at_ports, RETURN)
        port = ports[0 if at_a else 1].pressure
        through = throttle(block - far, THROTTLE, p.valve_transition_flow)
        rates = {
            "flow": hose.flow_rate(port, block, flow, share * p.stick_hose_inertance, *friction),
            "block": chamber.pressure_rate(block, flow - through, BLOCK / p.bulk_modulus),
        }
        seen = (SUPPLY, port, flow) if feeds else (port, RETURN, -flow)
        names = ("pressure_in", "pressure_out", "flow")
        return rates | spool.rates(x, u["command"]), dict(zip(names, seen, strict=True))

    leaks = start_flow(p.valve_leakage) * (1 if feeds else -1)
    states = {"flow": (leaks, 1e-3), "block": (far, 1e7)}
    return run(states | spool.states, equations, time, {"command": command})
