"""Linearise a system of FMUs at its start, at a time of a co-simulation, or at a steady state."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from orchestrator.base.errors import Problem
from orchestrator.data.trace import Trace
from orchestrator.engine.run import run
from orchestrator.fmi.description import Value
from orchestrator.linear.cut_system import cut_at_inputs
from orchestrator.linear.cut_system import matching_outputs as chosen_outputs
from orchestrator.linear.model import LinearModel, LinearVariable
from orchestrator.linear.plant import Array, Plant
from orchestrator.linear.steady_state import find_steady_state as find_steady
from orchestrator.ssp.load import load
from orchestrator.ssp.parameter_sets import with_sets
from orchestrator.ssp.swap import with_swaps
from orchestrator.ssp.system import Port, System


def settle_at_time(
    plant: Plant, system: System, scenario: Trace | str | Path | None, time: float, step: float | None
) -> tuple[str, ...]:
    """Bring the plant to where a run of the system is at `time` [s]. Returns notes.

    The wires of the plant carry what the outputs are there. In the run an input that follows another
    component lags behind by part of a step, so the time derivatives may differ from those of the run.
    """
    start = system.start or 0.0
    if not np.isfinite(time) or time < start:
        raise Problem(f"--time {time:g}: expected a time from {start:g} s on")
    if time == start:
        plant.settle(plant.x.copy(), plant.u)
        return ()
    names = [str(p) for p in (*plant.states, *plant.inputs)]
    result = run(system, scenario, step=step, stop=time, record=names, record_step=None)
    last = {name: float(result.trace[name][-1]) for name in names}
    if abs(float(result.trace.time[-1]) - time) > 1e-9 * max(1.0, time):
        end = f"the run ends at {result.trace.time[-1]:g} s"
        raise Problem(f"--time {time:g}: expected a multiple of the communication step, {end}")
    plant.set_time(time)
    plant.v[:] = [last[str(p)] for p in plant.inputs]
    plant.constant[~plant.connected] = plant.v[~plant.connected]
    plant.settle(np.array([last[str(p)] for p in plant.states]), plant.u)
    return ()


NO_EFFECT_REASON = "a command in its dead band or beyond its range, a controller that is off"


def no_effect_notes(plant: Plant, b: Array) -> tuple[str, ...]:
    """Notes. b: of the inputs of the linear model, the first ones of the plant."""
    if not len(b):
        return ()
    inlets = plant.cut.inputs[: b.shape[1]]
    none = [inlet.name for inlet, column in zip(inlets, b.T, strict=True) if not column.any()]
    cut = [str(port) for port in _open_loops(plant)]
    notes = (f"no state depends here on {', '.join(none)} ({NO_EFFECT_REASON})",) if none else ()
    return (*notes, f"loops are open here at {', '.join(cut)} ({NO_EFFECT_REASON})") if cut else notes


def _open_loops(plant: Plant) -> Iterator[Port]:
    """Outputs that go nowhere here, of components that stand between the inputs and the rest.

    Such an output is wired to an input on which a state may depend, and no state depends on any input that
    it is wired to. What has no inputs from outside, such as the machine behind a controller, is left out:
    that no pressure depends on a position where nothing flows opens no loop.
    """
    own = plant.blocks()
    moved = np.asarray((own.b @ plant.loop_inverse(own.d)).any(axis=0))
    between = {port.component for inlet in plant.cut.inputs for port, _ in inlet.targets}
    for j, output in enumerate(plant.outputs):
        fed = [i for i, row in enumerate(plant.connections) if row[j]]
        able = any(_may_affect_state(plant, plant.inputs[i]) for i in fed)
        if output.component in between and able and not moved[fed].any():
            yield output


def _may_affect_state(plant: Plant, port: Port) -> bool:
    """May a state of the component depend on this input, as far as its model description tells?"""
    face = plant.system.components[port.component].interface
    known = [face.dependencies.get(rate) for rate in face.states.values()]
    return any(inputs is None or port.variable in inputs for inputs in known)


EXPERIMENT_LENGTH = 1.0  # [s] that the run lasts, as announced to the FMUs; nothing depends on it


def linearize(
    system: System | str | Path,
    parameters: Sequence[str | Path] = (),
    inputs: Sequence[str] = (),
    outputs: Sequence[str] = (),
    steady: bool = False,
    speeds: Mapping[str, float] | None = None,
    time: float | None = None,
    scenario: Trace | str | Path | None = None,
    step: float | None = None,
    swap: Mapping[str, str | Path] | None = None,
    set: Mapping[str, Value | str] | None = None,
) -> LinearModel:
    """A, B, C, D of a system, from the directional derivatives of its FMUs in model exchange.

    system       a System, or the path of an .ssp, .ssd or .fmu file
    parameters   parameter sets, such as the pose "reach"; as for `run`
    inputs       names as in a scenario; a wire to one of them is cut; default: what components without inputs
                 feed, such as levers, and all inputs of the system
    outputs      patterns of component.variable; default: all outputs
    steady       find a steady state near by, with `speeds` of joints by name, see `steady.py`
    time         [s] of a co-simulation with `scenario` and `step`, as `run` does it, whose states and inputs
                 there are the operating point; default: the start
    swap, set    as for `run`; an input of the linear model may be set, too, though a wire feeds it in a run

    Raises Problem for a mistake, and where an FMU is not made for model exchange.
    """
    whole = with_swaps(system if isinstance(system, System) else load(system), swap or {})
    whole = with_sets(whole, parameters)
    if speeds and not steady:
        raise Problem("--speed: expected --steady with it, only a steady state has given speeds")
    choice = cut_at_inputs(whole, inputs, steady)
    if time is not None:
        _refuse_connected(whole, set or {}, "--scenario, which plays it in the run")
    choice = replace(choice, system=_with_start_values(choice.system, whole, set or {}))
    ports = chosen_outputs(choice.system, outputs)
    start = whole.start or 0.0
    plant = Plant(choice)
    try:
        plant.start((start, start + EXPERIMENT_LENGTH))
        notes = choice.notes + plant.notes
        if time is None:
            plant.settle(plant.x.copy(), plant.u)
        else:
            notes += settle_at_time(plant, whole.with_start(set or {}), scenario, time, step)
        if steady:
            notes += find_steady(plant, speeds)
        return _result(plant, ports, start if time is None else time, notes)
    finally:
        plant.close()


def _with_start_values(system: System, whole: System, values: Mapping[str, Value | str]) -> System:
    """With start values; those of components that were left out, such as levers, count in a run only."""
    _refuse_connected(system, values, "--input of that name as well, which cuts the wire")
    return system.with_start({n: v for n, v in values.items() if system.has(n) or not whole.has(n)})


def _refuse_connected(system: System, names: Iterable[str], instead: str) -> None:
    """No wire feeds what these names stand for."""
    wires = {c.target: c for c in system.connections}
    for name in filter(system.has, names):
        for port, _ in system.targets(name):
            if port in wires:
                raise Problem(f"--set {name}: fed by {wires[port]}; expected {instead}")


def _result(plant: Plant, ports: Sequence[Port], time: float, notes: tuple[str, ...]) -> LinearModel:
    matrices = plant.matrices()
    for name, matrix in zip("ABCD", matrices, strict=True):
        if not np.isfinite(matrix).all():
            raise Problem(f"{plant.system.name}: {name} has values that are not finite")
    at = {port: i for i, port in enumerate(plant.outputs)}
    rows = [at[port] for port in ports]
    count = plant.cut.requested_count
    inlets = plant.cut.inputs[:count]
    return LinearModel(
        name=plant.system.name,
        states=tuple(_linear_variable(plant.system, port) for port in plant.states),
        inputs=tuple(
            _linear_variable(plant.system, i.targets[0][0])._replace(name=i.name, unit=i.unit) for i in inlets
        ),
        outputs=tuple(_linear_variable(plant.system, port) for port in ports),
        a=matrices.a,
        b=matrices.b[:, :count],
        c=matrices.c[rows],
        d=matrices.d[rows, :count],
        x0=plant.x.copy(),
        u0=plant.u[:count],
        y0=plant.y[rows],
        f0=plant.f.copy(),
        time=time,
        notes=notes + no_effect_notes(plant, matrices.b[:, :count]),
    )


def _linear_variable(system: System, port: Port) -> LinearVariable:
    variable = system.variable(port)
    return LinearVariable(str(port), variable.unit, variable.description, variable.nominal or 1.0)
