"""Hose bench: a valve feeds the 4 m hose of 3/4 in, the stick's, whose end is a throttle to the return line.

    supply --valve-- (P_in, Q_in) ==hose== (P_out, Q_out) --throttle-- return line

lumped     I dQ/dt = P_in - P_out - C_R Q|Q|, C dP_out/dt = Q - Q_out, as in `fmus.components.cylinder_drive`
detailed   the line of lumps of `fmus.components.line`, with elastic wall, air and both kinds of friction

Nothing but the hose lies between the two pairs of instruments.
"""

from __future__ import annotations

from fmus.boom_stick import detailed as boom_stick_detailed
from fmus.components import chamber, hose, line
from fmus.components.spool_valve import turbulent_drop
from fmus.rig.benches.bench import RETURN, Array, Named, detailed, lumped, run, start_flow, throttle
from fmus.rig.benches.spool import bench_valve


def stick_hose(machine: str, resistance: float, time: Array, command: Array) -> dict[str, Array]:
    """Pressures [Pa] and flows [m3/s] at both ends, for commands [V] to the valve.

    resistance   C_R [Pa.s2/m6] of the throttle
    """
    bench = _detailed if machine == "detailed" else _lumped
    return bench(resistance, time, command)


def _lumped(resistance: float, time: Array, command: Array) -> dict[str, Array]:
    # a valve without a spool to move would make pressures jump within a sample, which no logger can record
    spool, p = bench_valve("detailed"), lumped()

    def equations(x: Named, u: Named) -> tuple[Named, Named]:
        inlet = spool.ports(x, u["command"], (x["flow"], 0.0), RETURN)[0].pressure
        out = throttle(x["outlet"] - RETURN, resistance, p.valve_transition_flow)
        own = (p.stick_hose_inertance, p.stick_hose_resistance, p.valve_transition_flow)
        rates = {
            "flow": hose.flow_rate(inlet, x["outlet"], x["flow"], *own),
            "outlet": chamber.pressure_rate(x["outlet"], x["flow"] - out, p.stick_hose_capacitance),
            **spool.rates(x, u["command"]),
        }
        seen = {"pressure_in": inlet, "pressure_out": x["outlet"], "flow_in": x["flow"], "flow_out": out}
        return rates, seen

    still = {"flow": (0.0, 1e-3), "outlet": (RETURN, 1e7)}
    return run(still | spool.states, equations, time, {"command": command})


def _detailed(resistance: float, time: Array, command: Array) -> dict[str, Array]:
    spool, p = bench_valve("detailed"), detailed()
    of = boom_stick_detailed.hose(p, "stick")
    lumps = boom_stick_detailed.advised_lumps()["stick"]
    names = line.names("first_flow", "last_flow", "inner", "", lumps, unsteady_friction=False)

    def equations(x: Named, u: Named) -> tuple[Named, Named]:
        state = names.each(lambda name: x[name])
        inlet = spool.ports(x, u["command"], (state.flows[0], 0.0), RETURN)[0].pressure
        outlet = RETURN + turbulent_drop(state.flows[-1], resistance, p.valve_transition_flow)
        along = line.rates(of, state, inlet, outlet)
        rates = dict(zip(names.all(), along.all(), strict=True)) | spool.rates(x, u["command"])
        seen = {"pressure_in": inlet, "pressure_out": outlet}
        return rates, seen | {"flow_in": state.flows[0], "flow_out": state.flows[-1]}

    still = dict.fromkeys(names.flows, (start_flow(p.valve_leakage), 1e-3))
    still |= dict.fromkeys(names.pressures, (RETURN, 1e7))
    return run(still | spool.states, equations, time, {"command": command})
