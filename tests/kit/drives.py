"""Drives at random states: points in and beyond their working range, ports, balance of power."""

from collections.abc import Callable, Iterator

import casadi as ca
import numpy as np
import pytest

from fmus.contract import quantities
from kit.equations import Part


def random_point(part: Part, rng: np.random.Generator) -> tuple[np.ndarray, dict[str, float]]:
    """States, and inputs by name, in and beyond the working range: cavities, open reliefs."""

    def draw(name: str, nominal: float) -> float:
        if "pressure" in name and not name.endswith("_rate"):
            return rng.choice([rng.uniform(-1.2e5, 1e5), rng.uniform(1e5, 3e7)])
        if name == "oil_temperature":
            return rng.uniform(240.0, 400.0)
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


def ports(part: Part) -> Iterator[tuple[str, str]]:
    """Force and velocity of each cylinder, torque and speed of each motor."""
    for name, motion in (("force", "velocity"), ("torque", "speed")):
        axes = [n.removesuffix(f"_{motion}") for n in part.inputs if n.endswith(f"_{motion}")]
        yield from ((f"{axis}_{name}", f"{axis}_{motion}") for axis in axes)


def closing_balance(part: Part, *more: ca.SX) -> Callable[..., list[float]]:
    """(x, **inputs) -> heat, more: power in + convected = d(stored)/dt + heat, and heat >= 0."""
    u, y = part.expressions["u"], part.expressions["y"]
    power = u["supply_pressure"] * y["supply_flow"] - u["tank_pressure"] * y["return_flow"]
    power += y.get("convected_power", 0) - sum(y[effort] * u[motion] for effort, motion in ports(part))
    balance = part.of(power, part.along(y["stored_energy"]), y["dissipated_power"], *more)

    def at(x: np.ndarray, **inputs: float) -> list[float]:
        power_in, stored, heat, *others = (b.item() for b in balance(x, **inputs))
        assert heat >= 0
        # exact identity; 1e-10 is 1e6 rounding errors of the largest term
        assert power_in - stored - heat == pytest.approx(0, abs=1e-10 * (abs(power_in) + abs(stored) + heat))
        return [heat, *others]

    return at
