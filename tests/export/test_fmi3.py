"""FMI 3.0: what it has beyond FMI 2.0, on toys; the equations behind are tested with FMI 2.0."""

import ctypes
import math
from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest
from fmpy.fmi1 import FMICallException
from kit.any_fmu.models import WIDTHS
from kit.fmu import Fmu

ERROR = 3


def step(fmu: Fmu, time: float, length: float) -> tuple[bool, float]:
    """A step: is this an early return, and the time reached."""
    _, _, early, reached = fmu.fmu.doStep(time, length)
    return early, reached


# ---- inside a step -----------------------------------------------------------------------------------


def watching(act: Callable[[float], float | None]) -> Callable[..., None]:
    """An intermediate update: `act` is called with the time, and may return when to stop."""

    def update(_env, time, _set, _get, _finished, can_return, requested, when) -> None:
        stop = act(time)
        if stop is not None and can_return:
            requested[0], when[0] = True, stop

    return update


def test_values_inside_a_step_lie_on_the_solution(open_fmu):
    """Outputs that are read between inner steps have the values of that time."""
    seen: list[tuple[float, float, float]] = []
    see = watching(lambda t: seen.append((t, *fmu.get("level", "time"))))
    fmu = open_fmu("decay", fmi=3, intermediateUpdate=see, earlyReturnAllowed=False).start()
    step(fmu, 0.0, 2.0)
    times, levels, own = map(list, zip(*seen, strict=True))
    assert len(times) > 5
    assert times == own == sorted(times)
    assert times[-1] == 2.0
    # the solver's tolerance 1e-6 per step, over a handful of steps
    np.testing.assert_allclose(levels, np.exp(-2.0 * np.array(times)), atol=1e-5)


def test_inputs_set_inside_a_step_hold_from_there_on(open_fmu):
    """A staircase set at the inner steps is integrated as such, and its last value is kept."""
    corners: list[tuple[float, float]] = [(0.0, 0.0)]

    def stair(time: float) -> None:
        fmu.set(position=10.0 * time)
        corners.append((time, 10.0 * time))

    fmu = open_fmu("path", fmi=3, intermediateUpdate=watching(stair)).start()
    # a tight first proposal makes several inner steps: the velocity port bends the input
    fmu.set(velocity=0.0, acceleration=0.0)
    for k in range(4):
        step(fmu, 0.25 * k, 0.25)
    exact = sum(value * (after - time) for (time, value), (after, _) in pairwise(corners))
    assert len(corners) >= 5
    assert fmu["integral"] == pytest.approx(exact, rel=1e-12)  # RODAS integrates constants exactly
    assert fmu["position"] == 10.0 * corners[-1][0]


def test_untouched_inputs_move_on_inside_a_step(open_fmu):
    """An input with a rate port keeps its rate when another input is set inside the step."""
    fmu = open_fmu("path", fmi=3, intermediateUpdate=watching(lambda _: fmu.set(acceleration=0.0))).start()
    fmu.set(position=1.0, velocity=2.0)
    for k in range(10):
        fmu.set(position=1.0 + 0.2 * k)
        step(fmu, 0.1 * k, 0.1)
        assert fmu["where"] == pytest.approx(1.0 + 0.2 * (k + 1), rel=1e-14, abs=0)
    assert fmu["integral"] == pytest.approx(2.0, rel=1e-12)  # of 1 + 2 t over a second


def test_step_ends_early_where_the_caller_wants(open_fmu):
    """An early return ends at the requested time, and the simulation continues on the same solution."""
    waiting = [0.3]

    def act(time: float) -> float | None:
        return max(time, waiting[0]) if time < waiting[0] + 0.2 else None

    fmu = open_fmu("decay", fmi=3, intermediateUpdate=watching(act), earlyReturnAllowed=True).start()
    early, reached = step(fmu, 0.0, 1.0)
    assert (early, reached) == (True, pytest.approx(0.3, abs=1e-15))
    assert fmu["time"] == reached
    waiting[0] = 0.5
    early, again = step(fmu, reached, 0.7)
    assert (early, again) == (True, pytest.approx(0.5, abs=1e-15))
    waiting[0] = -1.0
    assert step(fmu, again, 0.5) == (False, 1.0)
    assert fmu["level"] == pytest.approx(math.exp(-2.0), abs=1e-5)  # tolerance of the solver


def test_early_return_needs_permission(open_fmu):
    """A step does not return early unless the importer has allowed it."""
    offered: list[bool] = []

    def update(_env, _time, _set, _get, _finished, can_return, requested, when) -> None:
        offered.append(can_return)
        requested[0], when[0] = True, 0.0

    fmu = open_fmu("decay", fmi=3, intermediateUpdate=update, earlyReturnAllowed=False).start()
    assert step(fmu, 0.0, 1.0) == (False, 1.0)
    assert not any(offered)


