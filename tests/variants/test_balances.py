"""Every drive at random states: what any variant of swing, boom and stick must keep, whatever its circuit."""

from functools import cache
from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest
from equations.circuits_transcription import air
from kit.equations import Part, cavity, piston_areas

from fmus.boom_stick.detailed import detailed as detailed_boom_stick
from fmus.contract import quantities
from fmus.machine.parts import FAMILIES
from fmus.parameters import values
from fmus.swing.detailed import detailed as detailed_swing

PARTS = ("swing", "boom_stick")
DRIVES = {f"{part} {name}": sub for part in PARTS for name, sub in FAMILIES[part].items()} | {
    "swing, three lumps": detailed_swing(3),
    "boom_stick, different lumps": detailed_boom_stick({"boom": 1, "stick": 4}),
}
drives = pytest.mark.parametrize("name", DRIVES)


@cache
def drive(name: str) -> Part:
    """The equations of a drive."""
    return Part(DRIVES[name])


def random_point(part, rng):
    """States, and inputs by name, in and beyond the working range: cavities, open reliefs."""

    def draw(name, nominal):
        if "pressure" in name and not name.endswith("_rate"):
            return rng.choice([rng.uniform(-1.2e5, 1e5), rng.uniform(1e5, 3e7)])
        if name.endswith(("_opening", "_applied")):
            return rng.uniform(0, 1)
        if name.endswith("_position"):
            return rng.uniform(-1, 1) if "spool" in name else rng.uniform(0.1, 0.5)
        return rng.normal() * nominal

    x, u = (
        {n: draw(n, q.nominal) for n, q in quantities(group).items()}
        for group in (part.sub.states, part.sub.inputs)
    )
    return np.array([*x.values()]), u


@drives
def test_energy_balance_closes_to_rounding(name):
    """Power in + convected = d(stored)/dt + heat at random states, and no heat is negative."""
    part, rng = drive(name), np.random.default_rng(4)
    u, y = part.expressions["u"], part.expressions["y"]
    power = u["supply_pressure"] * y["supply_flow"] - u["tank_pressure"] * y["return_flow"]
    if part.sub.part == "swing":
        power -= y["swing_torque"] * u["swing_speed"]
    else:
        power += y["convected_power"] - sum(y[f"{a}_force"] * u[f"{a}_velocity"] for a in ("boom", "stick"))
    balance = part.of(power, part.along(y["stored_energy"]), y["dissipated_power"])
    for _ in range(100):
        x, given = random_point(part, rng)
        power_in, stored, heat = (b.item() for b in balance(x, **given))
        assert heat >= 0
        # exact identity; 1e-10 is 1e6 rounding errors of the largest term
        assert power_in - stored - heat == pytest.approx(0, abs=1e-10 * (abs(power_in) + abs(stored) + heat))


@drives
def test_rates_are_exact_and_forces_depend_on_states_alone(name):
    """A rate output is the derivative along the solution; no input moves a force or torque at once.

    The load pressure refers to the return line, which has no rate, so only its rate is compared. The torque
    of the lumped swing follows its speed: docs/design.md, "The cut between the FMUs".
    """
    part, rng = drive(name), np.random.default_rng(5)
    u, y = part.expressions["u"], part.expressions["y"]
    names = [n for n in y if f"{n}_rate" in y]
    assert f"{part.sub.part}_load_pressure" in names
    resistive = part.sub.variant == "lumped" and part.sub.part == "swing"
    for moved in names:
        if not moved.endswith("load_pressure"):
            followed = {n for n in u if ca.depends_on(y[moved], u[n])}
            assert followed <= ({"swing_speed", "tank_pressure"} if resistive else set())
        both = part.of(y[f"{moved}_rate"], part.along(y[moved]))
        for _ in range(20):
            x, given = random_point(part, rng)
            shown, exact = (v.item() for v in both(x, **given))
            # exact identity, rounding of flows over capacitances; of a load pressure also that of the foot
            # of its step
            room = {"rel": 1e-12} if part.sub.variant == "detailed" else {"rel": 1e-10, "abs": 1e-3}
            assert shown == pytest.approx(exact, **room), moved


@pytest.mark.parametrize("name", [n for n in DRIVES if n.endswith(("lumped", "quasistatic", "compensated"))])
def test_oil_is_neither_made_nor_lost(name):
    """What the supply gives and the tank does not get is compressed, in cavities, or swept by the piston."""
    part, rng = drive(name), np.random.default_rng(6)
    p = part.p
    for _ in range(100):
        x, u = random_point(part, rng)
        dx, y = part(x, **u)
        state, rate = (dict(zip(part.states, column, strict=True)) for column in (x, dx))
        capacitance, swept, aerated = {}, [], {}
        if part.sub.part == "swing":
            capacitance = {f"swing_pressure_{line}": p["line_capacitance"] for line in ("a", "b")}
            inside = np.pi / 4 * p["line_bore"] ** 2 * p["line_length"] + p["motor_volume"]
            aerated = dict.fromkeys(capacitance, inside)
        else:
            for a in ("boom", "stick"):
                head, rod = piston_areas(p, a)
                at, dead = u[f"{a}_position"], p[f"{a}_dead_volume"]
                volumes = {"head": dead + head * at, "rod": dead + rod * (p[f"{a}_stroke"] - at)}
                for side, volume in volumes.items():
                    # a compensated hose is a node of its own, before the counterbalance valve
                    own = f"{a}_{side}_valve_pressure" in state
                    hose = f"{a}_{side}_valve_pressure" if own else f"{a}_{side}_pressure"
                    chamber = f"{a}_{side}_pressure"
                    capacitance[chamber] = volume / p["bulk_modulus"]
                    capacitance[hose] = capacitance.get(hose, 0.0) + p[f"{a}_hose_capacitance"]
                    inside = np.pi / 4 * p[f"{a}_hose_bore"] ** 2 * p[f"{a}_hose_length"]
                    aerated |= {chamber: volume, hose: inside} if own else {}
                swept.append((head - rod) * u[f"{a}_velocity"])
        if "air_share" in p:
            for n, volume in aerated.items():
                capacitance[n] += volume * air(SimpleNamespace(**p), state[n])
        filled = [(c + cavity(state[n])) * rate[n] for n, c in capacitance.items()]
        terms = [y["supply_flow"], -y["return_flow"], *(-q for q in (*filled, *swept))]
        # exact identity; rounding of the largest term, which a cavity makes large
        assert sum(terms) == pytest.approx(0, abs=1e-11 * sum(map(abs, terms)))


@pytest.mark.parametrize(("variant", "least"), [("detailed", 20), ("compensated", 12)])
def test_both_drives_read_the_shared_numbers_of_their_machine(variant, least):
    """Oil, spools, valves and compensators are the same machine's: swing and boom_stick agree."""
    one, other = (values(FAMILIES[part][variant]).p for part in PARTS)
    shared = set(one) & set(other) - {"initial_preload"}
    assert len(shared) > least
    assert {n: one[n] for n in shared} == {n: other[n] for n in shared}
