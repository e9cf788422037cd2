"""The controller written once more from docs/control.md: plain NumPy, other ways to the same numbers.

Where the project multiplies out, this solves: the damped inverse and the steadied pressures are linear
systems, the command is found by bisection on the valve's curve, places are complex numbers. Nothing of
`fmus` is used; names of sections are those of docs/control.md.
"""

from types import SimpleNamespace as Group

import numpy as np
from equations.circuits_transcription import foot as m
from equations.circuits_transcription import step as rise
from equations.transcription import ramp as r
from scipy.optimize import brentq

AXES = ("swing", "boom", "stick")


def clip(z, low, high):
    return min(max(z, low), high)


class Arm:
    """Points in the plane of the arm as complex numbers, radius + i height."""

    def __init__(self, boom: float, stick: float, p: Group) -> None:
        turn, pitch = np.exp(1j * boom), np.exp(1j * (boom + stick))
        self.upper = turn * complex(p.stick_pivot_x, p.stick_pivot_z)
        self.lower = pitch * p.stick_length
        self.tip = complex(p.boom_pivot_x, p.boom_pivot_z) + self.upper + self.lower
        links = 1j * (self.upper + self.lower), 1j * self.lower  # d tip / d angle
        self.jacobian = np.array([[c.real for c in links], [c.imag for c in links]])
        self.pistons, self.arms = [0.0], [1.0]
        for name, angle in (("boom", boom), ("stick", stick)):
            base, pin = (
                complex(getattr(p, f"{name}_{n}_x"), getattr(p, f"{name}_{n}_z")) for n in ("base", "pin")
            )
            moved = np.exp(1j * angle) * pin
            length = abs(moved - base)
            self.pistons.append(length - getattr(p, f"{name}_closed_length"))
            self.arms.append((np.conj(moved - base) * 1j * moved).real / length)

    def velocity(self, boom: float, stick: float) -> np.ndarray:
        return self.jacobian @ [boom, stick]


def oil(name: str, piston: float, p: Group) -> Group:
    """Areas, capacitances, hose and valve of one actuator."""
    prefix = "swing_" if name == "swing" else ""
    valve = {n: getattr(p, f"{prefix}valve_{n}") for n in ("dead_band", "full_command")}
    valve["rounding"] = getattr(p, f"{prefix}valve_command_rounding")
    rho = getattr(p, f"{prefix}density")
    discharge, area = (getattr(p, f"{prefix}valve_{n}") for n in ("discharge_coefficient", "area"))
    valve["k_valve"] = discharge * area * np.sqrt(2 / rho)
    head = getattr(p, f"{name}_section_flow")
    valve["q"] = np.array([head, getattr(p, f"{name}_rod_section_flow", 0.0) or head])
    if name == "swing":
        d, c = p.motor_displacement * p.gear_ratio, p.line_capacitance
        return Group(a=np.array([d, d]), c=np.array([c, c]), hose=p.line_turbulent_resistance, **valve)
    bore, rod, dead, hose = (
        getattr(p, f"{name}_{n}") for n in ("bore", "rod", "dead_volume", "hose_capacitance")
    )
    a = np.pi / 4 * np.array([bore**2, bore**2 - rod**2])
    volume = dead + a * np.array([piston, getattr(p, f"{name}_stroke") - piston])
    return Group(a=a, c=hose + volume / p.bulk_modulus, hose=getattr(p, f"{name}_hose_resistance"), **valve)


