"""Reference results: the work cycle of the machine, and one experiment for each FMU, which carries it as its
proof.

    python -m fmus.machine.reference DATA_FOLDER

writes scenario and trace of the work cycle, the program of the operator, and the experiments. It is to be run
whenever equations or numbers have changed.

The trace comes from the monolithic model (`fmus.monolith`), which shares no coupling and no solver with FMUs.
Its meta file, `data/reference/work_cycle.toml`, is written by hand and says why the trace changed last.

An experiment takes its inputs from the machine at work and its result from the equations of the subsystem
alone. At each communication point the inputs are set; within a step input i moves as the FMU moves it,

    u_i(tau) = u_i + r_i tau + s_i tau^2 / 2 + ...      r, s: the inputs that carry its derivatives, as set

(docs/design.md, "Inputs inside a step"), and CVODES solves dx/dt = f(x, u(tau), p) from step to step. So a
tool that sets the inputs at the communication points and holds them reproduces the result, whatever the step
does to the accuracy of a coupling.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from math import factorial
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from fmus.contract import Subsystem, column, quantities, symbolic
from fmus.controller import CONTROLLER
from fmus.controller.paths import experiment_inputs
from fmus.export.interface import interface_of
from fmus.export.ls_ref import COMMUNICATION_STEP as STEP
from fmus.export.ls_ref import data_file, reference_parameters
from fmus.machine.one_block import HARVESTER
from fmus.machine.parts import (
    COMMAND_WIRES,
    CONNECTIONS,
    CONTROL_WIRES,
    FAMILIES,
    INPUTS,
    SUBSYSTEMS,
    SUPPLY_WIRES,
)
from fmus.machine.work_cycle import COMMANDS, WORK_CYCLE, WORK_CYCLE_STOP, program_numbers, sample
from fmus.monolith import join, simulate
from fmus.operator_input.model import AXES, OPERATOR
from fmus.parameters import Values, values, write
from orchestrator.base.files import write_columns

Array = NDArray[np.float64]
STOP = 8.0  # s: each lever moved both ways, or nearly
EXPERIMENT_EVERY = 4  # steps between two rows of the result
EXPERIMENT_TOLERANCE = 1e-11  # relative, and absolute times the nominal value
INPUT_DIGITS, RESULT_DIGITS = 10, 9
REST = 1e-6  # of the nominal value: a signal that moves less is at rest


def machine() -> dict[str, Array]:
    """`component.variable` -> samples (n,) every STEP from 0 to STOP: all signals of the machine at work."""
    count = round(STOP / STEP)
    time = np.arange(2 * count + 1) * STEP / 2  # corners of the strokes lie on this grid, too
    commanded = symbolic(OPERATOR).function().map(time.size)
    p = np.tile(list(values(OPERATOR).p.values()), (time.size, 1)).T
    commands = np.asarray(commanded(time[None, :], ca.DM(0, time.size), p)[1])
    known = {
        f"operator_input.{n}": row for n, row in zip(quantities(OPERATOR.outputs), commands, strict=True)
    }
    known["operator_input.clock"] = time
    model = join(SUBSYSTEMS, CONNECTIONS, INPUTS)
    sources = {end: known[source] for source, end in COMMAND_WIRES}
    constant = dict(zip(model.inputs, model.u, strict=True))
    driven = {n: sources.get(ends[0], np.full(time.size, constant[n])) for n, ends in INPUTS.items()}
    _, outputs = simulate(model, time, np.column_stack(list(driven.values())), tolerance=EXPERIMENT_TOLERANCE)
    known |= dict(zip(model.output_names, outputs.T, strict=True))
    known |= {end: driven[n] for n, ends in INPUTS.items() for end in ends}
    wires = (*CONNECTIONS, *SUPPLY_WIRES, *CONTROL_WIRES)
    known |= {target: known[source] for source, target in wires if source in known}
    known |= {f"controller.{n}": samples for n, samples in experiment_inputs(time).items()}
    known |= {f"controller.{n}_lever": known[f"operator_input.{n}_command"] for n in AXES}
    return {name: samples[::2] for name, samples in (known | driven).items()}


def stimuli(sub: Subsystem, known: Mapping[str, Array]) -> dict[str, Array]:
    """Inputs that move and matter -> samples (n,), rounded to the digits of the file."""
    model, declared = symbolic(sub), quantities(sub.inputs)
    equations, rates = column(model.dx, model.y), {q.rate for q in declared.values()}
    found = {}
    for i, name in enumerate(declared):
        samples = known.get(f"{sub.component}.{name}", known.get(name))
        used = name in rates or ca.depends_on(equations, model.u[i])  # else it only initialises
        if used and samples is not None and np.ptp(samples) > 0:
            found[name] = np.array([float(f"{x:.{INPUT_DIGITS}g}") for x in samples])
    return found


def start_values(sub: Subsystem, moving: Mapping[str, Array]) -> Values:
    """The numbers of the experiment: those of the subsystem, inputs as the machine starts."""
    v = values(sub)
    return Values(v.p, {n: float(moving[n][0]) if n in moving else u for n, u in v.u.items()}, v.x)


# ---- the solution


def solve(sub: Subsystem, v: Values, moving: Mapping[str, Array], count: int) -> dict[str, Array]:
    """Outputs -> samples (count + 1,): at the end of each step, the inputs as they have moved by then."""
    model = symbolic(sub)
    nominal = np.array([q.nominal for q in quantities(sub.states).values()])
    tau, z = ca.SX.sym("tau"), ca.SX.sym("z", nominal.size)
    at = _moved(sub, model.u, tau)
    f, g = model.function(), model.initial()
    ode = {"x": z, "t": tau, "p": column(model.u, model.p), "ode": f(z * nominal, at, model.p)[0] / nominal}
    options = {"reltol": EXPERIMENT_TOLERANCE, "abstol": EXPERIMENT_TOLERANCE, "max_num_steps": 1_000_000}
    step = ca.integrator("step", "cvodes", ode, 0.0, STEP, options)
    end = ca.Function(
        "end", [model.x, model.u, model.p], [f(model.x, ca.substitute(at, tau, STEP), model.p)[1]]
    )
    inputs = [[float(moving[n][k]) if n in moving else u for n, u in v.u.items()] for k in range(count + 1)]
    p = list(v.p.values())
    x = g(list(v.x.values()), inputs[0], p).full()[:, 0]
    rows = [f(x, inputs[0], p)[1].full()[:, 0]]
    for u in inputs[:-1]:
        x = step(x0=x / nominal, p=[*u, *p])["xf"].full()[:, 0] * nominal
        rows.append(end(x, u, p).full()[:, 0])
    return dict(zip(quantities(sub.outputs), np.array(rows).T, strict=True))


def _moved(sub: Subsystem, u: ca.SX, tau: ca.SX) -> Any:
    """The inputs at tau, each moved by the inputs that carry its derivatives."""
    declared = quantities(sub.inputs)
    names = list(declared)
    terms = []
    for name in names:
        value, order, rate = u[names.index(name)], 0, declared[name].rate
        while rate is not None:
            order += 1
            value = value + u[names.index(rate)] * tau**order / factorial(order)
            rate = declared[rate].rate
        terms.append(value)
    return column(*terms)


def signals(sub: Subsystem, moving: Mapping[str, Array], found: Mapping[str, Array]) -> list[str]:
    """What is compared: outputs that move and that do not jump when the next inputs are set.

    Inputs without a rate jump at each communication point. Watched outputs are warnings, not signals.
    """
    model, outputs = symbolic(sub), quantities(sub.outputs)
    jumping = [
        model.u[i] for i, (n, q) in enumerate(quantities(sub.inputs).items()) if n in moving and not q.rate
    ]
    return [
        name
        for i, (name, q) in enumerate(outputs.items())
        if q.warn_above is None
        and np.ptp(found[name]) > REST * q.nominal
        and not ca.depends_on(model.y[i], column(*jumping))
    ]


def write_experiments() -> None:
    """Write the experiments of all variants, of the operator and of the whole."""
    known = machine()
    for sub in (
        *(v for variants in FAMILIES.values() for v in variants.values()),
        OPERATOR,
        CONTROLLER,
        HARVESTER,
    ):
        write_reference(sub, known)


def write_reference(sub: Subsystem, known: Mapping[str, Array]) -> None:
    """Write the files of the experiment beside the subsystem; its variants have the inputs in common."""
    moving = stimuli(sub, known)
    count = round(STOP / STEP)
    time = np.arange(count + 1) * STEP
    if moving and sub.name == sub.component:
        rows = np.column_stack([time, *moving.values()])
        write_columns(data_file(sub, "input.csv"), ("time", *moving), rows, INPUT_DIGITS)
    if not quantities(sub.states):
        return  # outputs that follow the inputs at once: nothing to solve, nothing to prove
    v = start_values(sub, moving)
    found = solve(sub, v, moving, count)
    shown = signals(sub, moving, found)
    rows = np.column_stack([time, *(found[n] for n in shown)])[::EXPERIMENT_EVERY]
    write_columns(data_file(sub, "result.csv"), ("time", *shown), rows, RESULT_DIGITS)
    face = interface_of(sub, v)
    settable = {
        x.name: x.start for x in (*face.parameters, *face.inputs, *face.states) if x.start is not None
    }
    data_file(sub, "parameters.ssv").write_bytes(reference_parameters(sub, settable))


# ---- the work cycle

TOLERANCE = 1e-11  # relative, of CVODES
EVERY = 4  # the trace keeps every 4th sample: 50 Hz, above twice the fastest structural mode (17 Hz)
SIGNALS = (
    *("swing.swing_command", "boom_stick.boom_command", "boom_stick.stick_command"),
    *(f"manipulator.{joint}_{kind}" for kind in ("angle", "speed") for joint in ("swing", "boom", "stick")),
    *("manipulator.boom_position", "manipulator.stick_position"),
    *(
        "manipulator.elbow_radius",
        "manipulator.elbow_height",
        "manipulator.tip_radius",
        "manipulator.tip_height",
    ),
    *("swing.swing_pressure_a", "swing.swing_pressure_b", "swing.swing_flow_a", "swing.swing_flow_b"),
    *(
        f"boom_stick.{a}_{side}_{kind}"
        for kind in ("pressure", "flow")
        for a in ("boom", "stick")
        for side in ("head", "rod")
    ),
    *("swing.swing_torque", "boom_stick.boom_force", "boom_stick.stick_force"),
)


def work_cycle() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Time (n,) and commands (n, 3) of the work cycle, rounded so that ten digits hold them."""
    time, commands = sample(WORK_CYCLE, WORK_CYCLE_STOP)
    return time, np.round(commands, 9)


