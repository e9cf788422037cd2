"""The whole machine written once more from docs/equations.md: an independent check of the project.

Nothing of `fmus` or `orchestrator` is used, only numbers in fmus/*/parameters.toml. The arm
follows from d'Alembert's principle (partial velocities and accelerations of particles) and the cylinder
triangles from the law of cosines, where the project differentiates energies. Names, order and signs of
states, inputs and observables are the project's; section numbers are those of the document.
"""

import tomllib
from collections.abc import Mapping, Sequence
from math import atan2, cos, exp, hypot, log10, pi, sin, sqrt
from pathlib import Path
from types import SimpleNamespace as Group  # the parameters of one part by name

import numpy as np
from scipy.interpolate import PchipInterpolator

Floats = Sequence[float]
Port = tuple[float, float, float]  # pressure [Pa] of a port node, flows [m3/s] of its supply and tank edge

STATES = (
    *(f"swing.swing_{name}" for name in ("pressure_a", "pressure_b", "flow_a", "flow_b")),
    *(f"boom_stick.boom_{name}" for name in ("head_pressure", "rod_pressure", "head_flow", "rod_flow")),
    *(f"boom_stick.stick_{name}" for name in ("head_pressure", "rod_pressure", "head_flow", "rod_flow")),
    *(f"manipulator.{joint}_angle" for joint in ("swing", "boom", "stick")),
    *(f"manipulator.{joint}_speed" for joint in ("swing", "boom", "stick")),
    *("manipulator.held_mass", "manipulator.payload_flow"),
)
NOMINAL = np.array(3 * [1e7, 1e7, 1e-3, 1e-3] + 6 * [1.0] + [100.0, 1000.0])


def numbers(section: str = "parameters") -> dict[str, float]:
    """All `parameters` or all `start` values of the machine, by `component.name`.

    Among the parameters are those of the project's other variants, which nothing here uses.
    """
    found, root = {}, Path(__file__).parents[2]
    for component in ("swing", "boom_stick", "manipulator"):
        path = root / "fmus" / component / "parameters.toml"
        table = tomllib.loads(path.read_text(encoding="utf-8"))[section]
        for name, entry in table.items():
            value, full = entry["value"], f"{component}.{name}"
            points = [*value, *[0.0] * (10 - len(value))] if isinstance(value, list) else []
            found |= {f"{full[:-1]}_{i}": x for i, x in enumerate(points, 1)} or {full: float(value)}
    return found


def group(table: Mapping[str, float], component: str, prefix: str = "") -> Group:
    """The parameters of a component; `prefix` (the name of a cylinder) is cut off."""
    names = [name.partition(".")[::2] for name in table]
    return Group(**{n.removeprefix(prefix): table[f"{c}.{n}"] for c, n in names if c == component})


def sized(p: Group, of: str, length: float, bore: float, volume: float, resistance: float) -> Group:
    """A hose or line whose numbers of 0 follow from its size, section 2: rho l/A, volume/beta, and R."""
    area = pi / 4 * bore**2
    derived = {"inertance": p.density * length / area, "resistance": resistance}
    derived["capacitance"] = (area * length + volume) / p.bulk_modulus
    for name, value in derived.items():
        setattr(p, f"{of}_{name}", getattr(p, f"{of}_{name}") or value)
    return p


def hose(p: Group) -> Group:
    """The hose of a cylinder; eq. (10) from 4 m of 3/4 in with 8 mPa.s."""
    ratio = p.hose_length / 4.0 * (0.01905 / p.hose_bore) ** 4.75 * (p.viscosity / 8e-3) ** 0.25
    return sized(p, "hose", p.hose_length, p.hose_bore, 0.0, p.hose_reference_resistance * ratio)


def line(p: Group) -> Group:
    """The lines of the swing motor; laminar flow in a round pipe."""
    resistance = 128 * p.viscosity * p.line_length / (pi * p.line_bore**4)
    return sized(p, "line", p.line_length, p.line_bore, p.motor_volume, resistance)


