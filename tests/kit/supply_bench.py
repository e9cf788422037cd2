"""A test bench for a supply: a load that takes oil and tells its pressure, integration, rest, by names."""

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import NamedTuple

import casadi as ca
import numpy as np

from fmus.supply import VARIANTS
from kit.equations import Part

L_MIN = 1e-3 / 60  # m3/s


class Load(NamedTuple):
    """An orifice of the area that takes `gain` sqrt(dp), from the supply line to a pressure of the load."""

    gain: float
    pressure: float = 0.0


class Bench(Part):
    """One variant of the supply, its parameters and inputs given as lists.

    The heat capacity is infinite, because the closed forms of the tests have one temperature of the oil.
    """

    def __init__(self, variant: str) -> None:
        super().__init__(VARIANTS[variant], heat_capacity=1e30)

    def constants(self, **changes: float) -> list[float]:
        """The parameters in order, some of them changed."""
        assert set(changes) <= set(self.p)
        return list((self.p | changes).values())

    def row(self, **inputs: float) -> list[float]:
        """The inputs in order; those that are not given are zero."""
        return [inputs.get(name, 0.0) for name in self.inputs]

    def rest(self, p: list[float]) -> np.ndarray:
        """The state at the start."""
        return self.model.initial()([0.0] * len(self.states), self.row(), p).full()[:, 0]

    def state(
        self, pressures: Sequence[float], strokes: Sequence[float] = (0.0, 0.0), **named: float
    ) -> list[float]:
        """States in order: the named ones, the others from these pools, as many as there are."""
        pools = {"pressure": iter(pressures), "stroke": iter(strokes)}
        return [named[n] if n in named else next(pools[n.rpartition("_")[2]]) for n in self.states]

    def rates(self, x: Sequence[float], u: list[float], p: list[float]) -> dict[str, float]:
        """Time derivatives of the states by name."""
        return dict(zip(self.states, self.function(x, u, p)[0].full()[:, 0], strict=True))

    def show(self, x: Sequence[float], u: list[float], p: list[float]) -> dict[str, float]:
        """All outputs at a state and inputs."""
        return dict(zip(self.outputs, map(float, self.function(x, u, p)[1].full()[:, 0]), strict=True))

    def violated(self, p: list[float]) -> list[str]:
        """Requirements that are not fulfilled at the start."""
        m = self.model
        found = ca.Function("r", [m.x, m.u, m.p], [m.require])(self.rest(p), self.row(), p)
        return [s for s, v in zip(m.statements, found.full()[:, 0], strict=True) if not v > 0]

    @cached_property
    def balance(self) -> ca.Function:
        """(x, u, p) -> power in, power used or stored, heat [W]."""
        m = self.model
        y = self.expressions["y"]
        rate = ca.jtimes(y["stored_energy"], m.x, m.dx)
        given = y["engine_power"] + y["tank_pressure"] * y["return_flow"]
        used = y["supply_pressure"] * y["supply_flow"] + rate + y["dissipated_power"]
        return ca.Function("b", [m.x, m.u, m.p], [given, used, y["dissipated_power"]])

    @cached_property
    def jacobian(self) -> ca.Function:
        """(x, u, p) -> dx, y, d(dx)/dx."""
        m = self.model
        return ca.Function("j", [m.x, m.u, m.p], [m.dx, m.y, ca.jacobian(m.dx, m.x)])

    def taken(self, load: Load, pressure: float) -> list[float]:
        """Inputs while swing takes oil at a supply pressure, against its load, and gives it back."""
        flow = float(orifice(load.gain, pressure - load.pressure))
        return self.row(supply_flow_swing=flow, return_flow_swing=flow, swing_load_pressure=load.pressure)

    def through(
        self, loads: Sequence[Load], p: list[float], hold: float, samples: int = 40
    ) -> tuple[np.ndarray, dict]:
        """Time (n,) and outputs (n,) from rest through a row of loads, each of them for `hold` seconds."""
        n, at = len(self.states), self.at("supply_pressure")
        z, load = ca.SX.sym("z", n), ca.SX.sym("load", 2)
        flow = orifice(load[0], z[at] * self.nominal[at] - load[1])
        flows = {name: flow for name in self.inputs if name.endswith("flow_swing")}
        given = flows | {"swing_load_pressure": load[1]}
        u = ca.vertcat(*(given.get(name, 0) for name in self.inputs))
        rate = self.function(z * self.nominal, u, ca.DM(p))[0] / self.nominal
        grid = np.linspace(0, hold, samples + 1)
        options = {"reltol": 1e-10, "abstol": 1e-10, "max_num_steps": 100_000}
        solver = ca.integrator("s", "cvodes", {"x": z, "p": load, "ode": rate}, 0.0, grid[1:], options)
        x = self.rest(p) / self.nominal
        rows, times = [], []
        for k, one in enumerate(loads):
            path = solver(x0=x, p=list(one))["xf"].full()
            for column in path.T * self.nominal:
                rows.append(self.show(column, self.taken(one, column[at]), p))
            times += list(grid[1:] + k * hold)
            x = path[:, -1]
        return np.array(times), {name: np.array([row[name] for row in rows]) for name in self.outputs}

    def settled(self, load: Load, **changes: float) -> Mapping[str, float]:
        """Outputs after four seconds with one load; the slowest time constant is a few tenths."""
        _, y = self.through([load], self.constants(**changes), 4.0, 2)
        return {name: float(v[-1]) for name, v in y.items()}


def orifice(gain, pressure):
    """Flow through an orifice of C_R = 1 / gain^2."""
    return gain * pressure / (pressure**2 + 1e5**2) ** 0.25
