"""The detailed drives: energy, rest, exact rates, and the limit in which they are the lumped ones."""

from __future__ import annotations

import math
import re
from functools import cache

import casadi as ca
import numpy as np
import pytest

from fmus import boom_stick, swing
from fmus.boom_stick.detailed import detailed as detailed_boom_stick
from fmus.contract import quantities, symbolic
from fmus.monolith import join, simulate
from fmus.parameters import values
from fmus.swing.detailed import detailed as detailed_swing

LUMPED = {"swing": swing.VARIANTS["lumped"], "boom_stick": boom_stick.VARIANTS["lumped"]}
CASES = {
    "swing": swing.VARIANTS["detailed"],
    "boom_stick": boom_stick.VARIANTS["detailed"],
    "swing, three lumps, layers": detailed_swing(3, True),
    "boom_stick, one lump, layers": detailed_boom_stick(1, True),
    "boom_stick, different lumps": detailed_boom_stick({"boom": 1, "stick": 4}),
}


def named(sub, group, column):
    """Expressions by name."""
    return dict(zip(quantities(getattr(sub, group)), ca.vertsplit(column), strict=True))


def along(s, u, value):
    """d/dt of an expression along the solution: positions move with velocities, the supply with its rate."""
    rate = ca.jtimes(value, s.x, s.dx)
    for name in u:
        source = name.replace("position", "velocity") if name.endswith("_position") else f"{name}_rate"
        if source != name and source in u:
            rate += ca.jacobian(value, u[name]) * u[source]
    return rate


def random_point(sub, rng):
    """States and inputs in and beyond the working range, cavitation and open relief valves among them."""

    def draw(name, nominal):
        if "pressure" in name and not name.endswith("_rate"):
            return rng.choice([rng.uniform(-1.2e5, 1e5), rng.uniform(1e5, 3e7)])
        if name.endswith("_position"):
            return rng.uniform(-1, 1) if "spool" in name else rng.uniform(0.1, 0.5)
        return rng.normal() * nominal

    return tuple(
        np.array([draw(n, q.nominal) for n, q in quantities(group).items()])
        for group in (sub.states, sub.inputs)
    )


@pytest.mark.parametrize("sub", CASES.values(), ids=CASES.keys())
def test_energy_balance_closes_to_rounding(sub):
    """Power in + convected = d(stored)/dt + heat at random states, and no heat is negative."""
    s, p, rng = symbolic(sub), list(values(sub).p.values()), np.random.default_rng(4)
    u, y = named(sub, "inputs", s.u), named(sub, "outputs", s.y)
    power = u["supply_pressure"] * y["supply_flow"] - u["tank_pressure"] * y["return_flow"]
    if sub.part == "swing":
        power -= y["swing_torque"] * u["swing_speed"]
    else:
        power += y["convected_power"] - sum(y[f"{a}_force"] * u[f"{a}_velocity"] for a in ("boom", "stick"))
    rate = along(s, u, y["stored_energy"])
    balance = ca.Function("b", [s.x, s.u, s.p], [power, rate, y["dissipated_power"]])
    for _ in range(100):
        power_in, stored, heat = (float(b) for b in balance(*random_point(sub, rng), p))
        assert heat >= 0
        # exact identity; 1e-10 is 1e6 rounding errors of the largest term
        assert power_in - stored - heat == pytest.approx(0, abs=1e-10 * (abs(power_in) + abs(stored) + heat))


@pytest.mark.parametrize("sub", CASES.values(), ids=CASES.keys())
def test_rates_of_forces_are_exact_and_forces_depend_on_states_alone(sub):
    """force_rate is the derivative of the force along the solution; no input moves a force at once.

    The load pressure refers to the return line, which has no rate, so only its rate is compared.
    """
    s, p, rng = symbolic(sub), list(values(sub).p.values()), np.random.default_rng(5)
    u, y = named(sub, "inputs", s.u), named(sub, "outputs", s.y)
    for name in [n for n in y if f"{n}_rate" in y]:
        assert "load_pressure" in name or not ca.depends_on(y[name], s.u)
        both = ca.Function("r", [s.x, s.u, s.p], [y[f"{name}_rate"], along(s, u, y[name])])
        for _ in range(20):
            shown, exact = (float(v) for v in both(*random_point(sub, rng), p))
            # exact identity, rounding only
            assert shown == pytest.approx(exact, rel=1e-12)