def oil(temperature: float, thick: float = 46e-6, thin: float = 6.8e-6) -> tuple[float, float]:
    """m and r of section 4.10: a straight line through two points of lg lg (nu + 0.7) over lg T."""

    temperature = min(max(temperature, 223.15), 423.15)

    def product(kelvin: float, *points: float) -> float:
        low, high = log10(313.15), log10(373.15)
        share = (log10(kelvin) - low) / (high - low)
        y = [log10(log10(1e6 * nu + 0.7)) for nu in points]
        return (10**10 ** (y[0] * (1 - share) + y[1] * share) - 0.7) / (1 + 7e-4 * (kelvin - 333.15))

    r = 1 / (1 + 7e-4 * (temperature - 333.15))
    return product(temperature, thick, thin) / product(333.15, 46e-6, 6.8e-6), r


def warmed(p: Group, temperature: float) -> Group:
    """Its numbers at the temperature of the oil, the table of section 4.10."""
    m, r = oil(temperature, p.oil_viscosity_40, p.oil_viscosity_100)
    b = exp(-5e-3 * (min(max(temperature, 223.15), 423.15) - 333.15))
    mixed = r**0.75 * m**0.25
    factors = {"density": r, "viscosity": m, "valve_leakage": 1 / m, "bulk_modulus": b}
    factors |= {"line_inertance": r, "line_resistance": m, "line_turbulent_resistance": mixed}
    factors |= {"hose_inertance": r, "hose_resistance": mixed, "counterbalance_leakage": 1 / m}
    factors |= {f"{a}_hose_{n}": f for a in ("boom", "stick") for n, f in (("resistance", mixed),)}
    factors |= {"internal_leakage_resistance": m, "external_leakage_resistance": m}
    warm = Group(**{name: value * factors.get(name, 1.0) for name, value in vars(p).items()})
    for name in ("hose", "boom_hose", "stick_hose", "line"):
        if hasattr(p, f"{name}_capacitance"):
            volume = pi / 4 * getattr(p, f"{name}_bore") ** 2 * getattr(p, f"{name}_length")
            volume += p.motor_volume if name == "line" else 0.0
            softer = volume * (1 - b) / (p.bulk_modulus * b)
            setattr(warm, f"{name}_capacitance", getattr(p, f"{name}_capacitance") + softer)
    return warm


def friction(p: Group, of: str, flow: float) -> tuple[float, float]:
    """b and a of section 3 for a hose, of dp = b Q + a Q |Q|; R and C_R of the line of a motor."""
    length, bore = getattr(p, f"{of}_length"), getattr(p, f"{of}_bore")
    laminar = 128 * p.viscosity * length / (pi * bore**4)
    if of == "line":
        return laminar, p.line_turbulent_resistance
    critical = 2300 * pi / 4 * p.viscosity / p.density * bore
    z = (flow / critical) ** 8
    blasius = (170 / 60e3 / critical) ** 0.25 / (abs(flow / critical) + 1e-12) ** 0.25
    return laminar / (1 + z), getattr(p, f"{of}_resistance") * blasius * z / (1 + z)


def drop(p: Group, of: str, flow: float) -> float:
    """H of section 3."""
    b, a = friction(p, of, flow)
    return flow * (b + a * abs(flow))


class Machine:
    """The parameters in groups, and the arm as particles."""

    def __init__(self, table: Mapping[str, float], temperature: float = 333.15) -> None:
        self.swing = warmed(line(group(table, "swing")), temperature)
        cylinders = (hose(group(table, "boom_stick", a)) for a in ("boom_", "stick_"))
        self.hydraulic = [warmed(p, temperature) for p in cylinders]
        self.linkage = [group(table, "manipulator", prefix) for prefix in ("boom_", "stick_")]
        a = self.arm = group(table, "manipulator")
        radius, g, elbow = a.boom_pivot_x, a.gravity, (a.stick_pivot_x, a.stick_pivot_z)
        # Particles at (offset, .) + R(q2) c + R(f) d, as (mass, weight, offset, *c, *d). A slender link is
        # its centre and, for its inertia, a weightless particle of mass I at unit distance on its axis.
        self.particles = (
            (a.boom_mass, a.boom_mass * g, radius, a.boom_centre_x, a.boom_centre_z, 0.0, 0.0),
            (a.boom_inertia, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0),
            (a.stick_mass, a.stick_mass * g, radius, *elbow, a.stick_centre_x, a.stick_centre_z),
            (a.stick_inertia, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0),
            (a.head_mass, a.head_mass * g, radius, *elbow, a.stick_length, 0.0),
        )