def references(x: Group, u: Group, p: Group) -> Group:
    """Section reference: angles, joint speeds, rates of the states, errors and shares."""
    e, f = clip(u.engaged, 0, 1), clip(u.follow, 0, 1)
    q = np.array([x.reference_swing, x.reference_boom, x.reference_stick])
    q_m = np.array([u.swing_angle, u.boom_angle, u.stick_angle])
    w_m = np.array([u.swing_speed, u.boom_speed, u.stick_speed])
    arm, machine = Arm(*q[1:], p), Arm(*q_m[1:], p)
    at = np.array([arm.tip.real, arm.tip.imag, q[0]])
    d = np.array([u.path_radius, u.path_height, u.path_angle]) - at
    size = d[0] ** 2 + d[1] ** 2 + (at[0] * d[2]) ** 2
    drawn = p.follow_gain * d / np.sqrt(1 + p.follow_gain**2 * size / p.follow_speed**2)
    asked = np.array([u.radial_velocity, u.vertical_velocity, u.swing_velocity])
    levers = np.array([x.radial_lever, x.vertical_lever, x.turning_lever])
    v = levers + f * (asked - levers + drawn)
    sine = (np.conj(arm.upper) * arm.lower).imag / abs(arm.upper) / abs(arm.lower)
    damping = p.singular_damping * max(0, 1 - sine**2 / (p.singular_share**2 + 1e-12))
    j = arm.jacobian
    joints = j.T @ np.linalg.solve(j @ j.T + damping**2 * np.eye(2), v[:2])
    speeds = np.array([v[2], *joints])
    y = arm.arms * speeds
    limit = np.array([getattr(p, f"{n}_speed_limit") for n in AXES])
    most = limit.copy()
    for i, section in enumerate(oil(n, arm.pistons[i], p) for i, n in enumerate(AXES)):
        if section.q[0] > 0:
            most[i] = min(limit[i], 0.9 * (section.q / section.a).min())
    use = (((y / most) ** 8).sum() + 1e-32) ** (1 / 8)
    ends = 1e-32
    for i, name in ((1, "boom"), (2, "stick")):
        stroke = getattr(p, f"{name}_stroke")
        for left, out in (
            (stroke - p.stroke_margin - arm.pistons[i], y[i]),
            (arm.pistons[i] - p.stroke_margin, -y[i]),
        ):
            ends += (max(0, out) / (p.stroke_gain * r(left, 1e-3) + 1e-6)) ** 8
    ends = ends ** (1 / 8)
    share = 1 / (1 + r((use**8 + ends**8 + 1e-24) ** (1 / 8) - 0.9, 0.2))
    errors = np.array([q[0] - q_m[0], *(np.array(arm.pistons) - machine.pistons)[1:]])
    scale = np.array([p.swing_error_limit, p.piston_error_limit, p.piston_error_limit])
    far = p.feedback * ((errors / scale) ** 2).sum()
    lag = errors / scale * y / np.sqrt(y**2 + (p.learning_share * limit) ** 2)
    wait = p.feedback * (np.maximum(0, lag) ** 2).sum()
    share *= 1 - rise((wait - 0.25) / 0.75)
    own = share * speeds + p.return_rate * r(far - 1, 0.5) * (q_m - q)
    there = np.array([machine.tip.real, machine.tip.imag, q_m[0]])
    moving = np.array([*machine.velocity(*w_m[1:]), w_m[0]])
    return Group(
        e=e, arm=arm, errors=errors, at=at, there=there, use=use, ends=ends, share=share,
        toward=y / np.sqrt(y**2 + (p.learning_share * limit) ** 2),
        wait=np.sqrt(wait + 1e-12) - 1e-6,
        speeds=e * share * speeds + (1 - e) * w_m,
        rates=e * own + (1 - e) * (w_m + (q_m - q) / p.tracking_time),
        levers=e * (asked - levers) / p.lever_time + (1 - e) * (moving - levers) / p.tracking_time,
    )  # fmt: skip


def carried(ref: Group, x: Group, p: Group) -> tuple[np.ndarray, np.ndarray]:
    """Section load: inertia of each axis, and the force that accelerates it."""
    columns = ref.arm.jacobian.T
    loads = np.array([x.boom_load, x.stick_load]) * ref.arm.arms[1:]
    mass = clip(loads @ columns[:, 1] / (9.81 * (columns[:, 1] @ columns[:, 1] + 0.01)), 0, 1e5)
    rates = (ref.speeds - [x.swing_late_speed, x.boom_late_speed, x.stick_late_speed]) / p.lead_filter_time
    radius, w = ref.at[0], ref.speeds[0]
    plane = rates[1:] @ columns - [radius * w**2, 0]
    turning = radius * rates[0] + 2 * w * (ref.speeds[1:] @ columns)[0]
    a = [clip(c, -9.81, 9.81) for c in (*plane, turning)]
    arms = np.array(ref.arm.arms[1:])
    inertia = mass * np.array([radius**2, *((columns**2).sum(axis=1) / arms**2)])
    return inertia, mass * np.array([radius * a[2], *(columns @ a[:2] / arms)])


