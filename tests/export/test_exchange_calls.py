"""Model Exchange as importers do it: calls around the initialisation, inputs that change unseen."""

from collections.abc import Callable, Iterator

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
    """States are knowns of directional derivatives, although parameters may still be set."""
    fmu = chamber()
    fmu.update()
    ((found,),) = fmu.derivative(["der_heat"], ["pressure"])
    assert found == pytest.approx(2 * 1e-11 * 1e7, rel=1e-12)  # of conductance pressure^2; rounding


# ---- inputs that are held


def derivatives_at(fmu: Fmu, *times: float) -> None:
    """Calls of a solver with the present inputs."""
    for time in times:
        fmu.fmu.setTime(time)
        fmu.derivatives()


def test_an_input_that_was_held_and_jumps_asks_for_an_event(chamber):
    """If all derivatives of a step were computed with the old input, the solver must restart once."""
    fmu = chamber(Fmu.start)
    derivatives_at(fmu, 0.0, 1e-3)
    assert not fmu.completed()
    fmu.set(supply=1.5e7)
    assert fmu.completed()
    fmu.fmu.enterEventMode()
    assert fmu.update()[3]  # some importers start anew only if states have changed
    assert not fmu.update()[3]
    fmu.fmu.enterContinuousTimeMode()
    derivatives_at(fmu, 1e-3, 2e-3)
    assert not fmu.completed()


def test_a_solver_that_is_ahead_of_the_output_is_told_as_well(chamber):
    """A solver that interpolates at outputs must restart too; 0.0 and -0.0 are one value."""
    fmu = chamber(Fmu.start)
    derivatives_at(fmu, 0.0, 5e-3)
    for _ in range(3):  # outputs inside one step of the solver
        assert not fmu.completed()
    fmu.set(supply=1.5e7)
    assert fmu.completed()
    fmu = chamber(Fmu.start)
    fmu.set(supply=0.0)
    derivatives_at(fmu, 0.0, 1e-3)
    assert not fmu.completed()
    fmu.set(supply=-0.0)
    assert not fmu.completed()


def ahead(fmu: Fmu, u: Callable[[float], float], time: float, step: float) -> Iterator[bool]:
    """A solver evaluates at the end of its step and completes it; outputs between are interpolated."""
    fmu.set(supply=u(time + step))
    derivatives_at(fmu, time + step)
    yield fmu.completed()
    fmu.set(supply=u(time + step / 2))
    yield fmu.completed()


def before_each(fmu: Fmu, u: Callable[[float], float], time: float, step: float) -> Iterator[bool]:
    """A step is completed at each evaluation, before the derivatives; the first one is a tiny step ahead."""
    for at in (time, time + 1e-14, time + step / 2, time + step, time + step):
        fmu.fmu.setTime(at)
        fmu.set(supply=u(at))
        yield fmu.completed()
        fmu.derivatives()


def stages(fmu: Fmu, u: Callable[[float], float], time: float, step: float) -> Iterator[bool]:
    """A Runge-Kutta method with two stages at one time."""
    for at in (time, time + step / 2, time + step / 2, time + step):
        fmu.set(supply=u(at))
        derivatives_at(fmu, at)
    yield fmu.completed()


def euler(fmu: Fmu, u: Callable[[float], float], time: float, step: float) -> Iterator[bool]:
    """One evaluation for each step; the inputs at its end are set before it is completed."""
    derivatives_at(fmu, time)
    fmu.fmu.setTime(time + step)
    fmu.set(supply=u(time + step))
    yield fmu.completed()


ORDERS = pytest.mark.parametrize("order", [ahead, before_each, stages, euler])


@ORDERS
def test_inputs_that_move_with_the_time_ask_for_nothing(chamber, order):
    """In whichever order an importer evaluates, sets inputs and completes steps."""
    fmu = chamber(Fmu.start)
    fmu.set(supply=2e7)
    asked = [e for k in range(20) for e in order(fmu, lambda t: 2e7 * (1 + np.sin(9 * t)), 0.01 * k, 0.01)]
    assert not any(asked)


@ORDERS
def test_time_passes_between_two_requests(chamber, order):
    """An importer that enters event mode at each request gets through jumps and kinks of an input."""

    def u(t: float) -> float:
        return 2e7 if t < 0.05 else 1e7 if t < 0.1 else 1e7 + 1e8 * (t - 0.1)

    fmu = chamber(Fmu.start)
    fmu.set(supply=2e7)
    requests = []
    for k in range(20):
        for asked in order(fmu, u, 0.01 * k, 0.01):
            if asked:
                requests.append(k)
                fmu.fmu.enterEventMode()
                fmu.update()
                fmu.fmu.enterContinuousTimeMode()
    assert len(requests) <= 2  # at most one at each jump or kink
    assert len(set(requests)) == len(requests)


@pytest.mark.parametrize("back", ["state", "reset"])
def test_a_restored_state_and_a_reset_ask_for_nothing(chamber, back):
    """A restored state or a reset may come with other inputs, and while an event is pending: no restart."""
    fmu = chamber(Fmu.start)
    state = fmu.state()
    derivatives_at(fmu, 0.0, 1e-3)
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
        derivatives_at(fmu, 0.0, 1e-3)
        fmu.set(**{name: 2.0})
        assert fmu.completed() is event