def ramp(z: float, width: float) -> float:
    """max(z, 0) with a rounded foot of `width`, Symbols."""
    s = min(max(z / width, 0.0), 1.0)
    return width * (s**3 - s**4 / 2) + max(z - width, 0.0)


def opening(p: Group, edge: str, volts: float) -> float:
    """Opening [1] of an edge that a positive command opens, section 2; by SciPy if there is a table."""
    if getattr(p, f"valve_{edge}_command_2") > 0:
        numbered = [
            [getattr(p, f"valve_{edge}_{n}_{i}") for n in ("command", "opening")] for i in range(1, 11)
        ]
        v, a = zip(*(point for i, point in enumerate(numbered) if i == 0 or point[0] > 0), strict=True)
        # the flat start of the curve is that of a closed interval before it
        inside = PchipInterpolator([v[0] - 1.0, *v], [0.0, *a])
        return float(inside(min(volts, v[-1]))) if volts > v[0] else 0.0
    band, width, full = p.valve_dead_band, p.valve_command_rounding, p.valve_full_command
    return ramp(min(volts, full) - band, width) / ramp(full - band, width)


def laminar(p: Group, area: float) -> float:
    """Q_t [m3/s] of an opening [m2], section 2."""
    return p.valve_transition_reynolds * p.viscosity / p.density * sqrt(pi * (area + 1e-9)) / 2


def port(p: Group, supply: float, tank: float, flow: float, ps: float, pt: float) -> Port:
    """A port node whose edges are open by `supply` and `tank` [1], section 2."""
    k2 = (p.valve_discharge_coefficient * p.valve_area) ** 2 * 2 / p.density
    edge = p.valve_leakage * (ps - pt) + (flow if supply else -flow)
    k2 /= abs(edge) + laminar(p, p.valve_area * (supply + tank))
    g_s, g_t = p.valve_leakage + k2 * supply**2, p.valve_leakage + k2 * tank**2
    node = (g_s * ps + g_t * pt - flow) / (g_s + g_t)
    return node, g_s * (ps - node), g_t * (node - pt)


def valve(p: Group, volts: float, flow_a: float, flow_b: float, ps: float, pt: float) -> tuple[Port, Port]:
    """Ports A and B: P-A and B-T open with +volts, P-B and A-T with -volts."""
    pa, bt, at, pb = (
        opening(p, *edge) for edge in (("pa", volts), ("bt", volts), ("at", -volts), ("pb", -volts))
    )
    return port(p, pa, at, flow_a, ps, pt), port(p, pb, bt, flow_b, ps, pt)


def void(pressure: float) -> float:
    """Capacitance [m3/Pa] of the void, section 3."""
    return 1e-12 * exp(min(max((-20e3 - pressure) / 5e3, -60.0), 40.0))


def areas(p: Group) -> tuple[float, float]:
    """Head and rod side area [m2] of a cylinder."""
    return pi / 4 * p.bore**2, pi / 4 * (p.bore**2 - p.rod**2)


def cylinder(p: Group, x: Floats, s: float, v: float, a: Port, b: Port) -> list[float]:
    """Rates of (P_h, P_r, Q_h, Q_r) at piston position s [m] and velocity v [m/s], section 3."""
    p_h, p_r, q_h, q_r = x
    a_h, a_r = areas(p)
    c_h = p.hose_capacitance + (p.dead_volume + a_h * s) / p.bulk_modulus
    c_r = p.hose_capacitance + (p.dead_volume + a_r * (p.stroke - s)) / p.bulk_modulus
    return [
        (q_h - a_h * v) / (c_h + void(p_h)),
        (q_r + a_r * v) / (c_r + void(p_r)),
        (a[0] - p_h - drop(p, "hose", q_h)) / p.hose_inertance,
        (b[0] - p_r - drop(p, "hose", q_r)) / p.hose_inertance,
    ]