def volts(opening: float, o: Group, foot: float, offsets: np.ndarray) -> float:
    """Section command: the valve's curve turned round by bisection."""
    size = np.sqrt(opening**2 + foot**2)
    share = (1 + opening / size) / 2  # of the positive direction
    dead_band = o.dead_band + offsets @ [share, 1 - share]
    value = size * r(o.full_command - dead_band, o.rounding)
    z = brentq(lambda volt: r(volt, o.rounding) - value, 0.0, 2 * o.full_command, xtol=1e-14, rtol=1e-14)
    return opening / size * (dead_band + z)


def drive(i: int, ref: Group, x: Group, u: Group, p: Group) -> dict[str, float]:
    """Sections drive and command of one actuator: rates of its states."""
    name, b, error = AXES[i], ref.speeds[i], ref.errors[i]
    o = oil(name, ref.arm.pistons[i], p)
    late, h, load = (getattr(x, f"{name}_{n}") for n in ("late_speed", "gain", "load"))
    ports = ("pressure_a", "pressure_b") if name == "swing" else ("head_pressure", "rod_pressure")
    pressure = np.array([getattr(u, f"{name}_{n}") for n in ports])
    speed = ref.arm.arms[i] * (b + p.lead_time * (b - late) / p.lead_filter_time)
    kind = "swing" if name == "swing" else "piston"
    kp, ki, g, slowly = (
        getattr(p, f"{kind}_{n}") for n in ("position_gain", "integral_gain", "damping_rate", "load_time")
    )
    k, side = (o.a**2 / o.c).sum(), np.array([1, -1])
    inertia, along = (value[i] for value in carried(ref, x, p))
    lower = (1 + ((kp / p.frequency_share) ** 2 * inertia / k) ** 4) ** (-1 / 8)
    kp, ki = kp * lower, ki * lower**2
    swinging = o.a * side @ pressure - load - along
    v = speed + p.feedback * (kp * error + h * speed - g * swinging / k)
    head, rod = np.linalg.solve([o.a * side, o.c / o.a], [load + along, (pressure * o.c / o.a).sum()])
    s, t = u.supply_pressure, u.tank_pressure
    by, w = o.a / o.c, 2e5
    up, down = (
        o.k_valve / k * by @ np.sqrt([m(z, w) for z in drops])
        for drops in ((s - head, rod - t), (head - t, s - rod))
    )
    fixed = 0.0 if name == "swing" else getattr(p, f"nominal_{name}_holding_force")
    forces = o.a[0] * p.nominal_supply_pressure - fixed, o.a[1] * p.nominal_supply_pressure + fixed
    plain = [o.k_valve * np.sqrt(m(z, w * o.a[0]) / (o.a**3).sum()) for z in forces]
    full = [n + p.feedback * (known - n) for n, known in zip(plain, (up, down), strict=True)]
    size = v**2 / np.sqrt(v**2 + 1e-8)
    spare = o.a[0] * s - o.a[1] * t - load, o.a[1] * s - o.a[0] * t + load
    gates = [1 + p.feedback * (rise(f / (a * 5e5)) - 1) for f, a in zip(spare, o.a, strict=True)]
    if o.q[0] > 0:  # a compensated section
        full, gates = o.q / o.a, [1.0, 1.0]
    flows, bands = (
        np.array([getattr(x, f"{name}_{n}_{end}") for end in ("up", "down")]) for n in ("flow", "dead_band")
    )
    full = np.array(full) * (1 + flows)
    mean = full.mean()
    y = gates[0] * (v + size) / 2 / full[0] + gates[1] * (v - size) / 2 / full[1]
    hose = 0.0 if o.q[0] > 0 else o.hose
    wide = y / np.sqrt(1 - hose * o.k_valve**2 * min(y**2, 1))
    had = wide - r(wide - 0.95, 0.1)
    had += r(-had - 0.95, 0.1)
    lever = clip(getattr(u, f"{name}_lever"), -o.full_command, o.full_command)
    target = lever + x.coordination * (volts(had, o, p.foot_share, bands) - lever)
    slow, most = p.learning_share * getattr(p, f"{name}_speed_limit"), p.gain_limit
    learn = ki * error - (wide - had) * mean / p.unwinding_time
    learn *= speed / (speed**2 + slow**2)
    over = (r(h - most, most / 10) - r(-h - most, most / 10)) / p.unwinding_time
    taught = ref.e * p.feedback * (learn / np.sqrt(1 + (learn / 2) ** 2) - over)
    half, limit = getattr(x, f"{name}_half_width"), o.full_command / 2 * p.hysteresis_limit
    alpha = ref.arm.arms[i] * (b - late) / p.lead_filter_time
    steady = 0.05 * getattr(p, f"{name}_speed_limit")
    f = p.hysteresis_gain * (p.hysteresis > 0) * error * speed**2 / (speed**2 + slow**2)
    f *= (o.full_command - o.dead_band) / mean * alpha / np.hypot(alpha, steady)
    beyond = (r(half - limit, limit / 10) - r(-half, limit / 10)) / p.unwinding_time
    spool, trailing = getattr(x, f"{name}_spool"), getattr(x, f"{name}_trailing")
    seen = Group(
        name=name, speed=speed, v=v, opening=wide, margin=np.prod(gates),
        volt=mean / (o.full_command - o.dead_band), point=0.1 * (o.full_command - o.dead_band),
        own=ref.arm.arms[i] * ref.rates[i], error=error, swinging=swinging, along=along, k=k, slowly=slowly,
        slow=slow,
        spare=np.maximum(np.array(spare), 5e5 * o.a), compensated=o.q[0] > 0,
    )  # fmt: skip
    taught_valve, wider = learning(seen, x, p, ref.e * p.feedback * p.learning * x.coordination)
    wider *= p.hysteresis > 0
    return taught_valve | {
        f"{name}_spool": (target - spool) / p.amplifier_time,
        f"{name}_trailing": trailing_rate(spool, trailing, p.reversal),
        f"{name}_half_width": wider
        + ref.e * p.feedback * (1 - p.learning) * f / (1 + (f / 0.3) ** 2)
        - beyond,
        f"reference_{name}": ref.rates[i],
        f"{name}_gain": taught - (1 - ref.e) * h / p.tracking_time,
        f"{name}_load": swinging / slowly,
        f"{name}_late_speed": (b - late) / p.lead_filter_time,
    }