def test_calls_that_would_break_a_step_are_refused_inside(open_fmu):
    """Inside a step no state is restored, no parameter set and no step started, and the step continues."""
    refused: list[str] = []

    def act(_time: float) -> None:
        for call in (
            lambda: fmu.fmu.setFMUState(state),
            lambda: fmu.set(rate=5.0),
            lambda: fmu.fmu.doStep(0.0, 0.1),
            fmu.fmu.reset,
            fmu.fmu.terminate,
        ):
            try:
                call()
            except FMICallException:
                refused.append(fmu.errors()[-1])

    fmu = open_fmu("decay", fmi=3, intermediateUpdate=watching(act)).start()
    state = fmu.fmu.getFMUState()
    assert step(fmu, 0.0, 0.5) == (False, 0.5)
    fmu.fmu.freeFMUState(state)
    assert len(refused) % 5 == 0
    assert refused
    assert fmu["level"] == pytest.approx(math.exp(-1.0), abs=1e-5)


# ---- modes -------------------------------------------------------------------------------------------


def test_event_mode_is_entered_where_the_caller_uses_it(open_fmu):
    """With event mode, initialisation ends in it; steps follow fmi3EnterStepMode; inputs may jump there."""
    fmu = open_fmu("decay", fmi=3, eventModeUsed=True).start()
    fmu.refuses(lambda: fmu.fmu.doStep(0.0, 0.1))
    assert fmu.fmu.updateDiscreteStates()[:5] == (False, False, False, False, False)
    fmu.fmu.enterStepMode()
    step(fmu, 0.0, 0.1)
    fmu.fmu.enterEventMode()
    fmu.set(target=4.0, rate=1.0)
    fmu.fmu.updateDiscreteStates()
    fmu.fmu.enterStepMode()
    level = fmu["level"]
    step(fmu, 0.1, 1.0)
    expected = 4.0 + (level - 4.0) * math.exp(-1.0)
    assert fmu["level"] == pytest.approx(expected, abs=1e-5)  # tolerance of the solver


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda f: f.fmu.enterEventMode(), "without event mode"),
        (lambda f: f.fmu.getFloat64([f.references["level"]], nValues=2), "2 values for 1 scalar"),
        (lambda f: f.set(time=1.0), "the time cannot be set"),
    ],
)
def test_a_call_that_does_not_fit_is_refused(open_fmu, call, message):
    """Event mode that was not announced, more values than scalars, the independent variable."""
    fmu = open_fmu("decay", fmi=3).start().step(0.1)
    fmu.refuses(lambda: call(fmu), message)


def test_scheduled_execution_is_refused_with_a_reason(open_fmu):
    """The function exists, as the standard requires, but creates no instance and reports the reason."""
    fmu = open_fmu("gain", fmi=3)
    function = fmu.fmu.dll.fmi3InstantiateScheduledExecution
    function.argtypes, function.restype = None, ctypes.c_void_p
    given = (b"a", fmu.fmu.guid.encode(), b"", False, False, None, fmu.fmu.logMessage, None, None, None)
    assert function(*given) is None
    assert "scheduled execution" in fmu.errors()[-1]


@pytest.mark.parametrize("kind", [*WIDTHS, "Float32", "Int32", "Boolean", "String"])
def test_types_that_the_model_lacks_are_refused(open_fmu, kind):
    """An empty request is accepted; any other is an error with the types that exist."""
    fmu = open_fmu("gain", fmi=3).start()
    reference, value = (ctypes.c_uint * 1)(1), (ctypes.c_char * 16)()
    for direction in ("Get", "Set"):
        function = getattr(fmu.fmu.dll, f"fmi3{direction}{kind}")
        pointer, size = ctypes.c_void_p, ctypes.c_size_t
        function.argtypes = [pointer, pointer, size, pointer, size]
        assert function(fmu.fmu.component, reference, 0, value, 0) == 0
        assert function(fmu.fmu.component, reference, 1, value, 1) == ERROR
        assert "expected Float64" in fmu.errors()[-1]


# ---- values and derivatives --------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["decay", "vanderpol", "chamber"])
def test_both_versions_give_the_same_numbers(open_fmu, name):
    """A simulation with FMI 3 is bit-identical to one with FMI 2, with the slopes of its outputs."""
    old, new = open_fmu(name).start(), open_fmu(name, fmi=3).start()
    shown = [n for n in new.references if n != "time"]
    outputs = [v.name for v in new.description.modelVariables if v.causality == "output"]
    for _ in range(50):
        assert (new.step(0.01).get(*shown) == old.step(0.01).get(*shown)).all()
        assert new.output_slopes(*outputs) == old.output_slopes(*outputs)


def test_there_are_no_adjoint_derivatives(open_fmu):
    """The function is there, as the standard wants, and refuses."""
    fmu = open_fmu("decay", fmi=3).start()
    assert not fmu.description.modelExchange.providesAdjointDerivatives
    level = [fmu.references["der_level"]], [fmu.references["level"]]
    fmu.refuses(lambda: fmu.fmu.getAdjointDerivative(*level, [1.0]), "the model has no adjoint derivatives")
