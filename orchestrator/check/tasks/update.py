"""FMI 3: the intermediate update inside a step, and its early return."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

from orchestrator.check.tasks.runner import Remark, Trial
from orchestrator.check.tasks.trial_run import Simulation, VariableRow, bits, difference, inner_step, numeric
from orchestrator.fmi.instance import CallFailed

_B = ctypes.c_bool
CALLBACK = ctypes.CFUNCTYPE(
    *(None, ctypes.c_void_p, ctypes.c_double, _B, _B, _B, _B),
    *(ctypes.POINTER(_B), ctypes.POINTER(ctypes.c_double)),
)
STEPS = 6


@dataclass
class Witness:
    """The callback: keeps the times, reads the outputs where it may, asks for a return where it shall."""

    ask: bool = False
    times: list[float] = field(default_factory=list)
    values: VariableRow | None = None
    problem: str = ""

    def __post_init__(self) -> None:
        self.callback = CALLBACK(self._call)  # the C function

    def _call(
        self, _: Any, time: float, __: bool, get: bool, ___: bool, can: bool, asked: Any, at: Any
    ) -> None:
        self.times.append(time)
        if get and self.values is not None and not self.problem:
            try:
                self.values.get()
            except CallFailed as failure:
                self.problem = str(failure)
        if asked:
            asked[0] = bool(self.ask and can)
        if at:
            at[0] = time


def _witnessed(trial: Trial, witness: Witness, **options: Any) -> Simulation:
    """A run with this callback, which may read all real outputs."""
    outputs = [v for v in numeric(trial.description, "output") if v.is_float]
    required = [v.reference or 0 for v in outputs]
    simulation = Simulation(trial, update=witness.callback, required=required, **options).begin()
    witness.values = simulation.values(outputs)
    return simulation


def intermediate(trial: Trial) -> Iterator[Remark]:
    """Updates lie within the step, outputs can be read there, and the results stay the same bits."""
    expected = Simulation(trial).begin().run(STEPS, trial.pokes)
    witness = Witness()
    simulation = _witnessed(trial, witness)
    rows = []
    for n in range(STEPS):
        witness.times.clear()
        rows += simulation.run(1, trial.pokes)
        begin, end = simulation.start + n * simulation.step, simulation.time
        slack = 1e-9 * max(simulation.step, abs(end))
        wrong = [t for t in witness.times if not begin - slack <= t <= end + slack]
        if wrong:
            yield "error", f"an update at {wrong[0]:.9g} s in the step from {begin:.9g} to {end:.9g} s"
            return
        if witness.times != sorted(witness.times):
            yield "error", f"the updates of the step from {begin:.9g} s go back in time"
            return
    if witness.problem:
        yield "error", f"in the intermediate update {witness.problem}"
    elif bits(rows) != bits(expected):
        text = difference(trial, expected, rows)
        yield "error", f"results change when outputs are read in the intermediate update: {text}"
    simulation.close()


def early_return(trial: Trial) -> Iterator[Remark]:
    """A step that is asked to return early does, says where, and the next one goes on from there."""
    witness = Witness(ask=True)
    simulation = _witnessed(trial, witness, early=True)
    witness.values = None  # nothing is read
    time = simulation.start
    for _ in range(STEPS):
        simulation.do_step(time, simulation.step)
        end, reached = time + simulation.step, simulation.reached
        step = f"a step from {time:.9g} to {end:.9g} s"
        if not simulation.early:
            if not abs(reached - end) <= 1e-9 * end + inner_step(trial.description):
                yield "error", f"{step} ends at {reached:.9g} s and does not say that it returned early"
                return
            reached = end
        elif not time <= reached <= end * (1 + 1e-12):
            yield "error", f"the last successful time of {step} is {reached:.9g} s"
            return
        time = reached
    simulation.close()