def trace() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Time (n,) and SIGNALS (n, m) of the monolithic model over the work cycle, at 200 Hz."""
    time, commands = work_cycle()
    model = join(SUBSYSTEMS, CONNECTIONS, INPUTS)
    inputs = np.tile(model.u, (time.size, 1))
    inputs[:, [model.inputs.index(name) for name in COMMANDS]] = commands
    _, outputs = simulate(model, time, inputs, tolerance=TOLERANCE)
    driven = {
        target: inputs[:, model.inputs.index(name)] for name, targets in INPUTS.items() for target in targets
    }
    known = driven | dict(zip(model.output_names, outputs.T, strict=True))
    return time, np.column_stack([known[name] for name in SIGNALS])


def main(folder: Path) -> None:
    """Write scenario and trace below `folder`; the operator's program and experiments beside the models."""
    write(OPERATOR.folder / "parameters.toml", program_numbers())
    time, commands = work_cycle()
    write_columns(
        folder / "scenarios" / "work_cycle.csv", ("time", *COMMANDS), np.column_stack([time, commands]), 10
    )
    time, signals = trace()
    kept = np.column_stack([time, signals])[::EVERY]
    write_columns(folder / "reference" / "work_cycle.csv", ("time", *SIGNALS), kept, 9)
    write_experiments()


if __name__ == "__main__":
    if len(sys.argv) != 2 or not Path(sys.argv[1]).is_dir():
        sys.exit("expected one argument, the folder data: python -m fmus.machine.reference data")
    main(Path(sys.argv[1]))
