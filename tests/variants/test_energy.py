"""Every variant of every part, in a machine at work with a stem: power in is out, stored, or heat."""

from itertools import pairwise

import casadi as ca
import numpy as np
import pytest
from kit import shards
from kit.every import MACHINES

from fmus.contract import quantities
from fmus.machine.machine import wiring
from fmus.machine.parts import DRIVES, FAMILIES, FERIC
from fmus.monolith import breakpoints, join
from fmus.operator_input.work_cycle import COMMANDS, PROGRAMS, WORK_CYCLE_STOP, Move, Stem, payload, sample

# boom, swing and stick move and are braked, a stem is taken up and dropped in full motion; the kinks of all
# levers coincide, because the integrator begins anew at each
SHORT = (
    *(Move("boom", 0.0, 5.0, 0.2, 0.6, 0.2), Move("swing", 0.0, 6.0, 0.2, 0.6, 0.2)),
    *(Move("stick", 0.0, -5.0, 0.2, 0.6, 0.2), Stem(0.3, 300.0, 0.4)),
)
PROGRAM = {"short": (SHORT, 1.2), "work cycle": (PROGRAMS["work_cycle_stems"], WORK_CYCLE_STOP)}
TOLERANCE = 1e-9  # of CVODES, quadratures included
BAR = 1e-6  # of the energy that went through


def test_machines_hold_every_variant():
    """The machines of the suite leave no variant out."""
    met = {(part, m.get(part, next(iter(variants)))) for m in MACHINES for part, variants in FAMILIES.items()}
    assert met == {(part, v) for part, variants in FAMILIES.items() for v in variants}


LINES = ("supply_pressure", "supply_flow", 1), ("tank_pressure", "return_flow", -1)
CYLINDERS = [(f"{a}_force", f"{a}_velocity", 1) for a in ("boom", "stick")]
SWING = "swing_torque", "swing_speed", 1
# effort, flow and sign of the power into a part over its ports
PORTS = {
    "supply": [(effort, f"{flow}_{d}", -sign) for effort, flow, sign in LINES for d in DRIVES],
    "manipulator": [SWING, *CYLINDERS],
    "swing": [*LINES, (*SWING[:2], -1)],
    "boom_stick": [*LINES, *((effort, flow, -1) for effort, flow, _ in CYLINDERS)],
}
# what flows in otherwise
DIRECT = {"supply": "engine_power", "manipulator": "payload_power", "boom_stick": "convected_power"}


def powers(part, signal):
    """What flows into a part [W], an expression for each; `signal` gives any variable."""
    into = [sign * signal(f"{part}.{a}") * signal(f"{part}.{b}") for a, b, sign in PORTS[part]]
    return into + ([signal(f"{part}.{DIRECT[part]}")] if part in DIRECT else [])


def stored(part, signal):
    """Energy of a part [J]."""
    kinds = ("stored_energy", "kinetic_energy", "potential_energy", "stop_energy")
    return sum(e for kind in kinds if (e := signal(f"{part}.{kind}")) is not None)


def audit(index, program, changed=()):
    """Part -> energy in, its gross turnover, heat and change of the stored energy [J] over the run.

    Energy in contains what oil that becomes warmer stores more, at constant pressures and flows.

    changed   (parameter, value), other than in parameters.toml
    """
    chosen = FERIC.chosen(**MACHINES[index])
    connections, inputs = wiring(chosen)
    model = join(chosen, connections, inputs)
    for name, value in changed:
        model.p[model.parameters.index(name)] = value
    x, u, p = (ca.SX.sym(n, k) for n, k in (("x", len(model.x)), ("u", len(model.u)), ("p", len(model.p))))
    shown = dict(zip(model.output_names, ca.vertsplit(model.outputs(x, u, p)), strict=True))
    constant = {f"{n}.{v}": 0.0 for n, s in chosen.items() for v in quantities(s.inputs)}
    fed = {end: u[model.inputs.index(n)] for n, ends in inputs.items() for end in ends}
    fed |= {target: shown[source] for source, target in connections}

    def signal(name):
        return shown.get(name, fed.get(name, constant.get(name)))

    audited = [name for name in chosen if (name, chosen[name].variant) != ("supply", "ideal")]
    rates = []
    for part in audited:
        into = powers(part, signal)
        heat = signal(f"{part}.dissipated_power")
        warming = _warming(model, x, u, p, stored(part, signal)) if part in DRIVES else 0
        rates += [sum(into) + warming, sum(ca.fabs(w) for w in into), heat]
    energies = ca.Function("e", [x, u, p], [ca.vertcat(*(stored(part, signal) for part in audited))])
    x_end, quad, x_start, u_end = _integrate(model, x, u, p, ca.vertcat(*rates), *PROGRAM[program])
    change = (energies(x_end, u_end, model.p) - energies(*x_start, model.p)).full()[:, 0]
    return {part: (*quad[3 * i : 3 * i + 3], change[i]) for i, part in enumerate(audited)}


