"""Linearises a system of FMUs at its start, at a time of a co-simulation, or at a steady state."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Unpack

import numpy as np

from orchestrator.base.errors import Problem
from orchestrator.base.options import chosen, documented
from orchestrator.data.table import Array
from orchestrator.data.trace import rounding
from orchestrator.engine.arguments import LinearArguments
from orchestrator.engine.options import LinearOptions
from orchestrator.engine.run import run
from orchestrator.engine.scenario import ScenarioSource, drive, read_scenario
from orchestrator.linear.cut_system import CutPlant, cut_at_inputs, matching_outputs
from orchestrator.linear.model import LinearModel
from orchestrator.linear.modes import LinearVariable
from orchestrator.linear.steady_state import find_steady_state
from orchestrator.ssp.load import configured
from orchestrator.ssp.plausible import doubtful_starts, doubts_told, with_doubts
from orchestrator.ssp.provenance import built_notes
from orchestrator.ssp.system import Port, System


def settle_at_time(
    plant: CutPlant, system: System, scenario: ScenarioSource, time: float, step: float | None
) -> None:
    """Set the plant to states and inputs of a run of the system at `time` [s].

    In the plant, connected inputs are equal to the outputs at the same time. In the run they lag behind by a
    part of a step, so that the time derivatives of the plant can differ from those of the run.
    """
    start = system.start or 0.0
    if not np.isfinite(time) or time < start:
        raise Problem(f"--time {time:g}: expected a time from {start:g} s on")
    if time == start:
        plant.settle(plant.x.copy(), plant.u)
        return
    names = [str(p) for p in (*plant.states, *plant.inputs)]
    result = run(system, scenario, step=step, stop=time, record=names, record_step=None)
    last = {name: float(result.trace[name][-1]) for name in names}
    if abs(float(result.trace.time[-1]) - time) > rounding(time, result.card.step):
        got = f"a run that ends at {result.trace.time[-1]:g} s"
        raise Problem(f"--time {time:g}: expected a multiple of the communication step, got {got}")
    plant.set_time(time)
    plant.v[:] = [last[str(p)] for p in plant.inputs]
    plant.constant[~plant.connected] = plant.v[~plant.connected]
    plant.settle(np.array([last[str(p)] for p in plant.states]), plant.u)


NO_EFFECT_REASON = "possible causes: dead band, command beyond its range, controller off"


def no_effect_notes(plant: CutPlant, b: Array) -> tuple[str, ...]:
    """Notes on inputs without effect and on open loops; `b`: the matrix B of the linear model."""
    if not len(b):
        return ()
    inlets = plant.cut.inputs[: b.shape[1]]
    without = [inlet.name for inlet, column in zip(inlets, b.T, strict=True) if not column.any()]
    opened = [str(port) for port in _open_loops(plant)]
    faults = {"no state depends on": without, "loops are open at": opened}
    return tuple(
        f"at this operating point {fault} {', '.join(names)} ({NO_EFFECT_REASON})"
        for fault, names in faults.items()
        if names
    )


def _commanding(plant: CutPlant) -> set[str]:
    """Components with external inputs, and those that only pass on what these give, such as an actuation."""
    found = {port.component for inlet in plant.cut.inputs for port, _ in inlet.targets}
    sources: dict[str, set[str]] = {}
    for i, j in zip(*np.nonzero(plant.connections), strict=True):
        sources.setdefault(plant.inputs[i].component, set()).add(plant.outputs[j].component)
    while passing := {part for part, given in sources.items() if given <= found} - found:
        found |= passing
    return found


def _open_loops(plant: CutPlant) -> Iterator[Port]:
    """Outputs without effect at this operating point, of components with external inputs (`_commanding`).

    Such an output is connected to an input on which a state may depend by declaration, but no state depends
    on its connected inputs here. Components without external inputs, such as a machine behind a controller,
    are left out, and so are signals to components with external inputs, such as the speeds that a controller
    measures: the loop is open where its command leaves. A pressure that does not depend on a position without
    flow, for example, opens no loop.
    """
    blocks = plant.blocks()
    effective = np.asarray((blocks.b @ plant.loop_inverse(blocks.d)).any(axis=0))
    with_inputs = _commanding(plant)
    for j, output in enumerate(plant.outputs):
        targets = [i for i, row in enumerate(plant.connections) if row[j]]
        if {plant.inputs[i].component for i in targets} & with_inputs:
            continue
        ports = [plant.inputs[i] for i in targets]
        interfaces = [plant.system.components[p.component].interface for p in ports]
        declared = any(i.may_affect_states(p.variable) for i, p in zip(interfaces, ports, strict=True))
        if output.component in with_inputs and declared and not effective[targets].any():
            yield output


EXPERIMENT_LENGTH = 1.0  # [s], for the set-up of the FMUs; no result depends on it


@documented(LinearArguments)
def linearize(
    system: System | str | Path, scenario: ScenarioSource = None, **options: Unpack[LinearArguments]
) -> LinearModel:
    """A, B, C, D of a system, from the directional derivatives of its FMUs in model exchange.

    system       a System, or the path of an .ssp, .ssd or .fmu file
    scenario     with `time`: inputs of that run over time, as for `run`

    `set` can also contain inputs of the linear model that are connected in a run.

    Raises Problem for a mistake, and for an FMU without Model Exchange.
    """
    given = chosen(LinearOptions, options, "linearize")
    time, steady, speeds, step, start_values = given.time, given.steady, given.speeds, given.step, given.set
    full = configured(system, cut=given.cut, swap=given.swap, parameters=given.parameters)
    if time is None and (scenario is not None or step is not None):
        raise Problem(
            "--scenario, --step: expected --time as well; without --time the operating point is the start"
        )
    if speeds and not steady:
        raise Problem("--speed: expected --steady as well, got --speed alone")
    trace, label, _ = read_scenario(scenario)
    released = drive(full, trace, label).released(full) if trace is not None else full
    cut = cut_at_inputs(full, given.inputs, steady, released)
    if time is not None:
        _refuse_connected(full, start_values, "--scenario sets the input in the run")
    _refuse_connected(cut.system, start_values, "--input with the same name removes the connection")
    # without those of components that are only in the full system
    values = {n: v for n, v in start_values.items() if cut.system.has(n) or not full.has(n)}
    cut = replace(cut, system=cut.system.with_start(values))
    ports = matching_outputs(cut.system, given.outputs)
    start = full.start or 0.0
    plant = CutPlant(cut)
    try:
        with doubts_told(cut.system):
            plant.start((start, start + EXPERIMENT_LENGTH))
        warnings = with_doubts(full, doubtful_starts(cut.system)).warnings
        notes = built_notes(full) + warnings + cut.notes + plant.notes
        if time is None:
            plant.settle(plant.x.copy(), plant.u)
        else:
            settle_at_time(plant, full.with_start(start_values), scenario, time, step)
        told, moving = find_steady_state(plant, speeds) if steady else ((), ())
        model = _result(plant, ports, start if time is None else time, notes + told)
        return replace(model, moving=moving)
    finally:
        plant.close()


def _refuse_connected(system: System, names: Iterable[str], instead: str) -> None:
    """Refuse names of inputs that are connected."""
    connections = {c.target: c for c in system.connections}
    for name in filter(system.has, names):
        for port, _ in system.targets(name):
            if port in connections:
                raise Problem(f"--set {name}: the input is connected ({connections[port]}); {instead}")


def _result(plant: CutPlant, ports: Sequence[Port], time: float, notes: tuple[str, ...]) -> LinearModel:
    matrices = plant.matrices()
    for name, matrix in zip("ABCD", matrices, strict=True):
        if not np.isfinite(matrix).all():
            raise Problem(
                f"{plant.system.name}: matrix {name}: expected finite values, got infinite ones or NaN"
            )
    index = {port: i for i, port in enumerate(plant.outputs)}
    rows = [index[port] for port in ports]
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