def learning(o: Group, x: Group, p: Group, active: float) -> tuple[dict[str, float], float]:
    """Section learning: rates of what is known of a valve, and the share of the play's."""
    names = ("late_command", "oil_shift", *(f"covariance_{n}" for n in (11, 12, 22)), "spool", "trailing")
    late, shift, p11, p12, p22, spool, trailing = (getattr(x, f"{o.name}_{n}") for n in names)
    sign, end = (1, "up") if o.speed > 0 else (-1, "down")
    c = 1 - (not o.compensated) * sign * o.swinging / (2 * o.spare[0 if sign > 0 else 1])
    n = ((o.swinging + o.along) / o.k - o.error - shift) / p.learning_filter_time
    late_rate = (o.v - late) / (p.amplifier_time + p.learning_lag)
    residual = sign * n / o.volt
    w = clip(min(abs(o.speed), sign * late) / o.slow - 1, 0, 1) * o.margin * (abs(o.opening) < 0.9)
    w /= 1 + (p.learning_lag * late_rate / (0.06 * o.volt)) ** 2
    pace, bent = active * w / p.learning_time, residual / (1 + (residual / 0.5) ** 2)
    cov = np.array([[p11, p12], [p12, p22]])
    k = cov @ [-1, sign * c * late / o.volt / o.point]
    change = pace * (np.eye(2) - np.outer(k, k) - cov / 100)
    rates = {f"{o.name}_covariance_{i}{j}": change[i - 1, j - 1] for i, j in ((1, 1), (1, 2), (2, 2))}
    rates |= {f"{o.name}_late_command": late_rate}
    rates |= {f"{o.name}_oil_shift": c * late - o.own - o.swinging / o.k / o.slowly + n}
    for kind, step, limit in (("dead_band", k[0], p.dead_band_limit), ("flow", k[1] / o.point, p.gain_limit)):
        for side in ("up", "down"):
            value = getattr(x, f"{o.name}_{kind}_{side}")
            rates[f"{o.name}_{kind}_{side}"] = (side == end) * pace * bent * step
            rates[f"{o.name}_{kind}_{side}"] -= (value - clip(value, -limit, limit)) / p.unwinding_time
    s = (spool - trailing) / np.hypot(spool - trailing, p.reversal / 3)
    return rates, -pace * s * sign * bent / 4


