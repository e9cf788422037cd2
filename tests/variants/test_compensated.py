"""The compensated drives: balances, exact rates, rest, and the closed forms of their circuits."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from fmus.contract import quantities, symbolic
from fmus.machine.parts import FAMILIES
from fmus.parameters import values

CASES = {part: FAMILIES[part]["compensated"] for part in ("swing", "boom_stick")}


def named(sub, group, column):
    """Expressions by name."""
    return dict(zip(quantities(getattr(sub, group)), ca.vertsplit(column), strict=True))


def along(s, u, value):
    """d/dt of an expression along the solution: inputs move with their rates, positions with velocities."""
    rate = ca.jtimes(value, s.x, s.dx)
    for name in u:
        source = name.replace("position", "velocity") if name.endswith("_position") else f"{name}_rate"
        if source != name and source in u:
            rate += ca.jacobian(value, u[name]) * u[source]
    return rate


def random_point(sub, rng):
    """States and inputs in and beyond the working range: cavitation, open reliefs, commands to both sides."""

    def draw(name, nominal):
        if "pressure" in name and not name.endswith("_rate"):
            return rng.choice([rng.uniform(-1.2e5, 1e5), rng.uniform(1e5, 3e7)])
        if name.endswith(("_opening", "_applied")):
            return rng.uniform(0, 1)
        if name.endswith("_position"):
            return rng.uniform(0.1, 0.5)
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
    for _ in range(200):
        power_in, stored, heat = (float(b) for b in balance(*random_point(sub, rng), p))
        assert heat >= 0
        # exact identity; 1e-10 is 1e6 rounding errors of the largest term
        assert power_in - stored - heat == pytest.approx(0, abs=1e-10 * (abs(power_in) + abs(stored) + heat))


def cavity(pressure):
    """C_cav [m3/Pa], docs/equations.md section 3."""
    return 1e-12 * np.exp(np.clip((-20e3 - pressure) / 5e3, -60, 40))


@pytest.mark.parametrize("sub", CASES.values(), ids=CASES.keys())
def test_oil_is_neither_made_nor_lost(sub):
    """What the supply gives and the tank does not get is compressed, in cavities, or swept by the piston."""
    s, v, rng = symbolic(sub), values(sub), np.random.default_rng(6)
    p, f = v.p, s.function()
    for _ in range(100):
        x, u = random_point(sub, rng)
        dx, y = (r.full()[:, 0] for r in f(x, u, list(p.values())))
        state, rate, given, out = (
            dict(zip(quantities(g), column, strict=True))
            for g, column in ((sub.states, x), (sub.states, dx), (sub.inputs, u), (sub.outputs, y))
        )
        terms = [out["supply_flow"], -out["return_flow"]]
        if sub.part == "swing":
            for n in ("swing_pressure_a", "swing_pressure_b"):
                terms.append(-(p["line_capacitance"] + cavity(state[n])) * rate[n])
        else:
            for a in ("boom", "stick"):
                head = np.pi / 4 * p[f"{a}_bore"] ** 2
                rod = head - np.pi / 4 * p[f"{a}_rod"] ** 2
                x_a = given[f"{a}_position"]
                volumes = {
                    "head": p[f"{a}_dead_volume"] + head * x_a,
                    "rod": p[f"{a}_dead_volume"] + rod * (p[f"{a}_stroke"] - x_a),
                }
                for side, volume in volumes.items():
                    n, line = f"{a}_{side}_pressure", f"{a}_{side}_valve_pressure"
                    terms.append(-(volume / p["bulk_modulus"] + cavity(state[n])) * rate[n])
                    terms.append(-(p[f"{a}_hose_capacitance"] + cavity(state[line])) * rate[line])
                terms.append(-(head - rod) * given[f"{a}_velocity"])
        # exact identity; rounding of the largest term, which a cavity makes large
        assert sum(terms) == pytest.approx(0, abs=1e-11 * sum(map(abs, terms)))


@pytest.mark.parametrize("sub", CASES.values(), ids=CASES.keys())
def test_rates_are_exact_and_forces_depend_on_states_alone(sub):
    """A rate output is the derivative along the solution; no input moves a force or torque at once."""
    s, p, rng = symbolic(sub), list(values(sub).p.values()), np.random.default_rng(5)
    u, y = named(sub, "inputs", s.u), named(sub, "outputs", s.y)
    names = [n for n in y if f"{n}_rate" in y]
    assert f"{sub.part}_load_pressure" in names
    for name in names:
        if not name.endswith("load_pressure"):
            assert not ca.depends_on(y[name], s.u)
        both = ca.Function("r", [s.x, s.u, s.p], [y[f"{name}_rate"], along(s, u, y[name])])
        for _ in range(20):
            shown, exact = (float(v) for v in both(*random_point(sub, rng), p))
            # exact identity, rounding only
            assert shown == pytest.approx(exact, rel=1e-10, abs=1e-3)


def test_both_compensated_drives_read_the_shared_numbers_of_their_machine():
    """Oil, valves and compensators are the same machine's: the numbers of swing and boom_stick agree."""
    one, other = values(CASES["swing"]).p, values(CASES["boom_stick"]).p
    shared = set(one) & set(other) - {"initial_preload"}
    assert len(shared) > 12
    assert {n: one[n] for n in shared} == {n: other[n] for n in shared}
