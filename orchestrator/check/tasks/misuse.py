"""What nobody should do and somebody does: values without sense, calls in a wrong state."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace

from orchestrator.base.errors import Problem
from orchestrator.check.tasks.runner import Remark, Trial
from orchestrator.check.tasks.trial_run import Simulation, movable, not_finite, numeric
from orchestrator.fmi.instance import CallFailed
from orchestrator.fmi.raw_description import DeclaredVariable

INPUTS = 20  # looked at
STEPS = 3
BAD = (("nan", math.nan), ("inf", math.inf), ("1e120", 1e120), ("-1e120", -1e120))


def values(trial: Trial) -> Iterator[Remark]:
    """A value without sense is refused, or at least does no lasting harm under the status OK."""
    found: dict[str, list[str]] = {}
    stage = 0
    for v in [v for v in movable(trial.description) if v.size == 1][:INPUTS]:
        for word, value in BAD:
            if stage >= trial.first and not (v.type == "Float32" and abs(value) > 1e38):
                trial.at(stage)
                harm = _harm(trial, v, value)
                if harm:
                    found.setdefault("nan" if word == "nan" else "huge", []).append(
                        f"{v.name} = {word}: {harm}"
                    )
            stage += 1
    for texts in found.values():
        more = f" (and {len(texts) - 1} more)" if len(texts) > 1 else ""
        yield "warning", f"a senseless input comes back as OK: {texts[0]}{more}"


def _harm(trial: Trial, v: DeclaredVariable, value: float) -> str:
    """What a value does; empty when it is refused or harmless."""
    simulation = Simulation(trial, inputs=[v])
    try:
        simulation.begin()
        simulation.inputs.set([value])
        rows = simulation.run(STEPS)
        names = simulation.outputs.names
        bad = not_finite(names, rows)
        if bad and math.isnan(value):
            simulation.inputs.set(simulation.rest)
            bad = not_finite(names, simulation.run(STEPS))
            bad = f"{bad} even after the input is valid again" if bad else ""
        elif bad and math.isinf(value):
            bad = ""  # what goes in infinite may come out infinite
    except CallFailed:
        return ""
    return bad


# ---- calls in a wrong state


def order(trial: Trial) -> Iterator[Remark]:
    """No call in a wrong state ends the process."""
    for stage, (name, case) in enumerate(CASES.items()):
        if stage < trial.first:
            continue
        trial.at(stage)
        trial.beacon.inputs(f"({name})")
        simulation = Simulation(trial)
        with suppress(Problem):
            case(simulation)
    return
    yield


def _enter_twice(simulation: Simulation) -> None:
    for _ in range(2):
        simulation.instance.setup(0.0)
        simulation.instance.enter()


def _begun(*calls: Callable[[Simulation], object]) -> Callable[[Simulation], None]:
    """A case that starts with an initialised instance."""

    def case(simulation: Simulation) -> None:
        simulation.begin()
        for call in calls:
            call(simulation)

    return case


def _move(simulation: Simulation) -> None:
    time, length = simulation.time, simulation.step
    if simulation.kind == "CoSimulation":
        simulation.do_step(time, length)
    else:
        simulation.instance.status("SetTime", ctypes.c_double(time + length))


def _length(length: float) -> Callable[[Simulation], None]:
    def case(simulation: Simulation) -> None:
        if simulation.kind == "CoSimulation":
            simulation.do_step(simulation.time, length)

    return case


def _unknown(simulation: Simulation) -> None:
    """Read a variable that does not exist."""
    outside = replace(simulation.trial.description.variables[0], type=_real(simulation), reference=0x7FFFFFF0)
    simulation.values([replace(outside, shape=())]).get()


def _nothing(simulation: Simulation) -> None:
    """Read no variables: null pointers are allowed."""
    instance = simulation.instance
    instance.call(f"Get{_real(simulation)}", None, ctypes.c_size_t(0), *instance.values(None, 0))


def _real(simulation: Simulation) -> str:
    return "Real" if simulation.instance.fmi == 2 else "Float64"


def _fixed(simulation: Simulation) -> None:
    """Set parameters after the initialisation."""
    parameters = numeric(simulation.trial.description, "parameter")
    for v in [v for v in parameters if v.start][:5]:
        simulation.values([v]).set((v.start * v.size)[: v.size])


def _no_state(simulation: Simulation) -> None:
    """Free no state: to be ignored."""
    able = simulation.trial.description.interfaces[simulation.kind]
    if able.declares("canGetAndSetFMUstate", "canGetAndSetFMUState"):
        simulation.instance.free_state(ctypes.c_void_p())


def _terminate(simulation: Simulation) -> None:
    simulation.instance.call("Terminate")


def _free(simulation: Simulation) -> None:
    simulation.instance.free()


def _free_nothing(simulation: Simulation) -> None:
    library = simulation.instance.library
    simulation.trial.beacon.call(f"{library.prefix}FreeInstance")
    library.function("FreeInstance", None)(ctypes.c_void_p())


CASES: dict[str, Callable[[Simulation], object]] = {
    "a step before the initialisation": _move,
    "outputs before the initialisation": lambda s: s.row(),
    "terminated before the initialisation": _terminate,
    "freed right after instantiation": _free,
    "no initialisation mode to leave": lambda s: s.instance.leave(),
    "initialisation mode entered twice": _enter_twice,
    "initialised twice": _begun(lambda s: s.begin()),
    "an unknown value reference": _begun(_unknown),
    "no variables, null pointers": _begun(_nothing),
    "parameters set while running": _begun(_fixed),
    "a step of no length": _begun(_length(0.0)),
    "a step backwards": _begun(_length(-1e-3)),
    "a step after the end": _begun(_terminate, _move),
    "terminated twice": _begun(_terminate, _terminate),
    "freed without an end": _begun(_free),
    "a reset after the end": _begun(_terminate, lambda s: s.instance.call("Reset"), lambda s: s.begin()),
    "no state freed": _begun(_no_state),
    "no instance freed": _free_nothing,
}
