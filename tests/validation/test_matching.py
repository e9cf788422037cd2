"""The run of one FMU under the names of a reference for a system of several."""

import numpy as np

from orchestrator.data.trace import Trace
from orchestrator.results.validation import by_variable

TIME = np.array([0.0, 1.0])
RUN = Trace(TIME, {"all.angle": TIME, "all.flow": 2 * TIME, "all.own": 3 * TIME}, {"all.angle": "rad"})


def test_component_of_a_wanted_name_does_not_count():
    """The signal, its values and its unit get the wanted name; others keep theirs."""
    found = by_variable(RUN, ["arm.angle", "arm.angle"])
    assert set(found.signals) == {"arm.angle", "all.flow", "all.own"}
    np.testing.assert_array_equal(found["arm.angle"], TIME)
    assert found.units == {"arm.angle": "rad"}


def test_two_wanted_names_of_one_variable_stay_unknown():
    """One signal is not compared with the flows of two components."""
    assert set(by_variable(RUN, ["pump.flow", "motor.flow"]).signals) == set(RUN.signals)
