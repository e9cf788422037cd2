"""Sensitivities with respect to the points of opening curves, in the variants of a drive that have them."""

import numpy as np
import pytest
from equations.test_opening_curve import numbers_of
from kit.equations import EDGES

from fmus import swing
from fmus.identification.refinement.compiled_model import CompiledModel
from fmus.parameters import values

OUTPUTS = ("swing_pressure_a", "swing_torque", "supply_flow")
FREE = (
    *("valve_area", "valve_pa_opening_3", "valve_pa_opening_4", "valve_pa_command_3"),
    *("valve_bt_opening_4", "valve_bt_command_1", "valve_bt_command_2"),
)


@pytest.mark.parametrize("variant", ["lumped", "quasistatic", "detailed"])
def test_derivatives_by_points_are_those_of_differences(variant):
    """A command that sweeps the first four points of P-A and B-T, at a speed that follows it."""
    sub = swing.VARIANTS[variant]
    numbers = values(sub)
    for edge in EDGES:
        numbers.p.update(numbers_of(edge))
    model = CompiledModel(sub, OUTPUTS, FREE, numbers, tolerance=1e-9)
    time = np.linspace(0.0, 0.4, 41)
    rows = np.tile([numbers.u[name] for name in model.inputs], (time.size, 1))
    rows[:, model.inputs.index("swing_command")] = 4.5 * time / 0.4
    rows[:, model.inputs.index("swing_speed")] = 0.2 * (time / 0.4) ** 2

    def simulated(p, sensitivities=False):
        x, _ = model.start(p, rows[0])
        return model.segment(x, p, time, rows, sensitivities)

    exact = simulated(model.p0, sensitivities=True).y_p
    for j, name in enumerate(FREE):
        step = 1e-4 * model.p0[j]
        change = step * (np.arange(len(FREE)) == j)
        ahead, behind = (simulated(model.p0 + sign * change).y for sign in (1, -1))
        difference = (ahead - behind) / (2 * step)
        scale = np.abs(difference).max(axis=0)
        assert (scale > 0).all(), name
        # the error of the difference, with kinks of the second derivative at the points
        assert (np.abs(exact[:, :, j] - difference).max(axis=0) < 1e-3 * scale).all(), name