def motor(p: Group, p_a: float, p_b: float, tank: float, speed: float) -> tuple[float, float]:
    """Pressures (P_1, P_2) [Pa] of the motor's ports: the 2x2 system of section 4 by Cramer's rule."""
    g = 1 / p.line_resistance
    g_in, g_ex = 1 / p.internal_leakage_resistance, 1 / p.external_leakage_resistance
    own, d = g + g_in + g_ex, p.motor_displacement * p.gear_ratio
    r_1, r_2 = g * p_a + g_ex * tank - d * speed, g * p_b + g_ex * tank + d * speed
    determinant = (own - g_in) * (own + g_in)
    return (own * r_1 + g_in * r_2) / determinant, (own * r_2 + g_in * r_1) / determinant


def slewing(p: Group, x: Floats, p_1: float, p_2: float, a: Port, b: Port) -> list[float]:
    """Rates of (P_a, P_b, Q_a, Q_b), section 4."""
    p_a, p_b, q_a, q_b = x
    turbulence = [p.line_turbulent_resistance * q * abs(q) for q in (q_a, q_b)]
    return [
        (q_a - (p_a - p_1) / p.line_resistance) / (p.line_capacitance + void(p_a)),
        (q_b - (p_b - p_2) / p.line_resistance) / (p.line_capacitance + void(p_b)),
        (a[0] - p_a - turbulence[0]) / p.line_inertance,
        (b[0] - p_b - turbulence[1]) / p.line_inertance,
    ]


def triangle(p: Group, angle: float) -> tuple[float, float, float]:
    """Piston position [m], J [m/rad] and dJ/dq [m/rad2] by the law of cosines, section 5."""
    base, pin = hypot(p.base_x, p.base_z), hypot(p.pin_x, p.pin_z)
    corner = angle + atan2(p.pin_z, p.pin_x) - atan2(p.base_z, p.base_x)
    length = sqrt(base**2 + pin**2 - 2 * base * pin * cos(corner))
    lever = base * pin * sin(corner) / length
    return length - p.closed_length, lever, (base * pin * cos(corner) - lever**2) / length


def stop(p: Group, arm: Group, s: float, v: float) -> float:
    """Force [N] of the end stops, positive outwards, section 5."""
    low, high = 1 - arm.stop_damping * v, 1 + arm.stop_damping * v
    push = ramp(-s, arm.stop_rounding) * (low + sqrt(low**2 + 1e-4)) / 2
    pull = ramp(s - p.stroke, arm.stop_rounding) * (high + sqrt(high**2 + 1e-4)) / 2
    return arm.stop_stiffness * (push - pull)


def swing_stop(arm: Group, angle: float, speed: float) -> float:
    """Torque [N.m] of the end stops of the swing, section 5."""
    if arm.swing_stop_angle == 0:
        return 0.0
    low, high = 1 - arm.swing_stop_damping * speed, 1 + arm.swing_stop_damping * speed
    left = ramp(angle - arm.swing_stop_angle, 1e-3) * (high + sqrt(high**2 + 1e-4)) / 2
    right = ramp(-angle - arm.swing_stop_angle, 1e-3) * (low + sqrt(low**2 + 1e-4)) / 2
    return arm.swing_stop_stiffness * (right - left)


def payload(a: Group, mass: float) -> tuple[float, ...]:
    """A particle at the tip, section 5."""
    return mass, mass * a.gravity, a.boom_pivot_x, a.stick_pivot_x, a.stick_pivot_z, a.stick_length, 0.0