@pytest.mark.parametrize("sub", CASES.values(), ids=CASES.keys())
def test_started_at_rest_only_leakage_moves(sub):
    """Command zero, piston standing: after 1 s no chamber has changed by more than leakage explains."""
    u = values(sub).u | {"boom_holding_force": 5e4, "stick_holding_force": -2e4}
    model = join({"part": sub}, (), {n: (f"part.{n}",) for n in quantities(sub.inputs)})
    inputs = np.tile([u[n] for n in model.inputs], (11, 1))
    _, y = simulate(model, np.linspace(0, 1.0, 11), inputs, tolerance=1e-9)
    shown = dict(zip((n.removeprefix("part.") for n in model.output_names), y.T, strict=True))
    if sub.part == "swing":
        assert np.abs(shown["swing_torque"]).max() < 1e-3  # N.m: both sides alike; the integrator's 1e-9
    else:
        force = shown["boom_force"]
        # two edges leak 2 G P_s t into 2.6 L at a compliance of 1/beta, on areas of 0.011 m2 and 0.007 m2
        p = values(sub).p
        risen = 2 * p["valve_leakage"] * u["supply_pressure"] / 2.6e-3 * p["bulk_modulus"]
        assert force[0] == pytest.approx(5e4, rel=1e-12)
        assert np.abs(force - force[0]).max() < risen * 0.018
    for name in (n for n in shown if n.endswith("spool_position")):
        assert np.abs(shown[name]).max() < 1e-12  # share of the stroke; the integrator's rounding
    flows = [v for n, v in shown.items() if "valve_flow" in n or "swing_flow" in n]
    assert max(np.abs(q).max() for q in flows) < 1e-6  # m3/s: the leakage of an edge is 3e-7


def test_the_spool_starts_where_its_command_wants_it():
    """A start under command: spools in position and at rest, clipped at full stroke."""
    sub = CASES["boom_stick"]
    s, v = symbolic(sub), values(sub)
    u = v.u | {"boom_command": 4.0, "stick_command": -25.0}
    start = dict(
        zip(
            quantities(sub.states),
            s.initial()(list(v.x.values()), list(u.values()), list(v.p.values())).full(),
            strict=True,
        )
    )
    assert start["boom_spool_position"] == pytest.approx(0.4, rel=1e-15)
    assert start["stick_spool_position"] == -1.0
    assert start["boom_spool_speed"] == start["stick_spool_speed"] == 0.0


def test_both_detailed_drives_read_the_shared_numbers_of_their_part():
    """Oil, spools and valves are the same machine's: the numbers of swing and boom_stick agree."""
    one, other = values(CASES["swing"]).p, values(CASES["boom_stick"]).p
    shared = set(one) & set(other) - {"initial_preload"}
    assert len(shared) > 20
    assert {n: one[n] for n in shared} == {n: other[n] for n in shared}


# ---- the limit: stiff walls, no air, a fast spool, relief valves out of the way


PRELOAD = 8e6  # Pa: no line of the swing tears while its valve still opens


def limit(part: str, eps: float, length: float) -> tuple[dict[str, float], dict[str, float]]:
    """Numbers of detailed and of lumped with hoses of `length` times their own; eps scales what differs."""
    fine, usual = dict(values(CASES[part]).p), dict(values(LUMPED[part]).p)
    fine |= {
        "hose_wall_modulus": fine["hose_wall_modulus"] / eps,
        "air_share": eps * fine["air_share"],
        "spool_frequency": fine["spool_frequency"] / eps,
        "spool_speed": fine["spool_speed"] / eps,
        "relief_gain": 0.0,
        "anti_cavitation_gain": 0.0,
    }
    lines = ("line",) if part == "swing" else ("boom_hose", "stick_hose")
    for name in lines:
        fine[f"{name}_length"] *= length
        area = math.pi / 4 * fine[f"{name}_bore"] ** 2
        volume = area * fine[f"{name}_length"]
        usual[f"{name}_inertance"] = fine["density"] * fine[f"{name}_length"] / area
        if part == "swing":  # laminar friction out of the way: it lies on either side of the capacitance
            fine |= {"viscosity": 1e-7, "motor_volume": 1.5e-3 - volume, "initial_preload": PRELOAD}
            usual |= {"line_resistance": 1.0, "line_capacitance": 1.5e-3 / fine["bulk_modulus"]}
            usual["initial_preload"] = PRELOAD
        else:
            fine[f"{name}_resistance"] *= length
            usual[f"{name}_resistance"] = fine[f"{name}_resistance"]
            usual[f"{name}_capacitance"] = volume / fine["bulk_modulus"]
            # the laminar branch of lumped: R = C_R Q_t
            laminar = fine[f"{name}_resistance"] * fine["valve_transition_flow"]
            fine["viscosity"] = laminar * math.pi * fine[f"{name}_bore"] ** 4 / (128 * fine[f"{name}_length"])
    return fine, usual


