"""Tasks on intermediate updates and early return of a communication step (FMI 3)."""

import ctypes
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

from orchestrator.check.tasks.runner import Remark, Trial
from orchestrator.check.tasks.trial_run import Simulation, VariableValues, difference, inner_step, numeric
from orchestrator.fmi.instance import CallFailed

_B = ctypes.c_bool
CALLBACK = ctypes.CFUNCTYPE(
    *(None, ctypes.c_void_p, ctypes.c_double, _B, _B, _B, _B),
    *(ctypes.POINTER(_B), ctypes.POINTER(ctypes.c_double)),
)
STEPS = 6


@dataclass
class UpdateCallback:
    """The callback of intermediate updates: records their times, reads outputs, requests an early return.

    request_return   in each update in which the FMU offers it
    outputs          are read in each update in which the FMU allows it
    """

    request_return: bool = False
    times: list[float] = field(default_factory=list)
    outputs: VariableValues | None = None
    problem: str = ""

    def __post_init__(self) -> None:
        self.function = CALLBACK(self._call)

    def _call(self, _environment: Any, time: float, *arguments: Any) -> None:
        _, get_allowed, _, can_return_early, early_return_requested, early_return_time = arguments
        self.times.append(time)
        if get_allowed and self.outputs is not None and not self.problem:
            try:
                self.outputs.get()
            except CallFailed as failure:
                self.problem = str(failure)
        if early_return_requested:
            early_return_requested[0] = bool(self.request_return and can_return_early)
        if early_return_time:
            early_return_time[0] = time


def _simulation(trial: Trial, callback: UpdateCallback, early: bool = False) -> Simulation:
    """A run with this callback, which may read all real outputs."""
    outputs = [v for v in numeric(trial.description, "output") if v.is_real]
    required = [v.reference for v in outputs]
    simulation = Simulation(trial, update=callback.function, required=required, early=early).begin()
    callback.outputs = simulation.values(outputs)
    return simulation


def intermediate(trial: Trial) -> Iterator[Remark]:
    """Updates are within the step, outputs can be read in them, and the results stay bit-identical."""
    expected = Simulation(trial).begin().run(STEPS, trial.perturbable)
    callback = UpdateCallback()
    simulation = _simulation(trial, callback)
    rows = []
    for n in range(STEPS):
        callback.times.clear()
        rows += simulation.run(1, trial.perturbable)
        begin, end = simulation.start + n * simulation.step, simulation.time
        rounding = 1e-9 * max(simulation.step, abs(end))
        if outside := [t for t in callback.times if not begin - rounding <= t <= end + rounding]:
            yield "error", f"an update at {outside[0]:.9g} s in the step from {begin:.9g} to {end:.9g} s"
            return
        if callback.times != sorted(callback.times):
            yield "error", f"the updates of the step from {begin:.9g} s go back in time"
            return
    if callback.problem:
        yield "error", f"in the intermediate update {callback.problem}"
    elif text := difference(trial, expected, rows):
        yield "error", f"results change when outputs are read in the intermediate update: {text}"
    simulation.close()


def early_return(trial: Trial) -> Iterator[Remark]:
    """After a request to return early the FMU reports the time it reached, and the next step begins there."""
    callback = UpdateCallback(request_return=True)
    simulation = _simulation(trial, callback, early=True)
    callback.outputs = None
    time = simulation.start
    for _ in range(STEPS):
        simulation.do_step(time, simulation.step)
        end, reached = time + simulation.step, simulation.reached
        step = f"a step from {time:.9g} to {end:.9g} s"
        if not simulation.early:
            if not abs(reached - end) <= 1e-9 * end + inner_step(trial.description):
                yield "error", f"{step} ends at {reached:.9g} s without reporting an early return"
                return
            reached = end
        elif not time <= reached <= end * (1 + 1e-12):
            yield "error", f"the last successful time of {step} is {reached:.9g} s"
            return
        time = reached
    simulation.close()
