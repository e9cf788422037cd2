"""What physics asks of the equations themselves: dimensions, symmetries, balances of oil and power.

All at random states and parameters of the declared subsystems, without simulating.
"""

import math
from functools import cache

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from kit.equations import EDGES, OIL, VALVE, lines, random_curve
from scipy.optimize import brentq

from fmus.components import cylinder, hose, motor, orifice, spool_valve
from fmus.components.circuit import TANK, Node
from fmus.contract import column, quantities, symbolic
from fmus.machine.parts import FERIC
from fmus.parameters import values
from orchestrator.base.units import BASES, parse_unit

PS = 20.684e6  # Pa
HYDRAULIC = ("swing", "boom_stick")
ZERO_BY_CHOICE = {"line_turbulent_resistance": 1e10, "stick_centre_z": 0.1, "stick_pin_z": 0.05}

seeds = st.integers(0, 2**32 - 1)


class Equations:
    """A subsystem as one function: `at(x, u, p)` gives rates, outputs and start by name."""

    def __init__(self, name):
        self.sub = FERIC.subsystems[name]
        s = symbolic(self.sub)
        self.x, self.u, self.p, self.y = (
            quantities(g) for g in (self.sub.states, self.sub.inputs, self.sub.parameters, self.sub.outputs)
        )
        self.initial = s.initial()
        self.function = ca.Function(name, [s.x, s.u, s.p], [s.dx, s.y, s.start])

    def at(self, x, u, p):
        groups = self.function(*(list(d.values()) for d in (x, u, p)))
        return [
            dict(zip(names, values.full()[:, 0].tolist(), strict=True))
            for names, values in zip((self.x, self.y, self.x), groups, strict=True)
        ]

    def draw(self, rng, pressures=(5e5, 2.5e7)):
        """States and inputs over the working range, parameters within 10 % of the file's, none zero."""
        v = values(self.sub)

        def one(name, quantity, start):
            if "pressure" in name:
                return rng.uniform(*pressures)
            if name.endswith("_position"):
                return rng.uniform(0.05, 0.55)
            if name in ("boom_angle", "stick_angle"):
                return start + rng.uniform(-0.3, 0.3)
            return rng.uniform(-1, 1) * quantity.nominal

        p = {n: (a or ZERO_BY_CHOICE.get(n, 0.0)) * rng.uniform(0.9, 1.1) for n, a in v.p.items()}
        if "valve_pa_command_1" in p:
            for edge in EDGES:
                p |= random_curve(rng, f"valve_{edge}")
        start = self.initial(*(list(group.values()) for group in (v.x, v.u, v.p))).full()[:, 0]
        x = {n: one(n, q, a) for (n, q), a in zip(self.x.items(), start, strict=True)}
        u = {n: one(n, q, v.u[n]) for n, q in self.u.items()}
        return x, u, p


equations = cache(Equations)  # of a usual part


def close(ours, theirs, declared, tolerance=1e-9):
    """Same values by name, relative and to the nominal magnitudes of the variables."""
    assert ours.keys() == theirs.keys()
    for name, expected in theirs.items():
        assert ours[name] == pytest.approx(expected, rel=tolerance, abs=tolerance * declared[name].nominal), (
            name
        )


@pytest.mark.parametrize("name", FERIC.subsystems)
def test_every_formula_keeps_its_dimensions(name, monkeypatch):
    """In other units of mass, length, time and current rates, outputs and start values stay the same.

    A term of wrong dimension, a number that hides one or a wrongly declared unit shows. Numbers with a
    dimension in the components: three of the cavity, above which pressures stay; two that are changed, too;
    and those of Walther's law, whose viscosities stay as they are.
    """
    e, rng = equations(name), np.random.default_rng(11)
    scale = dict.fromkeys(BASES, 1.0) | {"kg": 1.9, "m": 0.7, "s": 1.3, "A": 0.6}
    monkeypatch.setattr(hose, "REFERENCE_FLOW", hose.REFERENCE_FLOW * scale["m"] ** 3 / scale["s"])
    for module in (orifice, spool_valve):
        monkeypatch.setattr(module, "CLOSED", module.CLOSED * scale["m"] ** 2)
    in_others = Equations(name)

    def in_other_units(values, group, per_second=0):
        exponents = {
            n: parse_unit(group[n].unit if "oil_viscosity_" not in n else "1").exponents for n in values
        }
        unit = {
            n: np.prod([scale[b] ** k for b, k in zip(BASES, ex, strict=True)]) for n, ex in exponents.items()
        }
        return {n: a * unit[n] / scale["s"] ** per_second for n, a in values.items()}

    for _ in range(10):
        drawn, groups = e.draw(rng, pressures=(2e6, 2.5e7)), (e.x, e.u, e.p)
        other = [in_other_units(values, group) for values, group in zip(drawn, groups, strict=True)]
        for ours, theirs, group, per_second in zip(
            e.at(*drawn), in_others.at(*other), (e.x, e.y, e.x), (1, 0, 0), strict=True
        ):
            kept = {n: a for n, a in theirs.items() if not n.endswith("void_volume")}
            # exact identity; terms up to 1e3 times larger than their difference are rounded to 1e-16
            close(kept, in_other_units({n: ours[n] for n in kept}, group, per_second), group)


