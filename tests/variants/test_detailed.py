"""The detailed drives: the limit in which they are the lumped ones. Balances: test_balances.py."""

import math
from functools import cache

import casadi as ca
import numpy as np
import pytest
from kit.equations import Part

from fmus import boom_stick, swing
from fmus.parameters import values

LUMPED = {"swing": swing.VARIANTS["lumped"], "boom_stick": boom_stick.VARIANTS["lumped"]}
DETAILED = {"swing": swing.VARIANTS["detailed"], "boom_stick": boom_stick.VARIANTS["detailed"]}
HELD = {"boom_holding_force": 5e4, "stick_holding_force": -2e4}  # N


def part_of(sub, **numbers):
    """A drive whose cylinders hold a load."""
    part = Part(sub, **numbers)
    part.u |= {n: force for n, force in HELD.items() if n in part.u}
    return part


def test_the_spool_starts_where_its_command_wants_it():
    """A start under command: spools in position and at rest, clipped at full stroke."""
    part = part_of(DETAILED["boom_stick"])
    x = part.start({"boom_command": 4.0, "stick_command": -25.0})
    start = dict(zip(part.states, x, strict=True))
    assert start["boom_spool_position"] == pytest.approx(0.4, rel=1e-15)
    assert start["stick_spool_position"] == -1.0
    assert start["boom_spool_speed"] == start["stick_spool_speed"] == 0.0


# ---- the limit: stiff walls, no air, a fast spool, relief valves out of the way

# few lumps: what differs from `lumped` is the same for one lump and for many
FEW = {
    "swing": DETAILED["swing"],
    "boom_stick": boom_stick.variants(lumps={"boom": 1, "stick": 2})["detailed"],
}
PRELOAD = 8e6  # Pa: no line of the swing tears while its valve still opens
SMALL = 1e-5  # eps that stands for zero: the floor is reached


def limit(part: str, eps: float, length: float) -> tuple[dict[str, float], dict[str, float]]:
    """Numbers of detailed and of lumped with hoses of `length` times their own; eps scales what differs."""
    fine, usual = dict(values(DETAILED[part]).p), dict(values(LUMPED[part]).p)
    fine |= {
        "hose_wall_modulus": fine["hose_wall_modulus"] / eps,
        "air_share": eps * fine["air_share"],
        "spool_frequency": fine["spool_frequency"] / eps,
        "spool_speed": fine["spool_speed"] / eps,
        "relief_gain": 0.0,
        "anti_cavitation_area": 0.0,
    }
    lines = ("line",) if part == "swing" else ("boom_hose", "stick_hose")
    for name in lines:
        fine[f"{name}_length"] *= length
        usual[f"{name}_length"] *= length
        area = math.pi / 4 * fine[f"{name}_bore"] ** 2
        volume = area * fine[f"{name}_length"]
        usual[f"{name}_inertance"] = fine["density"] * fine[f"{name}_length"] / area
        if part == "swing":  # laminar friction out of the way: it lies on either side of the capacitance
            fine |= {"viscosity": 1e-7, "motor_volume": 1.5e-3 - volume, "initial_preload": PRELOAD}
            usual |= {"line_resistance": 1.0, "line_capacitance": 1.5e-3 / fine["bulk_modulus"]}
            usual |= {"initial_preload": PRELOAD, "viscosity": 1e-7}
        else:
            fine[f"{name}_resistance"] *= length
            usual[f"{name}_resistance"] = fine[f"{name}_resistance"]
            usual[f"{name}_capacitance"] = volume / fine["bulk_modulus"]
    return fine, usual


@cache
def pressures(part: str, variant: str, eps: float, length: float) -> np.ndarray:
    """The pressures at the actuator while a valve opens and closes and the actuator moves along."""
    sub = FEW[part] if variant == "detailed" else LUMPED[part]
    drive = part_of(sub, **limit(part, eps, length)[variant == "lumped"])
    moved = {"boom_command": 5.0, "stick_command": -4.0, "swing_command": 4.0}
    moved |= {"boom_velocity": 0.1, "stick_velocity": -0.08, "swing_speed": 0.4}

    def opened(t):
        """No jump and no kink at the start: they would ring in the lines."""
        share = ca.sin(ca.pi * ca.fmin(ca.fmax((t - 0.02) / 0.3, 0), 0.8)) ** 2
        return {n: most * share for n, most in moved.items() if n in drive.u}

    y = drive.follow(np.linspace(0, 0.4, 51), opened, 1e-9)
    names = ("swing_motor_pressure_a", "swing_motor_pressure_b")
    if part == "boom_stick":
        names = tuple(f"{a}_{s}_pressure" for a in ("boom", "stick") for s in ("head", "rod"))
    return np.column_stack([y[name] for name in names])


def apart(a: np.ndarray, b: np.ndarray) -> float:
    """Largest distance [Pa] of any pressure, root mean square over time."""
    return float(np.sqrt(np.mean((a - b) ** 2, axis=0)).max())


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
    both = (("detailed", SMALL), ("lumped", 1.0))
    floors = [apart(*(pressures(part, *one, k) for one in both)) for k in (1.0, 0.5, 0.25)]
    changes = -np.diff(floors)  # free of what does not depend on l: 17 Pa of the spool at the swing
    ratios = changes[:-1] / changes[1:]
    # the terms in l^3 are a tenth of those in l^2 at full length
    assert ratios == pytest.approx(4.0, rel=0.15)
