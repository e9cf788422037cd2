"""Motor bench: the swing motor with its shaft locked; pressure reducing valves set both port pressures.

    set pressure --throttle-- side of the motor --leakage-- drain

    C dP_a/dt = (P_set,a - P_a)/R - Q_a        Q_a = (P_a - P_b)/R_in + P_a/R_ex        eqs. (11), (12)

The meter in line A stands between throttle and motor side in the detailed machine, whose motor has a
volume of its own; in the lumped machine, whose volume is that of the line, between the line and the motor.
"""

from __future__ import annotations

from fmus.components import chamber, motor, oil
from fmus.components.detailed_parameters import fluid
from fmus.rig.benches.bench import Array, Named, detailed_swing, lumped_swing, run

THROTTLE = 1e10  # R [Pa.s/m3]: a side fills in 10 ms, the leakage takes 0.3 MPa


def locked_motor(machine: str, time: Array, set_a: Array, set_b: Array) -> dict[str, Array]:
    """Port pressures [Pa], flow into port A and drain flow [m3/s], for set pressures [Pa]."""
    equations = _detailed if machine == "detailed" else _lumped
    states = {"pressure_a": (set_a[0], 1e7), "pressure_b": (set_b[0], 1e7)}
    return run(states, equations, time, {"set_a": set_a, "set_b": set_b})


def _lumped(x: Named, u: Named) -> tuple[Named, Named]:
    p = lumped_swing()
    lines, leaks = (p.line_resistance,) * 2, (p.internal_leakage_resistance, p.external_leakage_resistance)
    nodes = motor.nodes(x["pressure_a"], x["pressure_b"], 0.0, 0.0, *lines, *leaks)
    rates = {}
    for side, flow in (("a", nodes.flow_1), ("b", nodes.flow_2)):
        pressure = x[f"pressure_{side}"]
        net = (u[f"set_{side}"] - pressure) / THROTTLE - flow
        rates[f"pressure_{side}"] = chamber.pressure_rate(pressure, net, p.line_capacitance)
    at_ports = {"pressure_a": nodes.pressure_1, "pressure_b": nodes.pressure_2}
    return rates, at_ports | {"flow_a": nodes.flow_1, "drain_flow": nodes.drain}


def _detailed(x: Named, u: Named) -> tuple[Named, Named]:
    p = detailed_swing()
    of = fluid(p, p.density, p.bulk_modulus)
    leaks = (p.internal_leakage_resistance, p.external_leakage_resistance)
    nodes = motor.at_ports(x["pressure_a"], x["pressure_b"], 0.0, 0.0, *leaks)
    rates, fed = {}, {}
    for side, flow in (("a", nodes.flow_1), ("b", nodes.flow_2)):
        pressure = x[f"pressure_{side}"]
        fed[side] = (u[f"set_{side}"] - pressure) / THROTTLE
        capacitance = p.motor_volume * oil.compliance(of, pressure)
        rates[f"pressure_{side}"] = oil.pressure_rate(pressure, fed[side] - flow, capacitance)
    return rates, dict(x) | {"flow_a": fed["a"], "drain_flow": nodes.drain}