def trailing_rate(spool, trailing, n):
    """Section play: the rate of t."""
    return 200 * (r(spool - trailing - 5 / 6 * n, n / 3) - r(trailing - spool - 5 / 6 * n, n / 3))


def command(name: str, x: dict, p: Group) -> float:
    """Section play: V_c, also of complex states."""
    full = p.swing_valve_full_command if name == "swing" else p.valve_full_command
    spool, apart = x[f"{name}_spool"], x[f"{name}_spool"] - x[f"{name}_trailing"]
    s = apart / np.sqrt(apart**2 + (p.reversal / 3) ** 2)
    return spool + x["coordination"] * x[f"{name}_half_width"] * (1 - spool**2 / full**2) * s


def pressure_use(ref: Group, x: Group, u: Group, p: Group) -> float:
    """Section reference: the pressure that the loads need over that of the supply."""
    uses = [0.0]
    for i, name in enumerate(AXES):
        a, load = oil(name, ref.arm.pistons[i], p).a, getattr(x, f"{name}_load")
        for push, behind, sign in ((a[0], a[1], 1), (a[1], a[0], -1)):
            need = (sign * load + behind * u.tank_pressure) / push + 5e5
            uses.append(max(0.0, sign * ref.toward[i]) ** 2 * need / max(u.supply_pressure, 1e5))
    return max(uses)


def written(x: Group, u: Group, p: Group) -> tuple[dict[str, float], dict[str, float]]:
    """Rates of the states and outputs."""
    ref = references(x, u, p)
    rates = {n: v for i in range(3) for n, v in drive(i, ref, x, u, p).items()}
    rates |= dict(zip(("radial_lever", "vertical_lever", "turning_lever"), ref.levers, strict=True))
    rates["coordination"] = (ref.e - x.coordination) / p.blend_time
    here, there = (np.array([a * np.cos(g), a * np.sin(g), h]) for a, h, g in (ref.at, ref.there))
    # the derivative along the rates by a step in the imaginary direction: exact to rounding
    moving = {n: v + 1e-20j * rates.get(n, 0.0) for n, v in vars(x).items()}
    shown = {f"{n}_command": command(n, moving, p).real for n in AXES}
    learned = ("dead_band_up", "dead_band_down", "flow_up", "flow_down", "half_width")
    shown |= {f"{n}_{k}": getattr(x, f"{n}_{k}") for n in AXES for k in learned}
    shown |= {f"{n}_command_rate": command(n, moving, p).imag / 1e-20 for n in AXES}
    shown |= {f"reference_{n}": v for n, v in zip(("radius", "height", "angle"), ref.at, strict=True)}
    apart = ref.at - ref.there
    shown |= {f"{n}_error": v for n, v in zip(("radial", "vertical", "angle"), apart, strict=True)}
    shown["tip_error"] = np.sqrt(((here - there) ** 2).sum() + 1e-12) - 1e-6
    uses = {"speed_use": ref.use, "stroke_use": ref.ends, "wait_use": ref.wait, "reference_share": ref.share}
    return rates, shown | uses | {"pressure_use": pressure_use(ref, x, u, p)}