def arm(m: Machine, q2: float, q3: float, w: float, w2: float, w3: float, held: float) -> list[float]:
    """M_11, M_22, M_23, M_33, V_1, V_2, V_3, G_2, G_3: sums over the particles, projected on the joints."""
    c2, s2, cf, sf = cos(q2), sin(q2), cos(q2 + q3), sin(q2 + q3)
    m11 = m22 = m23 = m33 = v1 = v2 = v3 = g2 = g3 = 0.0
    for mass, weight, offset, cx, cz, dx, dz in (*m.particles, payload(m.arm, held)):
        bx, bz = c2 * cx - s2 * cz, s2 * cx + c2 * cz
        ex, ez = cf * dx - sf * dz, sf * dx + cf * dz
        radius, jr, jz = offset + bx + ex, -bz - ez, bx + ex  # (jr, jz), (-ez, ex): partial velocities
        a_radial = -bx * w2**2 - ex * (w2 + w3) ** 2 - radius * w**2
        a_height = -bz * w2**2 - ez * (w2 + w3) ** 2
        a_around = 2 * w * (jr * w2 - ez * w3)
        m11 += mass * radius**2
        m22 += mass * (jr**2 + jz**2)
        m23 += mass * (jz * ex - jr * ez)
        m33 += mass * (ex**2 + ez**2)
        v1 += mass * radius * a_around
        v2 += mass * (jr * a_radial + jz * a_height)
        v3 += mass * (ex * a_height - ez * a_radial)
        g2 += weight * jz
        g3 += weight * ex
    return [m.arm.column_inertia + m11, m22, m23, m33, v1, v2, v3, g2, g3]


def pick_up(a: Group, q2: float, q3: float, w: float, w2: float, w3: float, flow: float) -> list[float]:
    """Moments [N.m] on the joints: the tip gives its velocity to a mass at rest, section 5."""
    out_2 = a.stick_pivot_x * cos(q2) - a.stick_pivot_z * sin(q2)  # boom pivot to elbow, elbow to tip
    up_2 = a.stick_pivot_x * sin(q2) + a.stick_pivot_z * cos(q2)
    out_3, up_3 = a.stick_length * cos(q2 + q3), a.stick_length * sin(q2 + q3)
    radius, pitch_speed = a.boom_pivot_x + out_2 + out_3, w2 + w3
    around, out, up = radius * w, -up_2 * w2 - up_3 * pitch_speed, out_2 * w2 + out_3 * pitch_speed
    force = [-max(flow, 0.0) * v for v in (around, out, up)]
    about_elbow = out_3 * force[2] - up_3 * force[1]
    return [radius * force[0], about_elbow + out_2 * force[2] - up_2 * force[1], about_elbow]


def evaluate(m: Machine, x: Floats, u: Floats) -> tuple[list[float], Group]:
    """Rates of the 20 states and what they are made of.

    u   three commands [V], supply, tank pressure [Pa], payload [kg]
    """
    q2, q3, w, w2, w3, held, flow = x[13:20]
    p_1, p_2 = motor(m.swing, x[0], x[1], u[4], w)
    torque = m.swing.motor_displacement * m.swing.gear_ratio * (p_1 - p_2)
    m11, m22, m23, m33, v1, v2, v3, g2, g3 = arm(m, q2, q3, w, w2, w3, held)
    drag = pick_up(m.arm, q2, q3, w, w2, w3, flow)
    ports = [valve(m.swing, u[0], x[2], x[3], u[3], u[4])]
    rates = slewing(m.swing, x[0:4], p_1, p_2, *ports[0])
    z = Group(
        motor=(p_1, p_2), torque=torque, ports=ports, triangles=[], forces=[], stops=[], gravity=(g2, g3)
    )
    loads = []
    for i, (angle, speed, bias) in enumerate(((q2, w2, v2 + g2 - drag[1]), (q3, w3, v3 + g3 - drag[2]))):
        p, link, oil = m.hydraulic[i], m.linkage[i], x[4 + 4 * i : 8 + 4 * i]
        s, lever, bend = triangle(link, angle)
        v = lever * speed
        ports.append(valve(p, u[1 + i], oil[2], oil[3], u[3], u[4]))
        rates += cylinder(p, oil, s, v, *ports[-1])
        force, end = areas(p)[0] * oil[0] - areas(p)[1] * oil[1], stop(link, m.arm, s, v)
        loads.append(lever * (force - link.piston_damping * v + end) - link.joint_damping * speed - bias)
        z.triangles.append((s, lever, bend))
        z.forces.append(force)
        z.stops.append(end)
    determinant = m22 * m33 - m23**2
    z.swing_stop = swing_stop(m.arm, x[12], w)
    turn = (torque + z.swing_stop + drag[0] - m.arm.swing_damping * w - v1) / m11
    lift = (m33 * loads[0] - m23 * loads[1]) / determinant
    fold = (m22 * loads[1] - m23 * loads[0]) / determinant
    slow, fast = 2 / 3 * m.arm.payload_grip_time, 1 / 3 * m.arm.payload_grip_time  # lags in series
    grip = (u[5] - held) / (slow * fast) - flow * (slow + fast) / (slow * fast)
    return [*rates, w, w2, w3, turn, lift, fold, flow, grip], z


