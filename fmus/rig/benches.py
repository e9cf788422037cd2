"""Models of test benches: one component of the machine between a supply and a throttle.

All benches have a supply of constant pressure and a return line whose filter keeps the pressure `RETURN`
[Pa], so that no pressure is close to zero. Throttles obey eq. (1). Each bench is a small ODE, solved in the
same way as the machine.

Valve bench: one metering edge at a time; the other port is closed.

    supply --P-A-- port --line-- block --throttle-- return line        the edges from the supply
    supply --throttle-- block --line-- port --B-T-- return line        the edges to the tank

The spool is that of the machine: the position of the lumped one is the commanded position, the detailed one
has dynamics. The oil block of 0.5 L and the line, 0.5 m of the hose of the stick, belong to the bench. At 10
V the throttle passes 271 L/min, which is inside the range of the meter, and the pressure drop at the edge is
16 MPa. At smaller openings this drop is nearly 20 MPa, so it is measured accurately everywhere.

Hose bench: a valve supplies the hose of the stick, 4 m of 3/4 in, which ends in a throttle to the return
line. Only the hose is between the two pairs of instruments.

    supply --valve-- (P_in, Q_in) ==hose== (P_out, Q_out) --throttle-- return line

lumped     I dQ/dt = P_in - P_out - C_R Q|Q|, C dP_out/dt = Q - Q_out, as in `fmus.boom_stick.drive`
detailed   the line of lumps of `fmus.components.hose`, with elastic wall, air and both kinds of friction

Motor bench: the swing motor with a locked shaft; pressure reducing valves set both port pressures.

    set pressure --throttle-- side of the motor --leakage-- drain

    C dP_a/dt = (P_set,a - P_a)/R - Q_a        Q_a = (P_a - P_b)/R_in + P_a/R_ex        eqs. (11), (12)

The position of the flow meter of line A depends on the volume that the model contains. In the detailed
machine this is the volume of the motor, and the meter is between throttle and motor. In the lumped machine it
is that of the line, and the meter is between line and motor.
"""

from collections.abc import Callable, Mapping
from typing import TypeAlias

import casadi as ca
import numpy as np

from fmus import boom_stick, swing
from fmus.boom_stick import detailed as boom_stick_detailed
from fmus.boom_stick.variables import BoomStickParameters, DetailedBoomStickParameters
from fmus.components import chamber, hose, motor, spool_valve
from fmus.components.chamber import Fluid
from fmus.contract import Scalar, column
from fmus.monolith import Monolith, simulate
from fmus.parameters import values
from fmus.swing.variables import DetailedSwingParameters
from orchestrator.data.table import Array

ByName: TypeAlias = dict[str, Scalar]
Equations: TypeAlias = Callable[[ByName, ByName], tuple[ByName, ByName]]

SUPPLY = 20.684e6  # Pa, as in the machine
RETURN = 0.5e6  # Pa
TOLERANCE = 1e-10  # relative tolerance of CVODES


def lumped() -> BoomStickParameters:
    """Parameter values of the lumped boom and stick drives: valve, hoses, oil."""
    return BoomStickParameters(**values(boom_stick.VARIANTS["lumped"]).p)


def detailed() -> DetailedBoomStickParameters:
    """Parameter values of the detailed boom and stick drives."""
    return DetailedBoomStickParameters(**values(boom_stick.VARIANTS["detailed"]).p)


def start_flow(leakage: Scalar) -> Scalar:
    """Initial flow [m3/s] out of a port at the pressure `RETURN`: the leakage from the supply.

    leakage   leakage of an edge [m3/(s.Pa)]; the edge to the tank has no pressure drop
    """
    return leakage * (SUPPLY - RETURN)


def throttle(drop: Scalar, resistance: float, transition_flow: Scalar) -> Scalar:
    """Flow [m3/s] through a throttle C_R [Pa.s2/m6] from the pressure drop, eq. (1)."""
    y = drop / resistance
    return y * spool_valve.turbulent_factor(y, transition_flow)