@pytest.mark.parametrize("name", FERIC.subsystems)
@given(seed=seeds)
def test_no_subsystem_creates_power(name, seed):
    """The heat of valves, lines, leakage and friction is not negative in any state, cavitation included."""
    e = equations(name)
    heat = e.at(*e.draw(np.random.default_rng(seed), pressures=(-8e4, 4e7)))[1]["dissipated_power"]
    # rounding of products of 1e-3 m3/s and 1e7 Pa
    assert heat >= -1e-6


@given(st.floats(-2e5, 4e7), st.floats(-2e5, 4e7), st.floats(-2e5, 1e6), st.floats(-2.0, 2.0))
def test_motor_turns_all_power_that_it_does_not_leak(p_a, p_b, tank, speed):
    """Power of both lines = D w (P_1 - P_2) + tank's share + losses of lines and leakage, none negative."""
    d, r, r_in, r_ex = 1.5e-3, 6.2e6, 2e12, 1.1e12
    nodes = {"a": Node(p_a), "b": Node(p_b), TANK: Node(tank)}
    circuit = motor.behind_lines(nodes, ("a", "b"), ("1", "2"), r, d * speed, r_in, r_ex)
    p1, p2, flows = circuit.pressures["1"], circuit.pressures["2"], circuit.flows
    lines, leakage = r * (flows["line_a"] ** 2 + flows["line_b"] ** 2), (p1 - p2) ** 2 / r_in
    heat = lines + leakage + ((p1 - tank) ** 2 + (p2 - tank) ** 2) / r_ex
    given_in = p_a * flows["line_a"] + p_b * flows["line_b"]
    drain = circuit.into(TANK)
    # exact identities; rounding of up to 1e5 W
    assert given_in == pytest.approx(d * speed * (p1 - p2) + tank * drain + heat, rel=1e-9, abs=1e-6)
    assert sum(circuit.heat().values()) == pytest.approx(heat, rel=1e-9, abs=1e-6)
    assert -circuit.into("a") - circuit.into("b") == pytest.approx(drain, rel=1e-6, abs=1e-15)


@given(st.floats(-0.03, 0.64), st.floats(-2.0, 2.0))
def test_end_stops_only_take_power(x, v):
    """Beside their elastic force the stops push against the motion: a cycle of contact never gives energy."""
    stop = (0.61, 1e8, 5.0, 1e-3)
    damping = cylinder.stop_force(x, v, *stop) - cylinder.stop_force(x, 0.0, *stop)
    # rounding of forces up to 1e7 N
    assert float(ca.DM(damping)) * v <= 1e-6


@given(seed=seeds, shift=st.floats(-4e5, 5e6))
@pytest.mark.parametrize("name", HYDRAULIC)
def test_only_pressure_differences_drive_oil(name, seed, shift):
    """All pressures raised together leave every rate, flow and the swing torque as they are."""
    e = equations(name)
    x, u, p = e.draw(np.random.default_rng(seed), pressures=(1e6, 2e7))
    raised = [{n: a + shift * ("pressure" in n) for n, a in group.items()} for group in (x, u)]
    (ours, out, _), (theirs, other, _) = e.at(x, u, p), e.at(*raised, p)
    # 1e7 Pa are rounded to 2e-9 Pa; over the swing's R_line C = 6e-6 s, 3e-4 Pa/s
    close(theirs, ours, e.x, 1e-8)
    kept = [n for n in out if n.endswith(("flow", "flow_a", "flow_b", "torque"))]
    close({n: other[n] for n in kept}, {n: out[n] for n in kept}, e.y, 1e-8)


@given(seed=seeds)
def test_swing_turns_right_as_it_turns_left(seed):
    """Mirrored command, speed, lines and tables of the edges give mirrored rates and the opposite torque."""
    e = equations("swing")
    x, u, p = e.draw(np.random.default_rng(seed), pressures=(-6e4, 2.5e7))
    swapped = {f"{n[:-1]}{'ba'['ab'.index(n[-1])]}": a for n, a in x.items()}
    turned = {
        n: -a if n in ("swing_command", "swing_speed", "swing_acceleration") else a for n, a in u.items()
    }
    ports = {"valve_pa": "valve_pb", "valve_pb": "valve_pa", "valve_at": "valve_bt", "valve_bt": "valve_at"}
    other_p = {n: p[ports.get(n[:8], n[:8]) + n[8:]] for n in p}
    (ours, out, _), (theirs, other, _) = e.at(x, u, p), e.at({n: swapped[n] for n in e.x}, turned, other_p)
    # the same operations, some in another order
    close({f"{n[:-1]}{'ba'['ab'.index(n[-1])]}": a for n, a in theirs.items()}, ours, e.x)
    for n, sign in (("swing_torque", -1), ("supply_flow", 1), ("return_flow", 1), ("dissipated_power", 1)):
        assert sign * other[n] == pytest.approx(out[n], rel=1e-9, abs=1e-9 * e.y[n].nominal), n