def _warming(model, x, u, p, energy):
    """Part of the rate [W] of a drive's energy that is due to the temperature of its oil."""
    if "supply.oil_temperature" not in model.states:
        return 0
    at = model.states.index("supply.oil_temperature")
    return ca.jacobian(energy, x[at]) * model.right_hand_side(x, u, p)[at]


def _integrate(model, x, u, p, rates, moves, stop):
    """Final state, integrals of `rates`, start, final inputs: CVODES between the corners of the program."""
    time, commands = sample(moves, stop)
    inputs = np.tile(model.u, (time.size, 1))
    inputs[:, [model.inputs.index(n) for n in COMMANDS]] = commands
    inputs[:, model.inputs.index("payload_mass")] = payload(moves, time)
    scale = ca.DM(model.nominal)
    t, z = ca.SX.sym("t"), ca.SX.sym("z", len(model.x))
    at, slope = ca.SX.sym("at", len(model.u)), ca.SX.sym("slope", len(model.u))
    f = ca.Function("f", [x, u, p], [model.right_hand_side(x, u, p), rates])
    dx, q = f(z * scale, at + slope * t, ca.DM(model.p))
    ode = {"t": t, "x": z, "p": ca.vertcat(at, slope), "ode": dx / scale, "quad": q / 1e3}
    options = {"reltol": TOLERANCE, "abstol": TOLERANCE, "quad_err_con": True, "max_num_steps": 10**6}
    state = model.start(model.x, inputs[0], model.p).full()[:, 0]
    start, total = (state, inputs[0]), np.zeros(q.numel())
    for first, last in pairwise(breakpoints(time, inputs)):
        length = time[last] - time[first]
        solver = ca.integrator("leg", "cvodes", ode, 0.0, length, options)
        slopes = (inputs[last] - inputs[first]) / length
        found = solver(x0=state / model.nominal, p=np.concatenate([inputs[first], slopes]))
        state = found["xf"].full()[:, 0] * model.nominal
        total += found["qf"].full()[:, 0] * 1e3
    return state, total, start, inputs[-1]


@shards.machine
def test_energy_balance_closes_in_the_end_stops():
    """The column and the boom are driven into their stops: the balance of the manipulator closes as well."""
    stops = [("manipulator.swing_stop_angle", 0.03), ("manipulator.boom_stroke", 0.33)]
    taken, turnover, heat, change = audit(0, "short", stops)["manipulator"]
    usual = audit(0, "short")["manipulator"]
    assert turnover < 0.5 * usual[1]  # the stops were hit
    assert abs(taken - heat - change) < BAR * turnover


@pytest.mark.parametrize("program", ["short", pytest.param("work cycle", marks=shards.machine)])
@pytest.mark.parametrize("index", range(len(MACHINES)))
def test_energy_balance_closes_at_work(index, program):
    """Of each part: energy in less heat and change of what is stored is below 1e-6 of what went through."""
    for part, (taken, turnover, heat, change) in audit(index, program).items():
        assert turnover > 1e3, part  # J: the part did work
        assert heat > 0, part
        assert abs(taken - heat - change) < BAR * turnover, part  # the bar; CVODES leaves some 1e-8
