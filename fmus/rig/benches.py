"""Models of test benches: one component of the machine between a supply and a throttle.

All benches have a supply of constant pressure and a return line whose filter keeps the pressure `RETURN`
[Pa], so that no pressure is close to zero. Throttles obey eq. (1) above some 0.1 L/min. Each bench is a small
ODE, solved in the same way as the machine.

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

lumped     I dQ/dt = P_in - P_out - dp(Q), C dP_out/dt = Q - Q_out, as in `fmus.drives.lumped`
detailed   the line of lumps of `fmus.components.hose`, with elastic wall and air

Motor bench: the swing motor with a locked shaft; pressure reducing valves set both port pressures.

    set pressure --throttle-- side of the motor --leakage-- drain

    C dP_a/dt = (P_set,a - P_a)/R - Q_a        Q_a = (P_a - P_b)/R_in + P_a/R_ex        eqs. (11), (12)

The position of the flow meter of line A depends on the volume that the model contains. In the detailed
machine this is the volume of the motor, and the meter is between throttle and motor. In the lumped machine it
is that of the line, and the meter is between line and motor.

Hold test: a cylinder carries weights, its head side is plugged, its rod side open to the return line.

    d/dt (A x + C P) = -G (P - P_r)        dx/dt = (A P - F)/d
"""

from collections.abc import Callable, Mapping
from types import SimpleNamespace
from typing import Any, TypeAlias

import casadi as ca
import numpy as np

from fmus import boom_stick, swing
from fmus.components import circuit, hose, motor, spool_valve
from fmus.components.circuit import GROUND, TANK, Branch, Circuit, Kind, Node
from fmus.components.orifice import root
from fmus.components.spool_valve import SpoolState
from fmus.contract import Scalar, column, quantities
from fmus.drives.cylinder import CYLINDER, Flows
from fmus.drives.detailed import line_of, lumps_of
from fmus.monolith import Monolith, simulate
from fmus.parameters import parameters
from orchestrator.data.table import Array

ByName: TypeAlias = dict[str, Scalar]
Start: TypeAlias = dict[str, tuple[Scalar, float]]  # initial and nominal value of each state
# (states, inputs) -> circuit, rates of the states that are not in it, outputs
Bench: TypeAlias = Callable[[ByName, ByName], tuple[Circuit, ByName, ByName]]

SUPPLY = 20.684e6  # Pa, as in the machine
RETURN = 0.5e6  # Pa
LINES = SimpleNamespace(supply_pressure=SUPPLY, tank_pressure=RETURN)
TOLERANCE = 1e-10  # relative tolerance of CVODES
LAMINAR = 1e-6  # m3/s, Q_t of a throttle


def drives(machine: str) -> Any:
    """Parameter values of the boom and stick drives of a machine: valve, hoses, oil."""
    return parameters(boom_stick.VARIANTS[machine])


def start_flow(leakage: Scalar) -> Scalar:
    """Initial flow [m3/s] out of a port at the pressure `RETURN`: the leakage from the supply."""
    return leakage * (SUPPLY - RETURN)


def throttle(start: str, end: str, resistance: float) -> Branch:
    """A throttle C_R [Pa.s2/m6], eq. (1), laminar at small flows."""
    return Branch(start, end, Kind.THROTTLE, lambda drop: root(drop / resistance, LAMINAR))


def run(states: Start, bench: Bench, time: Array, inputs: Mapping[str, Array]) -> dict[str, Array]:
    """Simulate a bench; returns its outputs over time, each of shape (n,).

    inputs   samples (n,) of each input, linear between them
    """
    x, u = {n: ca.SX.sym(n) for n in states}, {n: ca.SX.sym(n) for n in inputs}
    circuit, others, outputs = bench(dict(x), dict(u))
    rates = circuit.rates | others
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


SPOOL: Start = {"position": (0.0, 1.0), "speed": (0.0, 10.0)}  # states, which only the detailed valve has


