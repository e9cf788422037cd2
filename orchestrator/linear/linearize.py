"""One call that linearises a system of FMUs at an operating point."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from orchestrator.errors import Problem
from orchestrator.files.trace import Trace
from orchestrator.linear.choice import choose
from orchestrator.linear.choice import outputs as chosen_outputs
from orchestrator.linear.operating import along
from orchestrator.linear.plant import Plant
from orchestrator.linear.result import Linear, Named
from orchestrator.linear.silent import silent
from orchestrator.linear.steady import steady as find_steady
from orchestrator.system.interface import Value
from orchestrator.system.parameters import with_sets
from orchestrator.system.ssp import load
from orchestrator.system.system import Port, System

SPAN = 1.0  # [s] that the FMUs are told the run lasts; nothing depends on it


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
) -> Linear:
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
    whole = (system if isinstance(system, System) else load(system)).swapped(swap or {})
    whole = with_sets(whole, parameters)
    if speeds and not steady:
        raise Problem("--speed: expected --steady with it, only a steady state has given speeds")
    choice = choose(whole, inputs, steady)
    if time is not None:
        _unfed(whole, set or {}, "--scenario, which plays it in the run")
    choice = replace(choice, system=_started(choice.system, whole, set or {}))
    ports = chosen_outputs(choice.system, outputs)
    start = whole.start or 0.0
    plant = Plant(choice)
    try:
        plant.start((start, start + SPAN))
        notes = choice.notes + plant.notes
        if time is None:
            plant.settle(plant.x.copy(), plant.u)
        else:
            notes += along(plant, whole.with_start(set or {}), scenario, time, step)
        if steady:
            notes += find_steady(plant, speeds)
        return _result(plant, ports, start if time is None else time, notes)
    finally:
        plant.close()


def _started(system: System, whole: System, values: Mapping[str, Value | str]) -> System:
    """With start values; those of components that were left out, such as levers, count in a run only."""
    _unfed(system, values, "--input of that name as well, which cuts the wire")
    return system.with_start({n: v for n, v in values.items() if system.has(n) or not whole.has(n)})


def _unfed(system: System, names: Iterable[str], instead: str) -> None:
    """No wire feeds what these names stand for."""
    wires = {c.target: c for c in system.connections}
    for name in filter(system.has, names):
        for port, _ in system.targets(name):
            if port in wires:
                raise Problem(f"--set {name}: fed by {wires[port]}; expected {instead}")


def _result(plant: Plant, ports: Sequence[Port], time: float, notes: tuple[str, ...]) -> Linear:
    matrices = plant.matrices()
    for name, matrix in zip("ABCD", matrices, strict=True):
        if not np.isfinite(matrix).all():
            raise Problem(f"{plant.system.name}: {name} has values that are not finite")
    at = {port: i for i, port in enumerate(plant.outputs)}
    rows = [at[port] for port in ports]
    count = plant.choice.asked
    inlets = plant.choice.inputs[:count]
    return Linear(
        name=plant.system.name,
        states=tuple(_named(plant.system, port) for port in plant.states),
        inputs=tuple(
            _named(plant.system, i.targets[0][0])._replace(name=i.name, unit=i.unit) for i in inlets
        ),
        outputs=tuple(_named(plant.system, port) for port in ports),
        a=matrices.a,
        b=matrices.b[:, :count],
        c=matrices.c[rows],
        d=matrices.d[rows, :count],
        x0=plant.x.copy(),
        u0=plant.u[:count],
        y0=plant.y[rows],
        f0=plant.f.copy(),
        time=time,
        notes=notes + silent(plant, matrices.b[:, :count]),
    )


def _named(system: System, port: Port) -> Named:
    variable = system.variable(port)
    return Named(str(port), variable.unit, variable.text, variable.nominal or 1.0)