def velocity(flows: Floats, bore: float) -> float:
    """Velocity of the oil in the faster of both hoses, section 3."""
    return max(map(abs, flows)) / (pi / 4 * bore**2)


def observe(m: Machine, x: Floats, u: Floats) -> dict[str, float]:
    """Observables by `component.variable`, sections 2 to 6."""
    dx, z = evaluate(m, x, u)
    d, (p_1, p_2) = m.swing.motor_displacement * m.swing.gear_ratio, z.motor
    drain = (p_1 + p_2 - 2 * u[4]) / m.swing.external_leakage_resistance
    rate_1, rate_2 = motor(m.swing, dx[0], dx[1], 0.0, dx[15])
    (_, supply_a, tank_a), (_, supply_b, tank_b) = z.ports[0]
    y = {
        "swing.swing_torque": z.torque,
        "swing.swing_torque_rate": d * (rate_1 - rate_2),
        "swing.swing_motor_pressure_a": p_1,
        "swing.swing_motor_pressure_b": p_2,
        "swing.swing_drain_flow": drain,
        "swing.supply_flow": supply_a + supply_b,
        "swing.return_flow": tank_a + tank_b + drain,
        "swing.swing_void_volume": 5e3 * (void(x[0]) + void(x[1])),
        "swing.swing_oil_velocity": velocity(x[2:4], m.swing.line_bore),
        "boom_stick.supply_flow": sum(node[1] for pair in z.ports[1:] for node in pair),
        "boom_stick.return_flow": sum(node[2] for pair in z.ports[1:] for node in pair),
        "manipulator.swing_acceleration": dx[15],
        "manipulator.swing_stop_torque": z.swing_stop,
    }
    for i, name in enumerate(("boom", "stick")):
        s, lever, bend = z.triangles[i]
        a_h, a_r = areas(m.hydraulic[i])
        h, r, speed = 4 + 4 * i, 5 + 4 * i, x[16 + i]
        y |= {
            f"boom_stick.{name}_force": z.forces[i],
            f"boom_stick.{name}_force_rate": a_h * dx[h] - a_r * dx[r],
            f"boom_stick.{name}_void_volume": 5e3 * (void(x[h]) + void(x[r])),
            f"boom_stick.{name}_oil_velocity": velocity(x[h + 2 : h + 4], m.hydraulic[i].hose_bore),
            f"manipulator.{name}_position": s,
            f"manipulator.{name}_velocity": lever * speed,
            f"manipulator.{name}_acceleration": lever * dx[16 + i] + bend * speed**2,
            f"manipulator.{name}_holding_force": z.gravity[i] / lever,
            f"manipulator.{name}_torque": lever * z.forces[i],
            f"manipulator.{name}_stop_force": z.stops[i],
        }
    return y


def start(m: Machine, angles: Floats, tank: float, held: float = 0.0) -> list[float]:
    """States at rest that hold the pose, sections 3 and 4.

    Angles [rad] of the joints, tank pressure [Pa], payload [kg].
    """
    x = [tank + m.swing.initial_preload, tank + m.swing.initial_preload, 0.0, 0.0]
    gravity = arm(m, angles[1], angles[2], 0.0, 0.0, 0.0, held)[7:]
    for p, link, g, angle in zip(m.hydraulic, m.linkage, gravity, angles[1:], strict=True):
        a_h, a_r = areas(p)
        force, preload = g / triangle(link, angle)[1], tank + p.initial_preload
        p_r = preload + (-force + sqrt(force**2 + (0.1 * preload * a_r) ** 2)) / 2 / a_r
        x += [(force + a_r * p_r) / a_h, p_r, 0.0, 0.0]
    return [*x, *angles, 0.0, 0.0, 0.0, held, 0.0]
