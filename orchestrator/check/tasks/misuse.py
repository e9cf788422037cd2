"""Robustness checks of an FMU: invalid input values, and calls that FMI forbids or rarely sees."""

import ctypes
import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import islice

from orchestrator.base.errors import Problem
from orchestrator.check.tasks.runner import Remark, Trial
from orchestrator.check.tasks.trial_run import Simulation, continuous_inputs, not_finite, numeric
from orchestrator.fmi.description import FmuVariable
from orchestrator.fmi.instance import CallFailed

MAX_INPUTS = 20  # inputs tested per FMU
MAX_PARAMETERS = 5  # parameters set per case
STEPS_AFTER = 3  # steps after an input was set
INVALID_VALUES = (("nan", math.nan), ("inf", math.inf), ("1e120", 1e120), ("-1e120", -1e120))
Call = Callable[[Simulation], object]


def invalid_values(trial: Trial) -> Iterator[Remark]:
    """The FMU rejects an input that is NaN, infinite or huge, or it computes finite outputs again.

    If the FMU accepts the value: after NaN the outputs must be finite once the input is valid again. With
    +-1e120 they must stay finite. An infinite input may give infinite outputs; only a crash is a finding.
    """
    inputs = islice((v for v in continuous_inputs(trial.description) if v.size == 1), MAX_INPUTS)
    cases = ((v, label, value) for v in inputs for label, value in INVALID_VALUES)
    messages: dict[str, list[str]] = {}
    for number, (v, label, value) in enumerate(cases):
        too_large = v.type == "Float32" and abs(value) > 1e38
        if number < trial.first_case or too_large:
            continue
        trial.begin_case(number)
        if symptom := _symptom(trial, v, value):
            group = "nan" if math.isnan(value) else "huge"
            messages.setdefault(group, []).append(f"{v.name} = {label}: {symptom}")
    for first, *others in messages.values():
        more = f" (and {len(others)} more)" if others else ""
        yield "warning", f"status OK although an input is invalid: {first}{more}"


def _symptom(trial: Trial, v: FmuVariable, value: float) -> str:
    """The damage that a value does; empty if the FMU rejects the value or survives it."""
    simulation = Simulation(trial, inputs=[v])
    names = simulation.outputs.names
    try:
        simulation.begin()
        simulation.inputs.set([value])
        symptom = not_finite(names, simulation.run(STEPS_AFTER))
        if symptom and math.isnan(value):
            simulation.inputs.set(simulation.initial_inputs)
            symptom = not_finite(names, simulation.run(STEPS_AFTER))
            return f"{symptom} even after the input is valid again" if symptom else ""
    except CallFailed:
        return ""
    return "" if math.isinf(value) else symptom


# ---- calls


def unexpected_calls(trial: Trial) -> Iterator[Remark]:
    """No illegal or unusual call may crash the process; the status that is returned does not matter."""
    cases = [("illegal", *case) for case in ILLEGAL_CALLS.items()]
    cases += [("legal", *case) for case in UNUSUAL_CALLS.items()]
    for number, (legality, name, calls) in enumerate(cases):
        if number >= trial.first_case:
            trial.begin_case(number)
            trial.activity.case(f"{name}, {legality}")
            simulation = Simulation(trial)
            with suppress(Problem):
                for call in calls:
                    call(simulation)
    yield from ()  # a generator without findings: the parent process reports a crash


def _begin(simulation: Simulation) -> None:
    simulation.begin()


def _enter(simulation: Simulation) -> None:
    """Set up the experiment and enter initialisation mode."""
    simulation.instance.setup(simulation.start)
    simulation.instance.enter()


def _terminate(simulation: Simulation) -> None:
    simulation.instance.call("Terminate")


def _step(length: float | None = None) -> Call:
    """A step of this length; by default the usual one, in Model Exchange a later time."""

    def call(simulation: Simulation) -> None:
        time = simulation.time
        if simulation.kind == "CoSimulation":
            simulation.do_step(time, simulation.step if length is None else length)
        elif length is None:
            simulation.instance.status("SetTime", ctypes.c_double(time + simulation.step))

    return call


def _real(simulation: Simulation) -> str:
    return "Real" if simulation.instance.fmi == 2 else "Float64"


def _get_unknown_reference(simulation: Simulation) -> None:
    variable = simulation.trial.description.variables[0]
    unknown = replace(variable, type=_real(simulation), reference=0x7FFFFFF0, shape=())
    simulation.values([unknown]).get()


def _get_no_variables(simulation: Simulation) -> None:
    """Get zero variables with null pointers."""
    instance = simulation.instance
    instance.call(f"Get{_real(simulation)}", None, ctypes.c_size_t(0), *instance.values(None, 0))


def _set_parameters(legal: bool) -> Call:
    """Set parameters to their start values, which is legal between steps if they are tunable."""

    def call(simulation: Simulation) -> None:
        between_steps = simulation.kind == "CoSimulation"
        parameters = [
            v
            for v in numeric(simulation.trial.description, "parameter")
            if v.start_values and (between_steps and v.variability == "tunable") == legal
        ]
        for v in parameters[:MAX_PARAMETERS]:
            simulation.values([v]).set((v.start_values * v.size)[: v.size])

    return call


def _free_null_state(simulation: Simulation) -> None:
    if simulation.trial.interface.declares("canGetAndSetFMUstate", "canGetAndSetFMUState"):
        simulation.instance.free_state(ctypes.c_void_p())


def _free_null_instance(simulation: Simulation) -> None:
    library = simulation.instance.library
    simulation.trial.activity.call(f"{library.prefix}FreeInstance")
    library.function("FreeInstance", None)(ctypes.c_void_p())


ILLEGAL_CALLS: dict[str, Sequence[Call]] = {
    "a step before the initialisation": [_step()],
    "outputs before the initialisation": [lambda s: s.row()],
    "Terminate before the initialisation": [_terminate],
    "initialisation mode left before it was entered": [lambda s: s.instance.leave()],
    "initialisation mode entered twice": [_enter, lambda s: s.instance.enter()],
    "the experiment set up in initialisation mode": [_enter, lambda s: s.instance.setup(s.start)],
    "initialised twice": [_begin, _begin],
    "an unknown value reference": [_begin, _get_unknown_reference],
    "parameters set while running": [_begin, _set_parameters(legal=False)],
    "a step of length zero": [_begin, _step(0.0)],
    "a step backwards": [_begin, _step(-1e-3)],
    "a step after Terminate": [_begin, _terminate, _step()],
    "Terminate twice": [_begin, _terminate, _terminate],
}
UNUSUAL_CALLS: dict[str, Sequence[Call]] = {  # FMI allows these
    "freed right after instantiation": [lambda s: s.instance.free()],
    "no variables, null pointers": [_begin, _get_no_variables],
    "tunable parameters set between steps": [_begin, _set_parameters(legal=True)],
    "freed without Terminate": [_begin, lambda s: s.instance.free()],
    "a reset after Terminate": [_begin, _terminate, lambda s: s.instance.call("Reset"), _begin],
    "a null state freed": [_begin, _free_null_state],
    "a null instance freed": [_free_null_instance],
}