def run(
    states: Mapping[str, tuple[Scalar, float]], equations: Equations, time: Array, inputs: Mapping[str, Array]
) -> dict[str, Array]:
    """Simulate a bench; returns its outputs over time, each of shape (n,).

    states      initial and nominal value of each state
    equations   (states, inputs) -> (time derivatives, outputs), by name
    inputs      samples (n,) of each input, linear between them
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


Ports: TypeAlias = tuple[spool_valve.EdgeFlows, spool_valve.EdgeFlows]


class BenchValve:
    """The valve of the lumped or of the detailed machine between supply and return line of the bench.

    states   initial and nominal value of each state of the spool, which only the detailed one has
    """

    def __init__(self, machine: str) -> None:
        self._spool = machine == "detailed"
        self.states = {"position": (0.0, 1.0), "speed": (0.0, 10.0)} if self._spool else {}

    def rates(self, x: ByName, command: Scalar) -> ByName:
        """Time derivatives of the states."""
        if not self._spool:
            return {}
        p = detailed()
        commanded = spool_valve.commanded_position(command, p.valve_full_command)
        state = spool_valve.SpoolState(x["position"], x["speed"])
        rate = spool_valve.spool_rates(spool_valve.Spool.of(p, "spool"), state, commanded)
        return {"position": rate.position, "speed": rate.speed}

    def ports(self, x: ByName, command: Scalar, flow_a: Scalar, flow_b: Scalar) -> Ports:
        """Both ports, for the flows out of them [m3/s]."""
        if not self._spool:
            p = lumped()
            given = (spool_valve.Valve.of(p, "valve"), command, flow_a, flow_b, SUPPLY, RETURN, p.density)
            return spool_valve.ports_from_flow(*given)
        of = detailed()
        parts = (spool_valve.Edges.of(of, "valve"), spool_valve.Spool.of(of, "spool"))
        return spool_valve.spool_ports(*parts, x["position"], flow_a, flow_b, SUPPLY, RETURN, of.density)


def stick_hose(machine: str, resistance: float, time: Array, command: Array) -> dict[str, Array]:
    """Pressures [Pa] and flows [m3/s] at both ends of the hose, for commands [V] and the throttle's C_R."""
    return (_detailed_hose if machine == "detailed" else _lumped_hose)(resistance, time, command)


def _lumped_hose(resistance: float, time: Array, command: Array) -> dict[str, Array]:
    # the ideal valve would cause pressure steps within a sample, which cannot be recorded
    spool, p = BenchValve("detailed"), lumped()

    def equations(x: ByName, u: ByName) -> tuple[ByName, ByName]:
        inlet = spool.ports(x, u["command"], x["flow"], 0.0)[0].pressure
        out = throttle(x["outlet"] - RETURN, resistance, p.valve_transition_flow)
        hose_values = (p.stick_hose_inertance, p.stick_hose_resistance, p.valve_transition_flow)
        rates = {
            "flow": hose.flow_rate(inlet, x["outlet"], x["flow"], *hose_values),
            "outlet": chamber.pressure_rate(x["outlet"], x["flow"] - out, p.stick_hose_capacitance),
        }
        outputs = {"pressure_in": inlet, "pressure_out": x["outlet"], "flow_in": x["flow"], "flow_out": out}
        return rates | spool.rates(x, u["command"]), outputs

    start = {"flow": (0.0, 1e-3), "outlet": (RETURN, 1e7)}
    return run(start | spool.states, equations, time, {"command": command})


def _detailed_hose(resistance: float, time: Array, command: Array) -> dict[str, Array]:
    spool, p = BenchValve("detailed"), detailed()
    of = boom_stick_detailed.line(p, "stick")
    lumps = boom_stick_detailed.default_lumps()["stick"]
    names = hose.state_names("first_flow", "last_flow", "inner", "", lumps, unsteady_friction=False)

    def equations(x: ByName, u: ByName) -> tuple[ByName, ByName]:
        state = names.apply(lambda name: x[name])
        inlet = spool.ports(x, u["command"], state.flows[0], 0.0)[0].pressure
        outlet = RETURN + spool_valve.turbulent_drop(state.flows[-1], resistance, p.valve_transition_flow)
        along = hose.rates(of, state, inlet, outlet)
        rates = dict(zip(names.all(), along.all(), strict=True)) | spool.rates(x, u["command"])
        outputs = {"pressure_in": inlet, "pressure_out": outlet}
        return rates, outputs | {"flow_in": state.flows[0], "flow_out": state.flows[-1]}

    start = dict.fromkeys(names.flows, (start_flow(p.valve_leakage), 1e-3))
    start |= dict.fromkeys(names.pressures, (RETURN, 1e7))
    return run(start | spool.states, equations, time, {"command": command})


