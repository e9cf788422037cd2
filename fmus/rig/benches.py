"""Benches: one part of the machine between a supply, a throttle and the instruments.

All benches have a supply of constant pressure and a return line whose filter keeps `RETURN` [Pa], so that no
pressure comes near zero. Throttles obey eq. (1). Each bench is a small ODE, solved like the machine.

Valve bench: one metering edge at a time, its other port shut.

    supply --P-A-- port --line-- block --throttle-- return line        the edges from the supply
    supply --throttle-- block --line-- port --B-T-- return line        the edges to the tank

The spool is that of the machine: one that is where the command wants it, or one that moves. The oil block of
0.5 L and the line, 0.5 m of the stick's hose, are of the bench, not of the machine. The throttle lets
271 L/min through at 10 V, inside the meter's range, and leaves 16 MPa to the edge; at smaller openings the
edge takes nearly the whole 20 MPa, so its drop is well measured everywhere.

Hose bench: a valve feeds the 4 m hose of 3/4 in, the stick's, whose end is a throttle to the return line.
Nothing but the hose lies between the two pairs of instruments.

    supply --valve-- (P_in, Q_in) ==hose== (P_out, Q_out) --throttle-- return line

lumped     I dQ/dt = P_in - P_out - C_R Q|Q|, C dP_out/dt = Q - Q_out, as in `fmus.boom_stick.drive`
detailed   the line of lumps of `fmus.components.hose`, with elastic wall, air and both kinds of friction

Motor bench: the swing motor with its shaft locked; pressure reducing valves set both port pressures.

    set pressure --throttle-- side of the motor --leakage-- drain

    C dP_a/dt = (P_set,a - P_a)/R - Q_a        Q_a = (P_a - P_b)/R_in + P_a/R_ex        eqs. (11), (12)

The meter in line A stands between throttle and motor side in the detailed machine, whose motor has a
volume of its own; in the lumped machine, whose volume is that of the line, between the line and the motor.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from fmus import boom_stick, swing
from fmus.boom_stick import detailed as boom_stick_detailed
from fmus.boom_stick.variables import BoomStickParameters, DetailedBoomStickParameters
from fmus.components import chamber, hose, motor, spool_valve
from fmus.components.chamber import Fluid
from fmus.components.spool_valve import (
    EdgeFlows,
    Edges,
    Spool,
    SpoolState,
    Valve,
    turbulent_drop,
    turbulent_factor,
)
from fmus.contract import Scalar, column
from fmus.monolith import Monolith, simulate
from fmus.parameters import values
from fmus.swing.variables import DetailedSwingParameters, SwingParameters

Array = NDArray[np.float64]
ByName: TypeAlias = dict[str, Scalar]
Equations: TypeAlias = Callable[[ByName, ByName], tuple[ByName, ByName]]

SUPPLY = 20.684e6  # Pa, the machine's
RETURN = 0.5e6  # Pa
TOLERANCE = 1e-10  # relative, of CVODES


def lumped() -> BoomStickParameters:
    """Numbers of the lumped boom and stick drives: valve, hoses, oil."""
    return BoomStickParameters(**values(boom_stick.VARIANTS["lumped"]).p)


def detailed() -> DetailedBoomStickParameters:
    """Numbers of the detailed boom and stick drives."""
    return DetailedBoomStickParameters(**values(boom_stick.VARIANTS["detailed"]).p)


def lumped_swing() -> SwingParameters:
    """Numbers of the lumped swing drive: motor and lines."""
    return SwingParameters(**values(swing.VARIANTS["lumped"]).p)


def detailed_swing() -> DetailedSwingParameters:
    """Numbers of the detailed swing drive."""
    return DetailedSwingParameters(**values(swing.VARIANTS["detailed"]).p)


def start_flow(leakage: Scalar) -> Scalar:
    """Flow [m3/s] out of a shut port that stands at `RETURN`: what leaks from the supply.

    leakage   of an edge [m3/(s.Pa)]; the edge to the tank has the return line on both sides
    """
    return leakage * (SUPPLY - RETURN)


def throttle(drop: Scalar, resistance: float, transition_flow: Scalar) -> Scalar:
    """Flow [m3/s] through a throttle C_R [Pa.s2/m6] from the pressure drop, eq. (1)."""
    y = drop / resistance
    return y * turbulent_factor(y, transition_flow)


def run(
    states: Mapping[str, tuple[Scalar, float]],
    equations: Equations,
    time: Array,
    inputs: Mapping[str, Array],
) -> dict[str, Array]:
    """Outputs of a bench over time, each of shape (n,).

    states      value at the start and nominal value of each
    equations   (states, inputs) -> (rates, outputs), by name
    inputs      samples (n,) of each, straight lines between them
    """
    x, u = {n: ca.SX.sym(n) for n in states}, {n: ca.SX.sym(n) for n in inputs}
    rates, outputs = equations(dict(x), dict(u))
    arguments = [column(*x.values()), column(*u.values()), ca.SX.sym("p", 0)]
    start = np.array([float(value) for value, _ in states.values()])
    model = Monolith(
        states=tuple(states),
        inputs=tuple(inputs),
        parameters=(),
        output_names=tuple(outputs),
        right_hand_side=ca.Function("F", arguments, [column(*(rates[n] for n in states))]),
        outputs=ca.Function("Y", arguments, [column(*outputs.values())]),
        start=ca.Function("X0", arguments, [ca.SX(ca.DM(start))]),
        x=start,
        u=np.array([samples[0] for samples in inputs.values()]),
        p=np.zeros(0),
        nominal=np.array([nominal for _, nominal in states.values()]),
    )
    _, results = simulate(model, time, np.column_stack(list(inputs.values())), tolerance=TOLERANCE)
    return dict(zip(outputs, results.T, strict=True))


Flows: TypeAlias = tuple[Scalar, Scalar]  # out of A and B [m3/s]
Ports: TypeAlias = tuple[EdgeFlows, EdgeFlows]


@dataclass(frozen=True)
class BenchValve:
    """States of the spool, (start, nominal); rates (x, command); ports (x, command, flows, tank)."""

    states: dict[str, tuple[Scalar, float]]
    rates: Callable[[ByName, Scalar], ByName]
    ports: Callable[[ByName, Scalar, Flows, float], Ports]


def bench_valve(machine: str) -> BenchValve:
    """The valve of the lumped or of the detailed machine between bench supply and return line."""
    return _valve_with_spool() if machine == "detailed" else _ideal_valve()


def _ideal_valve() -> BenchValve:
    p = lumped()

    def ports(_: ByName, command: Scalar, flows: Flows, tank: float) -> Ports:
        return spool_valve.ports_from_flow(Valve.of(p, "valve"), command, *flows, SUPPLY, tank, p.density)

    return BenchValve({}, lambda _, __: {}, ports)


def _valve_with_spool() -> BenchValve:
    p = detailed()

    def rates(x: ByName, command: Scalar) -> ByName:
        wanted = spool_valve.commanded_position(command, p.valve_full_command)
        rate = spool_valve.spool_rates(Spool.of(p, "spool"), SpoolState(x["position"], x["speed"]), wanted)
        return {"position": rate.position, "speed": rate.speed}

    def ports(x: ByName, _: Scalar, flows: Flows, tank: float) -> Ports:
        parts = (Edges.of(p, "valve"), Spool.of(p, "spool"))
        return spool_valve.spool_ports(*parts, x["position"], *flows, SUPPLY, tank, p.density)

    return BenchValve({"position": (0.0, 1.0), "speed": (0.0, 10.0)}, rates, ports)


def stick_hose(machine: str, resistance: float, time: Array, command: Array) -> dict[str, Array]:
    """Pressures [Pa] and flows [m3/s] at both ends, for commands [V] to the valve.

    resistance   C_R [Pa.s2/m6] of the throttle
    """
    bench = _detailed_hose if machine == "detailed" else _lumped_hose
    return bench(resistance, time, command)


def _lumped_hose(resistance: float, time: Array, command: Array) -> dict[str, Array]:
    # a valve without a spool to move would make pressures jump within a sample, which no logger can record
    spool, p = bench_valve("detailed"), lumped()

    def equations(x: ByName, u: ByName) -> tuple[ByName, ByName]:
        inlet = spool.ports(x, u["command"], (x["flow"], 0.0), RETURN)[0].pressure
        out = throttle(x["outlet"] - RETURN, resistance, p.valve_transition_flow)
        own = (p.stick_hose_inertance, p.stick_hose_resistance, p.valve_transition_flow)
        rates = {
            "flow": hose.flow_rate(inlet, x["outlet"], x["flow"], *own),
            "outlet": chamber.pressure_rate(x["outlet"], x["flow"] - out, p.stick_hose_capacitance),
            **spool.rates(x, u["command"]),
        }
        outputs = {"pressure_in": inlet, "pressure_out": x["outlet"], "flow_in": x["flow"], "flow_out": out}
        return rates, outputs

    start = {"flow": (0.0, 1e-3), "outlet": (RETURN, 1e7)}
    return run(start | spool.states, equations, time, {"command": command})


def _detailed_hose(resistance: float, time: Array, command: Array) -> dict[str, Array]:
    spool, p = bench_valve("detailed"), detailed()
    of = boom_stick_detailed.line(p, "stick")
    lumps = boom_stick_detailed.default_lumps()["stick"]
    names = hose.state_names("first_flow", "last_flow", "inner", "", lumps, unsteady_friction=False)

    def equations(x: ByName, u: ByName) -> tuple[ByName, ByName]:
        state = names.apply(lambda name: x[name])
        inlet = spool.ports(x, u["command"], (state.flows[0], 0.0), RETURN)[0].pressure
        outlet = RETURN + turbulent_drop(state.flows[-1], resistance, p.valve_transition_flow)
        along = hose.rates(of, state, inlet, outlet)
        rates = dict(zip(names.all(), along.all(), strict=True)) | spool.rates(x, u["command"])
        outputs = {"pressure_in": inlet, "pressure_out": outlet}
        return rates, outputs | {"flow_in": state.flows[0], "flow_out": state.flows[-1]}

    start = dict.fromkeys(names.flows, (start_flow(p.valve_leakage), 1e-3))
    start |= dict.fromkeys(names.pressures, (RETURN, 1e7))
    return run(start | spool.states, equations, time, {"command": command})


MOTOR_THROTTLE = 1e10  # R [Pa.s/m3]: a side fills in 10 ms, the leakage takes 0.3 MPa


def locked_motor(machine: str, time: Array, set_a: Array, set_b: Array) -> dict[str, Array]:
    """Port pressures [Pa], flow into port A and drain flow [m3/s], for set pressures [Pa]."""
    equations = _detailed_motor if machine == "detailed" else _lumped_motor
    states = {"pressure_a": (set_a[0], 1e7), "pressure_b": (set_b[0], 1e7)}
    return run(states, equations, time, {"set_a": set_a, "set_b": set_b})


def _lumped_motor(x: ByName, u: ByName) -> tuple[ByName, ByName]:
    p = lumped_swing()
    lines, leaks = (p.line_resistance,) * 2, (p.internal_leakage_resistance, p.external_leakage_resistance)
    nodes = motor.nodes(x["pressure_a"], x["pressure_b"], 0.0, 0.0, *lines, *leaks)
    rates = {}
    for side, flow in (("a", nodes.flow_1), ("b", nodes.flow_2)):
        pressure = x[f"pressure_{side}"]
        net = (u[f"set_{side}"] - pressure) / MOTOR_THROTTLE - flow
        rates[f"pressure_{side}"] = chamber.pressure_rate(pressure, net, p.line_capacitance)
    at_ports = {"pressure_a": nodes.pressure_1, "pressure_b": nodes.pressure_2}
    return rates, at_ports | {"flow_a": nodes.flow_1, "drain_flow": nodes.drain}


def _detailed_motor(x: ByName, u: ByName) -> tuple[ByName, ByName]:
    p = detailed_swing()
    of = Fluid.of(p)
    leaks = (p.internal_leakage_resistance, p.external_leakage_resistance)
    nodes = motor.nodes_at_port_pressures(x["pressure_a"], x["pressure_b"], 0.0, 0.0, *leaks)
    rates, fed = {}, {}
    for side, flow in (("a", nodes.flow_1), ("b", nodes.flow_2)):
        pressure = x[f"pressure_{side}"]
        fed[side] = (u[f"set_{side}"] - pressure) / MOTOR_THROTTLE
        capacitance = p.motor_volume * chamber.compliance(of, pressure)
        rates[f"pressure_{side}"] = chamber.pressure_rate(pressure, fed[side] - flow, capacitance)
    return rates, dict(x) | {"flow_a": fed["a"], "drain_flow": nodes.drain}


EDGES = {"P-A": 1, "B-T": 1, "P-B": -1, "A-T": -1}  # the sign of the command that opens each
VALVE_THROTTLE = 2.0e11  # C_R [Pa.s2/m6]
LINE = 0.5  # m
BLOCK = 0.5e-3  # m3


def valve(machine: str, edge: str, time: Array, command: Array) -> dict[str, Array]:
    """Pressures before and behind the edge [Pa] and the flow through it [m3/s], for commands [V]."""
    spool, p = bench_valve(machine), lumped()
    feeds, at_a = edge.startswith("P"), "A" in edge
    far = RETURN if feeds else SUPPLY
    share = LINE / detailed().stick_hose_length
    friction = (hose.scaled_resistance(p.stick_hose_resistance, share, 1.0), p.valve_transition_flow)

    def equations(x: ByName, u: ByName) -> tuple[ByName, ByName]:
        flow, block = x["flow"], x["block"]  # out of the port
        at_ports = (flow if at_a else 0.0, 0.0 if at_a else flow)
        ports = spool.ports(x, u["command"], at_ports, RETURN)
        port = ports[0 if at_a else 1].pressure
        through = throttle(block - far, VALVE_THROTTLE, p.valve_transition_flow)
        rates = {
            "flow": hose.flow_rate(port, block, flow, share * p.stick_hose_inertance, *friction),
            "block": chamber.pressure_rate(block, flow - through, BLOCK / p.bulk_modulus),
        }
        measured = (SUPPLY, port, flow) if feeds else (port, RETURN, -flow)
        names = ("pressure_in", "pressure_out", "flow")
        return rates | spool.rates(x, u["command"]), dict(zip(names, measured, strict=True))

    leaks = start_flow(p.valve_leakage) * (1 if feeds else -1)
    states = {"flow": (leaks, 1e-3), "block": (far, 1e7)}
    return run(states | spool.states, equations, time, {"command": command})
