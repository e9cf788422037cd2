"""Compensated drives and load-sensing pump written once more from docs/equations.md, 4.6 to 4.9 and 5.4.

Nothing of `fmus` or `orchestrator` is used but the functions of `transcription`. A part's numbers, states and
inputs are dictionaries by the project's names, and so are the rates and observables that come back.
"""

from collections.abc import Mapping
from math import pi, sqrt
from types import SimpleNamespace as Group

from equations.transcription import drop as friction_drop
from equations.transcription import friction, laminar, oil, opening, ramp, velocity, void, warmed

Numbers = Mapping[str, float]
Rates = dict[str, float]

SHUTTLE, LEAST = 5e4, 1e-3  # W [Pa]; smallest dead band over full command


def step(z: float) -> float:
    """sigma(z), Symbols: 0 up to 0, 1 from 1 on."""
    z = min(max(z, 0.0), 1.0)
    return z**3 * (10 - 15 * z + 6 * z**2)


def step_slope(z: float) -> float:
    """Derivative of `step`."""
    z = min(max(z, 0.0), 1.0)
    return 30 * z**2 * (1 - z) ** 2


def foot(z: float, width: float) -> float:
    """m(z), Symbols."""
    return (z + sqrt(z**2 + width**2)) / 2


def least(a: float, b: float, width: float) -> float:
    """l(a, b), Symbols: the lower one, rounded."""
    return a - ramp(a - b + width / 2, width)


def root(y: float, linear: float, square: float = 1.0) -> float:
    """f(y, b, a) of section 4.5."""
    return 2 * y / (linear + sqrt(linear**2 + 4 * square * abs(y)))


def through(p: Group, area: float, drop: float, of: str = "") -> float:
    """Flow through an opening [m2], and in series through a hose or line of this name, section 4.5."""
    square = (p.valve_discharge_coefficient * area) ** 2 * 2 / p.density
    edge = laminar(p, area)
    if not of:
        return root(square * drop, edge)
    b, a = friction(p, of, 0.0)[0], getattr(p, f"{of}{'_turbulent' * (of == 'line')}_resistance")
    flow = root(square * drop, edge + square * b, 1 + square * a)
    if of == "line" or not flow:
        return flow
    b, a = friction(p, of, flow)
    flow = root(square * drop, edge + square * b, 1 + square * a)
    size, hose = abs(flow), friction_drop(p, of, flow)
    # H' by differences of order four: 1e-12
    near, far = (
        friction_drop(p, of, flow * (1 + k)) - friction_drop(p, of, flow * (1 - k)) for k in (1e-4, 2e-4)
    )
    slope = (8 * near - far) / (12e-4 * flow)
    missing = flow * (size + edge) + square * (hose - drop)
    return flow - missing / (2 * size + edge + square * max(slope, hose / flow))


def part(p: Numbers, prefix: str) -> Group:
    """The numbers whose names begin so, without the prefix."""
    return Group(**{n.removeprefix(prefix): x for n, x in p.items() if n.startswith(prefix)})


def dead_band(p: Group, edge: str) -> float:
    """Command [V] from which an edge opens: the first point of its table, if it has one."""
    table = getattr(p, f"valve_{edge}_command_2") > 0
    return max(
        getattr(p, f"valve_{edge}_command_1") if table else p.valve_dead_band, LEAST * p.valve_full_command
    )


def connected(p: Group, command: float) -> tuple[float, float]:
    """g(u) of port A and g(-u) of port B."""
    return step(2 * command / dead_band(p, "pa") - 1), step(-2 * command / dead_band(p, "pb") - 1)


def load(
    p: Group, command: float, command_rate: float, pressures: tuple, rates: tuple, tank: tuple[float, float]
) -> tuple[float, float]:
    """P_load of section 5.4 and its rate, by the rules of sum and product."""
    (tank, moving), (value, rate) = tank, tank
    for sign, edge, pressure, dp in zip((1, -1), ("pa", "pb"), pressures, rates, strict=True):
        slope = 2 * sign / dead_band(p, edge)
        z = slope * command - 1
        value += step(z) * (pressure - tank)
        rate += step(z) * (dp - moving) + step_slope(z) * slope * command_rate * (pressure - tank)
    return value, rate


