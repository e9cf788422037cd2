"""Model Exchange as importers do it: calls around the initialisation, inputs that change unseen."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from kit.fmu import Fmu

STATES = ("pressure", "flow", "heat")


@pytest.fixture(params=[2, 3])
def chamber(request, open_fmu) -> Callable[..., Fmu]:
    """Makes an instance of the chamber in event mode; its pressure starts at half the supply's."""
    return lambda begin=Fmu.initialise: begin(open_fmu("chamber", "me", request.param))


# ---- around the initialisation


def test_parameters_and_inputs_may_be_set_after_the_initialisation(chamber):
    """Calculated start values are computed anew until continuous-time mode is entered."""
    fmu = chamber()
    fmu.set(supply=1e7, conductance=2e-11)
    # initial: pressure = supply / 2, flow = conductance supply / 2; rounding of one product
    np.testing.assert_allclose(fmu.get(*STATES), [5e6, 1e-4, 0.0], rtol=1e-15)
    fmu.update()
    fmu.set(conductance=1e-11)
    np.testing.assert_allclose(fmu.get(*STATES), [5e6, 5e-5, 0.0], rtol=1e-15)
    fmu.fmu.enterContinuousTimeMode()
    fmu.refuses(lambda: fmu.set(conductance=2e-11))
    fmu.fmu.enterEventMode()
    fmu.refuses(lambda: fmu.set(conductance=2e-11))


@pytest.mark.parametrize("told", [Fmu.update, Fmu.continuous_states], ids=["update", "states"])
def test_start_values_that_the_importer_has_do_not_follow_inputs(chamber, told):
    """An input may jump at the initial event without changing the states that the importer has read."""
    fmu = chamber()
    told(fmu)
    before = fmu.get(*STATES).tolist()
    fmu.set(supply=1.2e7)
    assert fmu.get(*STATES).tolist() == before
    state = fmu.state()
    fmu.set(supply=1.3e7)
    fmu.restore(state)
    assert fmu.get(*STATES).tolist() == before
    assert fmu["supply"] == 1.2e7
    fmu.fmu.enterContinuousTimeMode()
    assert fmu.continuous_states() == before


def test_states_may_be_set_in_event_mode_and_end_the_initialisation(chamber):
    """States set as OpenModelica's import does do not change when inputs are set afterwards."""
    fmu = chamber()
    fmu.update()
    fmu.set_continuous_states(1e6, 2e-5, 3.0)
    fmu.set(supply=1e7)
    assert fmu.get(*STATES).tolist() == [1e6, 2e-5, 3.0]
    fmu.refuses(lambda: fmu.set(conductance=1e-11))
    fmu.fmu.enterContinuousTimeMode()
    assert fmu.get(*STATES).tolist() == [1e6, 2e-5, 3.0]


def test_partial_derivatives_are_of_the_running_model_after_the_initialisation(chamber):
    """States are knowns of directional and adjoint derivatives, although parameters may still be set."""
    fmu = chamber()
    fmu.update()
    ((found,),) = fmu.derivative(["der_heat"], ["pressure"])
    assert found == pytest.approx(2 * 1e-11 * 1e7, rel=1e-12)  # of conductance pressure^2; rounding
    if fmu.version == 3:  # FMI 2.0 has no adjoint derivatives
        heat, pressure = fmu.references["der_heat"], fmu.references["pressure"]
        assert fmu.fmu.getAdjointDerivative([heat], [pressure], [1.0]) == [found]


# ---- inputs that are held


def test_an_input_that_was_held_and_jumps_asks_for_an_event(chamber):
    """If all derivatives were computed with the old input, the solver must restart once."""
    fmu = chamber(Fmu.start)
    fmu.derivatives()
    assert not fmu.completed()
    fmu.set(supply=1.5e7)
    assert fmu.completed()
    fmu.fmu.enterEventMode()
    assert fmu.update()[3]  # some importers start anew only if states have changed
    assert not fmu.update()[3]
    fmu.fmu.enterContinuousTimeMode()
    fmu.derivatives()
    assert not fmu.completed()


def test_a_solver_that_is_ahead_of_the_output_is_told_as_well(chamber):
    """A solver that interpolates at outputs computes no derivative in between; it must restart too."""
    fmu = chamber(Fmu.start)
    fmu.derivatives()
    for _ in range(3):  # outputs inside one step of the solver
        assert not fmu.completed()
    fmu.set(supply=1.5e7)
    assert fmu.completed()


def test_inputs_that_move_with_the_time_ask_for_nothing(chamber):
    """No restart if the solver evaluates derivatives ahead, at each stage or at the end of the step."""
    fmu = chamber(Fmu.start)
    for k in range(1, 4):
        fmu.set(supply=2e7 + 1e5 * k)
        fmu.derivatives()
        assert not fmu.completed()
        fmu.set(supply=2e7 + 1e5 * k - 5e4)  # an output between, interpolated
        assert not fmu.completed()


@pytest.mark.parametrize("back", ["state", "reset"])
def test_a_restored_state_and_a_reset_ask_for_nothing(chamber, back):
    """A restored state or a reset may come with other inputs, and while an event is pending: no restart."""
    fmu = chamber(Fmu.start)
    state = fmu.state()
    fmu.derivatives()
    fmu.set(supply=1e7)
    assert fmu.completed()
    if back == "state":
        fmu.restore(state)
        assert not fmu.completed()
        fmu.fmu.enterEventMode()
    else:
        fmu.fmu.reset()
        fmu.initialise()
    assert not fmu.update()[3]


def test_the_rate_of_an_input_asks_for_nothing(open_fmu):
    """Derivatives do not depend on a rate input, because the importer's solver varies the input itself."""
    fmu = open_fmu("path", "me").start()
    for name, event in (("velocity", False), ("acceleration", False), ("position", True)):
        fmu.derivatives()
        fmu.set(**{name: 2.0})
        assert fmu.completed() is event


def test_zero_with_the_other_sign_is_no_change(chamber):
    """0.0 and -0.0 are one value."""
    fmu = chamber(Fmu.start)
    fmu.set(supply=0.0)
    fmu.derivatives()
    fmu.completed()
    fmu.derivatives()
    fmu.set(supply=-0.0)
    assert not fmu.completed()