@cache
def pressures(part: str, variant: str, eps: float, length: float) -> np.ndarray:
    """The pressures at the actuator while a valve opens and closes and the actuator moves along."""
    sub = CASES[part] if variant == "detailed" else LUMPED[part]
    p = limit(part, eps, length)[variant == "lumped"]
    u = values(sub).u | {"boom_holding_force": 5e4, "stick_holding_force": -2e4}
    model = join({"part": sub}, (), {n: (f"part.{n}",) for n in quantities(sub.inputs)})
    time = np.linspace(0, 0.4, 51)
    inputs = np.tile([u[n] for n in model.inputs], (time.size, 1))
    opened = np.sin(np.pi * np.clip((time - 0.02) / 0.3, 0, 0.8)) ** 2  # no kink: it would ring in the lines
    moved = {"boom_command": 5.0, "stick_command": -4.0, "swing_command": 4.0}
    moved |= {"boom_velocity": 0.1, "stick_velocity": -0.08, "swing_speed": 0.4}
    for name, most in moved.items():
        if name in model.inputs:
            inputs[:, model.inputs.index(name)] = most * opened
    _, y = simulate(model, time, inputs, np.array([p[n] for n in quantities(sub.parameters)]), 1e-10)
    names = ("swing_motor_pressure_a", "swing_motor_pressure_b")
    if part == "boom_stick":
        names = tuple(f"{a}_{s}_pressure" for a in ("boom", "stick") for s in ("head", "rod"))
    return y[:, [model.output_names.index(f"part.{n}") for n in names]]


def apart(a: np.ndarray, b: np.ndarray) -> float:
    """Largest distance [Pa] of any pressure, root mean square over time."""
    return float(np.sqrt(np.mean((a - b) ** 2, axis=0)).max())


SMALL = 1e-5  # eps that stands for zero: the floor is reached


@pytest.mark.parametrize("part", LUMPED)
def test_detailed_tends_to_lumped_with_order_one(part):
    """Compliant walls, air and spool time scaled by eps: the distance to the limit falls with eps.

    The limit is not `lumped` itself but T-lumps without walls and air: a floor that the next test measures.
    """
    floor = pressures(part, "detailed", SMALL, 0.25)
    distances = [apart(pressures(part, "detailed", eps, 0.25), floor) for eps in (0.04, 0.02, 0.01)]
    ratios = np.array(distances[:-1]) / distances[1:]
    # order one: the second-order term of the spool's delay is some percent of the first with eps = 0.04
    assert ratios == pytest.approx(2.0, rel=0.1)
    from_lumped = apart(floor, pressures(part, "lumped", 1.0, 0.25))
    assert from_lumped < 0.2 * distances[0]  # so the distance to `lumped` falls nearly as far


@pytest.mark.parametrize("part", LUMPED)
def test_the_floor_falls_with_the_square_of_the_hose_length(part):
    """What T- and L-lumps differ by once nothing else is left.

    One T-lump and an actuator of compliance C_a have the transfer 1/(1 + s^2 (I C/2 + I C_a) + ...) from
    valve to actuator, an L-lump 1/(1 + s^2 I (C + C_a)): the difference I C/2 goes with l^2, and so does
    that of the resistance, R C/2.
    """
    floors = [
        apart(pressures(part, "detailed", SMALL, k), pressures(part, "lumped", 1.0, k))
        for k in (1.0, 0.5, 0.25)
    ]
    ratios = np.array(floors[:-1]) / floors[1:]
    assert ratios == pytest.approx(
        4.0, rel=0.15
    )  # the terms in l^3 are a tenth of those in l^2 at full length


@pytest.mark.parametrize("part", LUMPED)
def test_the_python_lines_of_the_readme_run(part):
    """What the section `detailed` of the README shows: choosing lumps and friction."""
    readme = LUMPED[part].values.with_name("README.md").read_text(encoding="utf-8")
    (snippet,) = re.findall(r"```python\n(.*?)```", readme.partition("## detailed")[2], re.DOTALL)
    exec(compile(snippet, "README.md", "exec"), {})