def valve_circuit(
    machine: str, x: ByName, command: Scalar, nodes: tuple[str, str], flows: tuple[Scalar, Scalar]
) -> tuple[Circuit, ByName]:
    """Lines and edges of the valve of a machine, and rates of its spool.

    nodes, flows   of ports A and B; flows [m3/s] out of them
    """
    p, rates = drives(machine), dict[str, Scalar]()
    if machine == "detailed":
        state = SpoolState(x["position"], x["speed"])
        ports = spool_valve.spool_ports(p.valve, p.spool, state.position, flows, LINES, p)
        commanded = spool_valve.commanded_position(command, p.valve.full_command)
        rates = vars(spool_valve.spool_rates(p.spool, state, commanded))
    else:
        ports = spool_valve.ports_from_flow(p.valve, command, flows, LINES, p)
    lines = {circuit.SUPPLY: Node(SUPPLY), TANK: Node(RETURN)}
    ends = {name: Node(port.pressure) for name, port in zip(nodes, ports, strict=True)}
    return Circuit(ends | lines, spool_valve.branches(ports, nodes)), rates


def stick_hose(machine: str, resistance: float, time: Array, command: Array) -> dict[str, Array]:
    """Pressures [Pa] and flows [m3/s] at both ends of the hose, for commands [V] and the throttle's C_R."""
    # also for the lumped machine: the ideal valve would cause steps within a sample, which cannot be recorded
    line, start = (_detailed_hose if machine == "detailed" else _lumped_hose)(resistance)

    def bench(x: ByName, u: ByName) -> tuple[Circuit, ByName, ByName]:
        ports, flows = ("pressure_in", "closed port"), (x["flow_in"], 0.0)
        valve, rates = valve_circuit("detailed", x, u["command"], ports, flows)
        whole = valve | line(x)
        known = whole.pressures | whole.flows
        shown = ("pressure_in", "pressure_out", "flow_in", "flow_out")
        return whole, rates, {name: known[name] for name in shown}

    return run(start | SPOOL, bench, time, {"command": command})


def _lumped_hose(resistance: float) -> tuple[Callable[[ByName], Circuit], Start]:
    p, of = drives("lumped"), drives("lumped").stick.hose

    def line(x: ByName) -> Circuit:
        flow = x["flow_in"]
        ends, drop = ("pressure_in", "pressure_out"), of.friction(p).drop(flow)
        column = hose.column(*ends, flow, "I", of.inertance, drop)
        end = throttle("pressure_out", TANK, resistance)
        block = Node(x["pressure_out"], "C", of.capacitance)
        return Circuit({"pressure_out": block}, {"flow_in": column, "flow_out": end})

    return line, {"flow_in": (0.0, 1e-3), "pressure_out": (RETURN, 1e7)}


def _detailed_hose(resistance: float) -> tuple[Callable[[ByName], Circuit], Start]:
    p = drives("detailed")
    of, lumps = line_of(CYLINDER, p.stick, p), lumps_of(boom_stick.VALUES)(boom_stick.AXES[1])
    ends = dict.fromkeys(("flow_in", "flow_out"), quantities(Flows)["head_flow"])
    states = hose.line_states(ends, "inner", "", "the hose", lumps)

    def line(x: ByName) -> Circuit:
        # without volume, so the flow out of the hose gives the drop of the throttle
        drop = resistance * x["flow_out"] * (ca.fabs(x["flow_out"]) + LAMINAR)
        end = Branch("pressure_out", TANK, Kind.THROTTLE, x["flow_out"])
        return hose.ladder(of, states, SimpleNamespace(**x), "pressure_in", "pressure_out") | Circuit(
            {"pressure_out": Node(RETURN + drop)}, {"throttle": end}
        )

    start = dict.fromkeys(states.flows, (start_flow(p.valve.leakage), 1e-3))
    return line, start | dict.fromkeys(states.pressures, (RETURN, 1e7))


MOTOR_THROTTLE = 1e10  # R [Pa.s/m3]; time constant of a side 10 ms, pressure drop by leakage 0.3 MPa


def locked_motor(machine: str, time: Array, set_a: Array, set_b: Array) -> dict[str, Array]:
    """Port pressures [Pa], flow into port A and drain flow [m3/s], for set pressures [Pa]."""
    p, is_detailed = parameters(swing.VARIANTS[machine]), machine == "detailed"
    own = p.swing
    oil = (0.0, own.motor_volume, p) if is_detailed else (own.line.capacitance,)
    sides, ports = ("line_a", "line_b"), ("port_a", "port_b")

    def bench(x: ByName, u: ByName) -> tuple[Circuit, ByName, ByName]:
        nodes = {"set_a": Node(u["set_a"]), "set_b": Node(u["set_b"]), TANK: Node(0.0)}
        nodes |= {side: Node(x[side], "C", *oil) for side in sides}
        supplied = {
            f"supply_{port}": Branch(
                f"set_{port}", f"line_{port}", Kind.THROTTLE, lambda p: p / MOTOR_THROTTLE
            )
            for port in "ab"
        }
        if is_detailed:
            (a, b), meter = sides, "supply_a"
            inside = Circuit(nodes, motor.branches(sides, 0.0, *own.leakage))
        else:
            (a, b), meter = ports, "line_a"
            inside = motor.behind_lines(nodes, sides, ports, own.line.resistance, 0.0, *own.leakage)
        whole = inside | Circuit({}, supplied)
        outputs = {"pressure_a": whole.pressures[a], "pressure_b": whole.pressures[b]}
        return whole, {}, outputs | {"flow_a": whole.flows[meter], "drain_flow": whole.through(Kind.DRAIN)}

    states = {"line_a": (set_a[0], 1e7), "line_b": (set_b[0], 1e7)}
    return run(states, bench, time, {"set_a": set_a, "set_b": set_b})


