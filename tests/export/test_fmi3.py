"""FMI 3.0: what it has beyond FMI 2.0, on toys; the equations behind are tested with FMI 2.0."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from fmpy import fmi3
from fmpy.fmi1 import FMICallException
from fmpy.validation import validate_fmu

from fmus.export.build import build

ERROR = 3


@dataclass
class Handle:
    """An instance with variables by name and messages as (category, text)."""

    fmu: Any
    refs: dict[str, int]
    messages: list[tuple[str, str]]

    def get(self, *names: str) -> Any:
        values = list(self.fmu.getFloat64([self.refs[n] for n in names]))
        return values[0] if len(names) == 1 else values

    def set(self, **values: float) -> None:
        self.fmu.setFloat64([self.refs[n] for n in values], list(values.values()))

    def start(self, time: float = 0.0) -> Handle:
        self.fmu.enterInitializationMode(startTime=time)
        self.fmu.exitInitializationMode()
        return self

    def step(self, time: float, length: float) -> tuple[bool, float]:
        """Is this an early return, and the time reached."""
        _, _, early, reached = self.fmu.doStep(time, length)
        return early, reached

    def errors(self) -> list[str]:
        return [text for category, text in self.messages if category == "logStatusError"]


@pytest.fixture(scope="module")
def folders(toys, tmp_path_factory) -> dict[str, Path]:
    """Toy -> folder with its unpacked FMI 3.0 FMU."""
    out = tmp_path_factory.mktemp("toys3")
    result = {}
    for name, (sub, numbers) in toys.items():
        fmu = build(sub, out, step=0.01, stop=1.0, values=numbers, fmi=3)
        result[name] = Path(fmpy.extract(str(fmu), str(out / name)))
    return result


@pytest.fixture
def open3(folders) -> Iterator[Callable[..., Handle]]:
    """open3("decay") makes an instance for co-simulation, or of another class of FMPy."""
    opened: list[Handle] = []

    def opener(name: str, kind: Any = fmi3.FMU3Slave, **options: Any) -> Handle:
        description = fmpy.read_model_description(str(folders[name]), validate=False)
        fmu = kind(
            guid=description.guid,
            unzipDirectory=str(folders[name]),
            modelIdentifier=name,
            instanceName="toy",
        )
        messages: list[tuple[str, str]] = []

        def log(_environment: Any, _status: int, category: bytes, text: bytes) -> None:
            messages.append((category.decode(), text.decode()))

        fmu.instantiate(logMessage=log, **options)
        refs = {v.name: v.valueReference for v in description.modelVariables}
        opened.append(Handle(fmu, refs, messages))
        return opened[-1]

    yield opener
    for handle in opened:
        handle.fmu.freeInstance()


# ---- inside a step -----------------------------------------------------------------------------------


def watching(act: Callable[[float], float | None]) -> Callable[..., None]:
    """An intermediate update: `act` is called with the time, and may return when to stop."""

    def update(_env, time, _set, _get, _finished, can_return, requested, when) -> None:
        stop = act(time)
        if stop is not None and can_return:
            requested[0], when[0] = True, stop

    return update


def test_values_inside_a_step_lie_on_the_solution(open3):
    """Outputs that are read between inner steps have the values of that time."""
    seen: list[tuple[float, float, float]] = []
    fmu = open3(
        "decay",
        intermediateUpdate=watching(lambda t: seen.append((t, *fmu.get("level", "time")))),
        earlyReturnAllowed=False,
    ).start()
    fmu.step(0.0, 2.0)
    times = [t for t, _, _ in seen]
    assert len(times) > 5
    assert times == sorted(times)
    assert times[-1] == 2.0
    assert all(t == own for t, _, own in seen)
    # the solver's tolerance 1e-6 per step, over a handful of steps
    np.testing.assert_allclose([level for _, level, _ in seen], np.exp(-2.0 * np.array(times)), atol=1e-5)


def test_inputs_set_inside_a_step_hold_from_there_on(open3):
    """A staircase set at the inner steps is integrated as such, and its last value is kept."""
    corners: list[tuple[float, float]] = [(0.0, 0.0)]

    def stair(time: float) -> None:
        fmu.set(position=10.0 * time)
        corners.append((time, 10.0 * time))

    fmu = open3("path", intermediateUpdate=watching(stair)).start()
    # a tight first proposal makes several inner steps: the velocity port bends the input
    fmu.set(velocity=0.0, acceleration=0.0)
    for k in range(4):
        fmu.step(0.25 * k, 0.25)
    exact = sum(value * (after - time) for (time, value), (after, _) in pairwise(corners))
    assert len(corners) >= 5
    assert fmu.get("integral") == pytest.approx(exact, rel=1e-12)  # RODAS integrates constants exactly
    assert fmu.get("position") == 10.0 * corners[-1][0]


def test_untouched_inputs_move_on_inside_a_step(open3):
    """An input with a rate port keeps its rate when another input is set inside the step."""
    fmu = open3("path", intermediateUpdate=watching(lambda _: fmu.set(acceleration=0.0))).start()
    fmu.set(position=1.0, velocity=2.0)
    for k in range(10):
        fmu.set(position=1.0 + 0.2 * k)
        fmu.step(0.1 * k, 0.1)
        assert fmu.get("where") == pytest.approx(1.0 + 0.2 * (k + 1), rel=1e-14, abs=0)
    assert fmu.get("integral") == pytest.approx(2.0, rel=1e-12)  # of 1 + 2 t over a second


def test_step_ends_early_where_the_caller_wants(open3):
    """An early return ends at the requested time, and the simulation continues on the same solution."""
    stops = iter((0.3, 0.5))
    waiting = [next(stops)]

    def act(time: float) -> float | None:
        return max(time, waiting[0]) if time < waiting[0] + 0.2 else None

    fmu = open3("decay", intermediateUpdate=watching(act), earlyReturnAllowed=True).start()
    early, reached = fmu.step(0.0, 1.0)
    assert early
    assert reached == pytest.approx(0.3, abs=1e-15)
    assert fmu.get("time") == reached
    waiting[0] = 0.5
    early, again = fmu.step(reached, 0.7)
    assert early
    assert again == pytest.approx(0.5, abs=1e-15)
    waiting[0] = -1.0
    early, end = fmu.step(again, 0.5)
    assert (early, end) == (False, 1.0)
    assert fmu.get("level") == pytest.approx(math.exp(-2.0), abs=1e-5)  # tolerance of the solver


def test_early_return_needs_permission(open3):
    """A step does not return early unless the importer has allowed it."""
    offered: list[bool] = []

    def update(_env, _time, _set, _get, _finished, can_return, requested, when) -> None:
        offered.append(can_return)
        requested[0], when[0] = True, 0.0

    fmu = open3("decay", intermediateUpdate=update, earlyReturnAllowed=False).start()
    assert fmu.step(0.0, 1.0) == (False, 1.0)
    assert not any(offered)


def test_calls_that_would_break_a_step_are_refused_inside(open3):
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

    fmu = open3("decay", intermediateUpdate=watching(act)).start()
    state = fmu.fmu.getFMUState()
    assert fmu.step(0.0, 0.5) == (False, 0.5)
    fmu.fmu.freeFMUState(state)
    assert len(refused) % 5 == 0
    assert refused
    assert fmu.get("level") == pytest.approx(math.exp(-1.0), abs=1e-5)


# ---- modes -------------------------------------------------------------------------------------------


def test_event_mode_is_entered_where_the_caller_uses_it(open3):
    """With event mode, initialisation ends in it; steps follow fmi3EnterStepMode; inputs may jump there."""
    fmu = open3("decay", eventModeUsed=True).start()
    with pytest.raises(FMICallException):
        fmu.fmu.doStep(0.0, 0.1)
    assert fmu.fmu.updateDiscreteStates()[:5] == (False, False, False, False, False)
    fmu.fmu.enterStepMode()
    fmu.step(0.0, 0.1)
    fmu.fmu.enterEventMode()
    fmu.set(target=4.0, rate=1.0)
    fmu.fmu.updateDiscreteStates()
    fmu.fmu.enterStepMode()
    level = fmu.get("level")
    fmu.step(0.1, 1.0)
    expected = 4.0 + (level - 4.0) * math.exp(-1.0)
    assert fmu.get("level") == pytest.approx(expected, abs=1e-5)  # tolerance of the solver


def test_event_mode_is_refused_where_it_was_not_announced(open3):
    """Without eventModeUsed co-simulation goes from initialisation straight to steps."""
    fmu = open3("decay").start()
    fmu.step(0.0, 0.1)
    with pytest.raises(FMICallException):
        fmu.fmu.enterEventMode()
    assert "without event mode" in fmu.errors()[-1]


def test_scheduled_execution_is_refused_with_a_reason(open3):
    """The function exists, as the standard requires, but creates no instance and reports the reason."""
    fmu = open3("gain")
    function = fmu.fmu.dll.fmi3InstantiateScheduledExecution
    function.argtypes, function.restype = None, ctypes.c_void_p
    made = function(
        b"a", fmu.fmu.guid.encode(), b"", False, False, None, fmu.fmu.logMessage, None, None, None
    )
    assert made is None
    assert "scheduled execution" in fmu.errors()[-1]


@pytest.mark.parametrize(
    "kind",
    [
        "Float32",
        "Int8",
        "UInt8",
        "Int16",
        "UInt16",
        "Int32",
        "UInt32",
        "Int64",
        "UInt64",
        "Boolean",
        "String",
    ],
)
def test_types_that_the_model_lacks_are_refused(open3, kind):
    """An empty request is accepted; any other is an error with the types that exist."""
    fmu = open3("gain").start()
    reference, value = (ctypes.c_uint * 1)(1), (ctypes.c_char * 16)()
    for direction in ("Get", "Set"):
        function = getattr(fmu.fmu.dll, f"fmi3{direction}{kind}")
        function.argtypes = [
            ctypes.c_void_p,
            ctypes.c_void_p,
            ctypes.c_size_t,
            ctypes.c_void_p,
            ctypes.c_size_t,
        ]
        assert function(fmu.fmu.component, reference, 0, value, 0) == 0
        assert function(fmu.fmu.component, reference, 1, value, 1) == ERROR
        assert "expected Float64" in fmu.errors()[-1]


def test_number_of_values_must_be_that_of_the_variables(open3):
    """All variables are scalars, so another number of values is an error."""
    fmu = open3("gain").start()
    with pytest.raises(FMICallException):
        fmu.fmu.getFloat64([fmu.refs["product"]], nValues=2)
    assert "2 values for 1 scalar" in fmu.errors()[-1]


# ---- values and derivatives --------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["decay", "path", "vanderpol", "chamber", "gain"])
def test_description_is_valid(folders, name):
    """FMPy finds no fault: schema, references, units, model structure."""
    assert validate_fmu(str(folders[name])) == []


@pytest.mark.parametrize("name", ["decay", "vanderpol", "chamber"])
def test_both_versions_give_the_same_numbers(open3, open_fmu, name):
    """A simulation with FMI 3 is bit-identical to one with FMI 2."""
    old, new = open_fmu(name).start(), open3(name).start()
    shown = [n for n in new.refs if n != "time"]
    for k in range(50):
        old.fmu.doStep(0.01 * k, 0.01)
        new.step(0.01 * k, 0.01)
        assert new.get(*shown) == old.get(*shown)


@pytest.mark.parametrize("name", ["decay", "path", "vanderpol", "chamber", "gain"])
@pytest.mark.parametrize("running", [False, True])
def test_adjoint_is_the_transpose_of_the_directional_derivative(open3, name, running):
    """w . (J v) = (J^T w) . v for random v and w, at the start and after some steps."""
    fmu = open3(name)
    fmu.fmu.enterInitializationMode()
    description = fmpy.read_model_description(str(fmu.fmu.unzipDirectory), validate=False)
    kinds = {v.name: v for v in description.modelVariables}
    calculated = [n for n, v in kinds.items() if v.initial == "calculated"]
    states = [n.removeprefix("der_") for n in kinds if n.startswith("der_")]
    inputs = [n for n, v in kinds.items() if v.causality == "input"]
    parameters = [n for n, v in kinds.items() if v.causality == "parameter"]
    if running:
        fmu.fmu.exitInitializationMode()
        for k in range(5):
            fmu.step(0.01 * k, 0.01)
        knowns, unknowns = [*inputs, *states], [n for n in calculated if n not in states]
    else:
        knowns, unknowns = [*inputs, *parameters, *(n for n in states if n not in calculated)], calculated
    random = np.random.default_rng(7)
    known, unknown = ([fmu.refs[n] for n in names] for names in (knowns, unknowns))
    for _ in range(5):
        v, w = random.normal(size=len(known)), random.normal(size=len(unknown))
        forward = np.array(fmu.fmu.getDirectionalDerivative(unknown, known, v))
        reverse = np.array(fmu.fmu.getAdjointDerivative(unknown, known, w, len(known)))
        scale = np.abs(w) @ np.abs(forward) + np.abs(reverse) @ np.abs(v)
        # the same sums in another order; at the start of the chamber larger terms cancel
        assert abs(w @ forward - reverse @ v) <= 1e-9 * scale


def test_state_continues_in_another_instance(open3):
    """Another instance continues bit-identically from the bytes of a state."""
    first, second = open3("chamber").start(), open3("chamber").start()
    for k in range(10):
        first.step(0.01 * k, 0.01)
    state = first.fmu.getFMUState()
    data = first.fmu.serializeFMUState(state)
    first.fmu.freeFMUState(state)
    restored = second.fmu.deserializeFMUState(data)
    second.fmu.setFMUState(restored)
    second.fmu.freeFMUState(restored)
    shown = [n for n in first.refs if n != "time"]
    for k in range(10, 20):
        first.step(0.01 * k, 0.01)
        second.step(0.01 * k, 0.01)
    assert first.get(*shown) == second.get(*shown)


def test_output_derivatives_follow_the_solution(open3):
    """d level / dt of the decay is its rate times the distance to the target."""
    fmu = open3("decay").start()
    fmu.step(0.0, 0.1)
    (slope,) = fmu.fmu.getOutputDerivatives([fmu.refs["level"]], [1])
    assert slope == pytest.approx(-2.0 * fmu.get("level"), rel=1e-14)


def test_time_is_no_variable_to_set(open3):
    """Setting the independent variable is an error."""
    fmu = open3("decay").start()
    with pytest.raises(FMICallException):
        fmu.set(time=1.0)
    assert "the time cannot be set" in fmu.errors()[-1]