def test_nothing_depends_on_where_the_arm_points():
    """Without end stops the swing angle enters only the position of the tip seen from above."""
    s = symbolic(FERIC.subsystems["manipulator"])
    angle = s.x[list(equations("manipulator").x).index("swing_angle")]
    stops = s.p[list(quantities(FERIC.subsystems["manipulator"].parameters)).index("swing_stop_angle")]
    y = ca.vertsplit(ca.substitute(s.y, stops, 0))
    outputs = dict(zip(equations("manipulator").y, y, strict=True))
    touched = [n for n, y in outputs.items() if ca.depends_on(y, angle)]
    assert touched == ["swing_angle", "tip_x", "tip_y"]
    assert not ca.depends_on(ca.substitute(column(s.dx, s.require), stops, 0), angle)


@given(seed=seeds)
def test_boom_and_stick_drives_are_the_same_equations(seed):
    """Exchanged numbers, states and inputs give exchanged rates and forces."""
    e = equations("boom_stick")

    def other(n):
        if n.startswith("boom_stick"):  # of both drives
            return n
        return n.replace("boom", "#").replace("stick", "boom").replace("#", "stick")

    drawn = e.draw(np.random.default_rng(seed))
    ours, out, start = e.at(*drawn)
    theirs, out2, start2 = e.at(*({n: g[other(n)] for n in g} for g in drawn))
    # the same operations; sums of both drives in another order
    for a, b, group in ((ours, theirs, e.x), (out, out2, e.y), (start, start2, e.x)):
        close({n: b[other(n)] for n in b}, a, group)


@given(command=st.floats(0.7, 10.0), more=st.floats(0.0, 5.0), flow=st.floats(1e-5, 5e-3))
def test_opening_a_valve_further_never_costs_more_pressure(command, more, flow):
    """At the same flow the drops over both edges fall, or stay, as the command grows."""
    less, further = (
        spool_valve.ports_from_flow(VALVE, c, (flow, -flow), lines(), OIL) for c in (command, command + more)
    )
    # rounding of 1e7 Pa, and of pressures up to 1e12 Pa that belong to flows which a shut valve cannot pass
    for a, b in ((PS - less[0].pressure, PS - further[0].pressure), (less[1].pressure, further[1].pressure)):
        assert float(ca.DM(b)) <= float(ca.DM(a)) * (1 + 1e-9) + 1e-6


@pytest.mark.parametrize("name", HYDRAULIC)
@pytest.mark.parametrize(("command", "same"), [(12.0, 10.0), (-1e3, -10.0), (0.59, 0.0), (-0.6, 0.0)])
def test_commands_saturate_and_the_dead_band_is_dead(name, command, same):
    """Beyond full command and inside the dead band a command changes nothing, to the last bit.

    Only the load pressure is sensed before the edges open.
    """
    e = equations(name)
    x, u, _ = e.draw(np.random.default_rng(3))
    p = values(e.sub).p
    ours, theirs = (
        e.at(x, {n: c if n.endswith("_command") else a for n, a in u.items()}, p) for c in (command, same)
    )
    for result in (ours, theirs):
        result[1] = {n: y for n, y in result[1].items() if "load_pressure" not in n}
    assert ours == theirs


def test_end_stop_returns_the_speed_of_hunt_and_crossley():
    """A free mass leaves with the share e of its speed v, from the closed form of the contact.

    c v (1 + e) = ln((1 + c v) / (1 - c v e)), by integrating m v dv = -k d (1 + c v) dd in and out.
    """
    speed, damping, mass = 0.2, 5.0, 1e5
    z = ca.SX.sym("z", 2)
    force = cylinder.stop_force(z[0], z[1], 0.61, 1e8, damping, 1e-5)
    ode = {"x": z, "ode": ca.vertcat(z[1], force / mass)}
    solver = ca.integrator("contact", "cvodes", ode, 0, 0.3, {"reltol": 1e-10, "abstol": 1e-12})
    found = float(solver(x0=[0.0, -speed])["xf"][1]) / speed
    cv = damping * speed
    expected = brentq(lambda e: cv * (1 + e) - math.log((1 + cv) / (1 - cv * e)), 0.01, 0.99)
    # rounding of the onset over 0.01 mm of 6 mm, and of 1 + c v by 0.01
    assert found == pytest.approx(expected, rel=2e-3)