EDGES = {"P-A": 1, "B-T": 1, "P-B": -1, "A-T": -1}  # sign of the command that opens the edge
VALVE_THROTTLE = 2.0e11  # C_R [Pa.s2/m6]
LINE = 0.5  # m, length
BLOCK = 0.5e-3  # m3, volume


def valve(machine: str, edge: str, time: Array, command: Array) -> dict[str, Array]:
    """Pressures upstream and downstream of the edge [Pa] and its flow [m3/s], for commands [V]."""
    p, from_supply = drives("lumped"), edge.startswith("P")
    ports = ("port", "closed port") if "A" in edge else ("closed port", "port")
    other_end, start = (TANK, RETURN) if from_supply else (circuit.SUPPLY, SUPPLY)
    fraction = LINE / drives("detailed").stick.hose.length
    friction = p.stick.hose.friction(p)

    def bench(x: ByName, u: ByName) -> tuple[Circuit, ByName, ByName]:
        flow = x["flow"]  # out of the port
        flows = (flow, 0.0) if "A" in edge else (0.0, flow)
        of_valve, rates = valve_circuit(machine, x, u["command"], ports, flows)
        inertance, drop = fraction * p.stick.hose.inertance, fraction * friction.drop(flow)
        line = hose.column("port", "block", flow, "I", inertance, drop)
        block = {"block": Node(x["block"], "C", BLOCK / p.bulk_modulus)}
        of_bench = {"flow": line, "throttle": throttle("block", other_end, VALVE_THROTTLE)}
        whole = of_valve | Circuit(block, of_bench)
        at_port = whole.pressures["port"]
        measured = (SUPPLY, at_port, flow) if from_supply else (at_port, RETURN, -flow)
        names = ("pressure_in", "pressure_out", "flow")
        return whole, rates, dict(zip(names, measured, strict=True))

    leakage = start_flow(p.valve.leakage) * (1 if from_supply else -1)
    states = {"flow": (leakage, 1e-3), "block": (start, 1e7)}
    return run(states | (SPOOL if machine == "detailed" else {}), bench, time, {"command": command})


BORE, ENCLOSED = 0.1, 4e-3  # m, of the cylinder; m3, oil that its head side encloses
SINKING = 0.05  # s, time constant of the piston behind its friction


def hold_test(time: Array, pressure: Array, seal: float, square: float = 0.0) -> dict[str, Array]:
    """Position [m] and pressures [Pa] of a cylinder under weights that need these pressures [Pa].

    seal, square   leakage past the seals over the pressure [m3/(s.Pa)], and over its square
    """
    area, capacitance = np.pi / 4 * BORE**2, ENCLOSED / drives("lumped").bulk_modulus

    def bench(x: ByName, u: ByName) -> tuple[Circuit, ByName, ByName]:
        velocity = (x["head"] - u["pressure"]) * capacitance / (SINKING * area)
        nodes = {"head": Node(x["head"], "C", capacitance), TANK: Node(RETURN), GROUND: Node(0.0)}
        seals = Branch("head", TANK, Kind.LEAKAGE, lambda p: (seal + square * ca.fabs(p)) * p)
        piston = Branch("head", GROUND, Kind.PISTON, area * velocity)
        outputs = {"position": x["position"], "pressure_head": x["head"], "pressure_rod": ca.SX(RETURN)}
        return Circuit(nodes, {"seals": seals, "piston": piston}), {"position": velocity}, outputs

    states = {"head": (pressure[0], 1e7), "position": (0.9, 1.0)}
    return run(states, bench, time, {"pressure": pressure})