def higher(a: tuple[float, float], b: tuple[float, float]) -> tuple[float, float]:
    """Pressure and rate behind a shuttle valve, section 5.4."""
    z = a[0] - b[0] + SHUTTLE / 2
    s = min(max(z / SHUTTLE, 0.0), 1.0)
    return b[0] + ramp(z, SHUTTLE), b[1] + (3 * s**2 - 2 * s**3) * (a[1] - b[1])


def section(
    p: Group,
    full: tuple,
    areas: tuple,
    neutral: float,
    series: str,
    u: Numbers,
    command: float,
    ports: tuple,
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Flows (in, out) of the ports A and B, section 4.6; `series`: the line at meter-out, if any."""
    supply, sensing, tank = u["supply_pressure"], u["load_sensing_pressure"], u["tank_pressure"]
    closed = 1 - sum(connected(p, command))
    found = []
    sides = zip((1, -1), ("pa at", "pb bt"), full, areas, ports, strict=True)
    for sign, edges, most, area, pressure in sides:
        enter, leave = edges.split()
        y = opening(p, enter, sign * command)
        both = ramp(supply - pressure, 1e4)
        d_c = p.compensator_sharing * foot(supply - sensing, 2e4)
        d_c = least(p.compensator_setting, d_c, (p.compensator_setting + d_c) / 20)
        d_c *= 1 + p.compensator_droop * (both - 1e7)
        left = both / (1 + y**2 * p.compensator_open_drop / p.compensator_setting)
        drop = least(left, d_c, (left + d_c) / 20)
        passing = most * y / (p.valve_discharge_coefficient * sqrt(2 * p.compensator_setting / p.density))
        q_in = root((most * y) ** 2 * drop / p.compensator_setting, laminar(p, passing))
        leaving = area * opening(p, leave, -sign * command) + neutral * closed
        q_out = through(p, leaving, pressure - tank, series)
        found.append((q_in + p.valve_leakage * both, q_out + p.valve_leakage * (pressure - tank)))
    return found[0], found[1]


def air(p: Group, pressure: float) -> float:
    """kappa_air [1/Pa] of section 4.2: the polytropic law, below 20 kPa absolute its tangent."""
    n, p_0 = p.air_exponent, 101325.0

    def law(absolute: float) -> float:
        return p.air_share / (n * absolute) * (p_0 / absolute) ** (1 / n)

    at = pressure + p_0
    slope = -(1 + 1 / n) * law(2e4) / 2e4  # of the power law with the exponent -(1 + 1/n)
    return law(at) if at > 2e4 else law(2e4) + slope * (at - 2e4)


def relief(p: Group, name: str, drop: float) -> float:
    """Flow of a relief valve, section 4.4."""
    v = part(vars(p), f"{name}_")
    return v.gain * ramp(drop - v.pressure, v.rounding)


def make_up(p: Group, drop: float) -> float:
    """Flow of an anti-cavitation valve, section 4.4."""
    v = part(vars(p), "anti_cavitation_")
    return through(p, v.area * step((drop - v.pressure) / v.rounding), drop)


# ---- swing


def swing(p_: Numbers, x: Numbers, u: Numbers) -> tuple[Rates, Rates]:
    """Rates and observables of the compensated swing, sections 4.5, 4.6, 4.8 to 4.10."""
    p, tank = warmed(Group(**p_), u["oil_temperature"]), u["tank_pressure"]
    sump = tank, u["tank_pressure_rate"]
    a, b, torque, q = (x[f"swing_{n}"] for n in ("pressure_a", "pressure_b", "brake_torque", "brake_applied"))
    areas = (p.swing_return_area, p.swing_return_area)
    (in_a, out_a), (in_b, out_b) = section(
        p, (p.swing_section_flow,) * 2, areas, 0.0, "line", u, u["swing_command"], (a, b)
    )
    d, w = p.motor_displacement * p.gear_ratio, u["swing_speed"]
    inner, outer = p.internal_leakage_resistance, p.external_leakage_resistance
    cross = relief(p, "relief", a - b) - relief(p, "relief", b - a)
    fill = make_up(p, tank - a), make_up(p, tank - b)
    net_a = in_a - out_a - d * w - (a - b) / inner - (a - tank) / outer - cross + fill[0]
    net_b = in_b - out_b + d * w + (a - b) / inner - (b - tank) / outer + cross + fill[1]
    volume = pi / 4 * p.line_bore**2 * p.line_length + p.motor_volume
    da = net_a / (p.line_capacitance + volume * air(p, a) + void(a))
    db = net_b / (p.line_capacitance + volume * air(p, b) + void(b))
    held, width = p.brake_torque * q, 1e-3 * p.brake_torque
    slip = (ramp(torque - held, width) - ramp(-torque - held, width)) / p.brake_drag
    pressed = step(2 * (u["supply_pressure"] - tank) / p.brake_release_pressure - 1)
    free = sum(connected(p, u["swing_command"])) * pressed
    rates = {
        "swing_pressure_a": da,
        "swing_pressure_b": db,
        "swing_brake_torque": p.brake_stiffness * (w - slip),
        "swing_brake_applied": (1 - free) * (1 - q) / p.brake_apply_time - free * q / p.brake_release_time,
    }
    value, rate = load(p, u["swing_command"], u["swing_command_rate"], (a, b), (da, db), sump)
    return rates, {
        "swing_torque": d * (a - b) - torque,
        "swing_torque_rate": d * (da - db) - rates["swing_brake_torque"],
        "supply_flow": in_a + in_b,
        "return_flow": out_a + out_b + (a + b - 2 * tank) / outer - sum(fill),
        "swing_load_pressure": value,
        "swing_load_pressure_rate": rate,
        "swing_oil_velocity": velocity((in_a - out_a, in_b - out_b), p.line_bore),
        "swing_relief_flow": cross,
        "swing_anti_cavitation_flow": sum(fill),
    }


# ---- boom and stick


def counterbalance(p: Group, hose: str, y: float, line: float, chamber: float) -> float:
    """Flow into the cylinder, section 4.7."""
    c = part(vars(p), "counterbalance_")
    check = step((line - chamber - c.check_pressure) / c.check_range)
    area = c.area * y + c.check_area * check
    return through(p, area, line - chamber, hose) + c.leakage * (line - chamber)


def at_rest(p: Group, ratio: float, chamber: float, pilot: float, line: float, tank: float) -> float:
    """y_0, section 4.7."""
    c = part(vars(p), "counterbalance_")
    reference = tank + c.back_pressure_share * (line - tank)
    z = (chamber + ratio * pilot - (1 + ratio) * reference - c.pressure) / c.band
    return ramp(z, 0.1) - ramp(z - 1, 0.1)


def boom_stick(p_: Numbers, x: Numbers, u: Numbers) -> tuple[Rates, Rates]:
    """Rates and observables of both cylinders, sections 4.6 to 4.8 and 4.10."""
    p, tank = warmed(Group(**p_), u["oil_temperature"]), u["tank_pressure"]
    sump = tank, u["tank_pressure_rate"]
    p_, rates = vars(p), {}
    y = {"supply_flow": 0.0, "return_flow": 0.0}
    loads = []
    for axis in ("boom", "stick"):
        own, at = part(p_, f"{axis}_"), part(x, f"{axis}_")
        s, v = u[f"{axis}_position"], u[f"{axis}_velocity"]
        head, rod = pi / 4 * own.bore**2, pi / 4 * (own.bore**2 - own.rod**2)
        lines, chambers = (at.head_valve_pressure, at.rod_valve_pressure), (at.head_pressure, at.rod_pressure)
        openings = at.head_counterbalance_opening, at.rod_counterbalance_opening
        command, command_rate = u[f"{axis}_command"], u[f"{axis}_command_rate"]
        returns = own.head_return_area, own.rod_return_area
        full = own.section_flow, own.rod_section_flow
        ports = section(p, full, returns, p.neutral_area, "", u, command, lines)
        volumes = own.dead_volume + head * s, own.dead_volume + rod * (own.stroke - s)
        inside = pi / 4 * own.hose_bore**2 * own.hose_length
        slopes = []
        for i, side in enumerate(("head", "rod")):
            line, chamber, (q_in, q_out) = lines[i], chambers[i], ports[i]
            q = counterbalance(p, f"{axis}_hose", openings[i], line, chamber)
            out, back = relief(p, "port_relief", line - tank), make_up(p, tank - line)
            swept = (-head * v, rod * v)[i]
            soft = own.hose_capacitance + inside * air(p, line) + void(line)
            slopes.append((q_in - q_out - q - out + back) / soft)
            rates[f"{axis}_{side}_valve_pressure"] = slopes[-1]
            kappa = 1 / p.bulk_modulus + air(p, chamber)
            rates[f"{axis}_{side}_pressure"] = (q + swept) / (volumes[i] * kappa + void(chamber))
            settled = at_rest(p, getattr(own, f"{side}_pilot_ratio"), chamber, lines[1 - i], line, tank)
            rates[f"{axis}_{side}_counterbalance_opening"] = (settled - openings[i]) / p.counterbalance_lag
            y[f"{axis}_{side}_flow"] = q
            y["supply_flow"] += q_in
            y["return_flow"] += q_out + out - back
        flows = y[f"{axis}_head_flow"], y[f"{axis}_rod_flow"]
        y[f"{axis}_oil_velocity"] = velocity(flows, own.hose_bore)
        loads.append(load(p, command, command_rate, lines, tuple(slopes), sump))
        y[f"{axis}_force"] = head * at.head_pressure - rod * at.rod_pressure
        y[f"{axis}_force_rate"] = head * rates[f"{axis}_head_pressure"] - rod * rates[f"{axis}_rod_pressure"]
    y["boom_stick_load_pressure"], y["boom_stick_load_pressure_rate"] = higher(*loads)
    return rates, y


# ---- load-sensing pump


def engine_torque(e: Group, speed: float) -> tuple[float, float]:
    """T_net and T_f, section 5.3."""
    bend = ((speed - e.peak_speed) / (e.rated_speed - e.peak_speed)) ** 2
    net = e.rated_torque * max(1 + e.torque_rise * (1 - bend), 0.1)
    return net, e.friction * speed / sqrt(speed**2 + 1) + e.viscous_friction * speed


def limited(z: float, e: float) -> float:
    """h(z), section 5.3."""
    y = foot(z, e)
    return y - ramp(y - 1 + e / 2, e)


def supply(p_: Numbers, x: Numbers, u: Numbers) -> tuple[Rates, Rates]:
    """Rates and observables of the load-sensing pump, sections 5.3 and 5.4."""
    p, d, e = Group(**p_), part(p_, "main_pump_"), part(p_, "engine_")
    tank, w, s = p.reservoir_pressure, x["engine_speed"], x["pump_stroke"]
    m = oil(x["oil_temperature"], p.oil_viscosity_40, p.oil_viscosity_100)[0]
    returning = x["tank_pressure"]
    out, rail, sensing = x["pump_pressure"], x["supply_pressure"], x["load_sensing_pressure"]
    oil_drawn = step(2 * x["reservoir_volume"] / p.suction_volume - 1)
    displaced = s * d.displacement * oil_drawn * step(w / 10)
    rise, drawn = out - tank, displaced * w
    q = ramp(out - rail, p.check_opening) / d.check_resistance
    blown = p.relief_gain * ramp(rail - tank - p.relief_pressure, p.relief_rounding)
    bled, leaking = p.rail_leakage / m * (rail - tank), d.leakage / m * rise
    taken = u["supply_flow_swing"] + u["supply_flow_boom_stick"]
    back = u["return_flow_swing"] + u["return_flow_boom_stick"]
    sign = w / sqrt(w**2 + 1)
    friction = d.pressure_friction * d.displacement * oil_drawn * foot(rise, 1e4) * sign
    friction += d.viscous_friction * (0.18 * m + 0.82) * w
    torque = displaced * rise + friction
    net, dry = engine_torque(e, w)
    fuel = x["engine_fuel_torque"]
    burning = step((w - e.stall_speed) / (e.idle_speed - e.stall_speed)) * fuel
    z = (dry + net * (e.no_load_speed - w) / (e.no_load_speed - e.rated_speed)) / (net + dry)
    margin = (sensing + p.margin - out) / p.margin_band
    cut_off = (p.pressure_cut_off - out) / p.cut_off_band
    power = 2.0 if rise <= 0 else min(p.torque_limit / (d.displacement * rise), 2.0)
    target = limited(least(least(margin, cut_off, d.rounding), power, d.rounding), d.rounding)
    lag = (target - s) / d.lag
    time = d.stroke_time if lag > 0 else d.destroke_time
    highest, _ = higher((u["swing_load_pressure"], 0.0), (u["boom_stick_load_pressure"], 0.0))
    loaded = ramp(returning - tank - p.return_preload, p.check_opening)
    into_tank = (loaded - oil_drawn * ramp(tank - returning, p.check_opening)) / p.return_resistance
    past_filter = returning - tank - p.return_preload - p.return_bypass_pressure
    into_tank += p.return_bypass_gain * ramp(past_filter, p.return_bypass_rounding)
    # heat, and with it what warms the oil: what the drives take, and the losses without those of the engine
    warming = taken * rail - back * returning + leaking * rise + friction * w + q * (out - rail)
    warming += (blown + bled) * (rail - tank) + into_tank * (returning - tank)
    cooled = p.tank_conductance + p.cooler_conductance * limited(
        (x["oil_temperature"] - p.cooler_setting) / p.cooler_band, 0.02
    )
    cooled *= x["oil_temperature"] - p.ambient_temperature
    limit = p.pressure_cut_off - p.load_sensing_relief_difference
    rates = {
        "supply_pressure": (q - taken - blown - bled) / (p.rail_capacitance + void(rail)),
        "load_sensing_pressure": (least(highest, limit, p.load_sensing_relief_rounding) - sensing)
        / p.load_sensing_lag,
        "pump_pressure": (drawn - leaking - q) / (d.line_capacitance + void(out)),
        "pump_stroke": lag / sqrt(1 + (lag * time) ** 2),
        "engine_speed": (burning - dry - torque) / e.inertia,
        "engine_fuel_torque": ((net + dry) * limited(z, 0.02) - fuel) / e.lag,
        "tank_pressure": (back - into_tank) / (p.return_capacitance + void(returning)),
        "oil_temperature": (warming - cooled) / p.heat_capacity,
        "reservoir_volume": into_tank + leaking + blown + bled - drawn,
    }
    return rates, {
        "supply_pressure_rate": rates["supply_pressure"],
        "tank_pressure_rate": rates["tank_pressure"],
        "load_sensing_pressure_rate": rates["load_sensing_pressure"],
        "pump_flow": q,
        "relief_flow": blown,
        "engine_load": torque,
        "engine_torque": burning,
        "engine_power": burning * w,
        "reservoir_volume_below_suction": max(p.suction_volume - x["reservoir_volume"], 0),
        "engine_speed_below_idle": max(e.idle_speed - w, 0),
        "engine_speed_below_stall": max(e.stall_speed - w, 0),
    }