MOTOR_THROTTLE = 1e10  # R [Pa.s/m3]; time constant of a side 10 ms, pressure drop by leakage 0.3 MPa


def locked_motor(machine: str, time: Array, set_a: Array, set_b: Array) -> dict[str, Array]:
    """Port pressures [Pa], flow into port A and drain flow [m3/s], for set pressures [Pa]."""
    p, is_detailed = values(swing.VARIANTS[machine]).p, machine == "detailed"
    leaks = (p["internal_leakage_resistance"], p["external_leakage_resistance"])
    fluid = Fluid.of(DetailedSwingParameters(**p)) if is_detailed else None

    def equations(x: ByName, u: ByName) -> tuple[ByName, ByName]:
        ends, still = (x["pressure_a"], x["pressure_b"]), (0.0, 0.0)
        if fluid is not None:
            nodes = motor.nodes_at_port_pressures(*ends, *still, *leaks)
            ports, capacities = ends, [p["motor_volume"] * chamber.compliance(fluid, end) for end in ends]
        else:
            nodes = motor.nodes(*ends, *still, *(p["line_resistance"],) * 2, *leaks)
            ports, capacities = (nodes.pressure_1, nodes.pressure_2), [p["line_capacitance"]] * 2
        supplied = [(u[f"set_{side}"] - end) / MOTOR_THROTTLE for side, end in zip("ab", ends, strict=True)]
        rates = {
            f"pressure_{side}": chamber.pressure_rate(end, supply - flow, capacity)
            for side, end, supply, flow, capacity in zip(
                "ab", ends, supplied, (nodes.flow_1, nodes.flow_2), capacities, strict=True
            )
        }
        flow_a = supplied[0] if is_detailed else nodes.flow_1
        at_ports = {"pressure_a": ports[0], "pressure_b": ports[1]}
        return rates, at_ports | {"flow_a": flow_a, "drain_flow": nodes.drain}

    states = {"pressure_a": (set_a[0], 1e7), "pressure_b": (set_b[0], 1e7)}
    return run(states, equations, time, {"set_a": set_a, "set_b": set_b})


EDGES = {"P-A": 1, "B-T": 1, "P-B": -1, "A-T": -1}  # sign of the command that opens the edge
VALVE_THROTTLE = 2.0e11  # C_R [Pa.s2/m6]
LINE = 0.5  # m, length
BLOCK = 0.5e-3  # m3, volume


def valve(machine: str, edge: str, time: Array, command: Array) -> dict[str, Array]:
    """Pressures upstream and downstream of the edge [Pa] and its flow [m3/s], for commands [V]."""
    spool, p = BenchValve(machine), lumped()
    from_supply, at_a = edge.startswith("P"), "A" in edge
    throttle_end = RETURN if from_supply else SUPPLY
    fraction = LINE / detailed().stick_hose_length
    friction = (hose.scaled_resistance(p.stick_hose_resistance, fraction, 1.0), p.valve_transition_flow)

    def equations(x: ByName, u: ByName) -> tuple[ByName, ByName]:
        flow, block = x["flow"], x["block"]  # out of the port
        ports = spool.ports(x, u["command"], *((flow, 0.0) if at_a else (0.0, flow)))
        port = ports[0 if at_a else 1].pressure
        throttle_flow = throttle(block - throttle_end, VALVE_THROTTLE, p.valve_transition_flow)
        rates = {
            "flow": hose.flow_rate(port, block, flow, fraction * p.stick_hose_inertance, *friction),
            "block": chamber.pressure_rate(block, flow - throttle_flow, BLOCK / p.bulk_modulus),
        }
        measured = (SUPPLY, port, flow) if from_supply else (port, RETURN, -flow)
        names = ("pressure_in", "pressure_out", "flow")
        return rates | spool.rates(x, u["command"]), dict(zip(names, measured, strict=True))

    leakage = start_flow(p.valve_leakage) * (1 if from_supply else -1)
    states = {"flow": (leakage, 1e-3), "block": (throttle_end, 1e7)}
    return run(states | spool.states, equations, time, {"command": command})
