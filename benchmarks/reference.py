"""Reference results: the work cycle of the machine, and one reference experiment for each FMU (FMI-LS-REF).

    python -m benchmarks.reference DATA_FOLDER

writes scenarios and trace of the work cycle, the program of the operator, and the experiments. Run it after
every change of equations or parameter values.

The trace is calculated with the monolithic model (`fmus.monolith`), which has neither coupling nor solver in
common with the FMUs. It has all outputs of the machine. The head of its meta file,
`data/reference/work_cycle.toml`, is written by hand and contains the reason of the last change of the trace;
`python -m benchmarks.planted` writes the limits below it.

Inputs of an experiment are signals of the machine in operation. Its result is calculated with the equations
of the subsystem alone. Inputs are set at each communication point. Within a step input i is extrapolated as
in the FMU,

    u_i(tau) = u_i + r_i tau + s_i tau^2 / 2 + ...      r, s: the rate inputs of u_i, as set

(docs/design.md, "Inputs inside a step"), and CVODES solves dx/dt = f(x, u(tau), p) from step to step. So a
tool that sets the inputs at the communication points and holds them reproduces the result for any coupling
accuracy.
"""

import sys
from collections.abc import Mapping, Sequence
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
from fmus.export.model_description import COMMUNICATION_STEP as STEP
from fmus.export.model_description import data_file, reference_parameters
from fmus.machine.one_block import HARVESTER
from fmus.machine.parts import FAMILIES, FERIC
from fmus.monolith import join, simulate
from fmus.operator_input import OPERATOR
from fmus.operator_input.model import AXES
from fmus.operator_input.work_cycle import (
    COMMANDS,
    PROGRAMS,
    WITH_STEMS,
    WORK_CYCLE,
    WORK_CYCLE_STOP,
    Stem,
    payload,
    sample,
)
from fmus.parameters import Values, values
from fmus.supply import SUPPLY
from fmus.valve_actuation import ACTUATION
from orchestrator.base.files import write_columns, write_whole
from orchestrator.base.signals import CONSTANT_OF_NOMINAL

Array = NDArray[np.float64]
STOP = 8.0  # s, with strokes of each lever
STEM = Stem(3.0, 200.0, 3.0)  # of the parts that carry it: taken up and dropped in motion
EXPERIMENT_EVERY = 4  # communication steps between two rows of the result
EXPERIMENT_TOLERANCE = 1e-11  # relative, and absolute times the nominal value
INPUT_DIGITS, RESULT_DIGITS = 10, 9


def machine_signals(stems: Sequence[Stem] = ()) -> dict[str, Array]:
    """Signals of the machine in operation, `component.variable` -> samples (n,), every STEP up to STOP."""
    count = round(STOP / STEP)
    time = np.arange(2 * count + 1) * STEP / 2  # half steps, so that all corners of the strokes are samples
    commands = _outputs(OPERATOR, time[None, :], ca.DM(0, time.size))
    recorded = {f"operator_input.{n}": row for n, row in commands.items()}
    recorded["operator_input.clock"] = time
    model = join(FERIC.subsystems, FERIC.connections, FERIC.inputs)
    recorded["operator_input.payload_mass"] = payload(stems, time)
    sources = {end: recorded[source] for source, end in FERIC.operator_wires}
    constant = dict(zip(model.inputs, model.u, strict=True))
    driven = {n: sources.get(ends[0], np.full(time.size, constant[n])) for n, ends in FERIC.inputs.items()}
    _, outputs = simulate(model, time, np.column_stack(list(driven.values())), tolerance=EXPERIMENT_TOLERANCE)
    recorded |= dict(zip(model.output_names, outputs.T, strict=True))
    recorded |= {end: driven[n] for n, ends in FERIC.inputs.items() for end in ends}
    recorded |= _supplied(recorded)
    wires = (*FERIC.connections, *FERIC.supply_wires, *FERIC.controller_wires)
    recorded |= {target: recorded[source] for source, target in wires if source in recorded}
    recorded |= {f"controller.{n}": samples for n, samples in experiment_inputs(time).items()}
    recorded |= {f"controller.{n}_lever": recorded[f"operator_input.{n}_command"] for n in AXES}
    recorded |= {f"{ACTUATION.name}.{n}": commands[n] for n in quantities(ACTUATION.inputs)}
    return {name: samples[::2] for name, samples in (recorded | driven).items()}


def _supplied(recorded: Mapping[str, Array]) -> dict[str, Array]:
    """Outputs of the ideal supply, an algebraic function of what it gets from the drives."""
    sources = {target: source for source, target in FERIC.supply_wires}
    size = next(iter(recorded.values())).size
    names = (sources.get(f"{SUPPLY.name}.{n}", "") for n in quantities(SUPPLY.inputs))
    rows = np.array([recorded.get(n, np.zeros(size)) for n in names])
    return {f"{SUPPLY.name}.{n}": y for n, y in _outputs(SUPPLY, ca.DM(0, size), rows).items()}


def _outputs(sub: Subsystem, x: Any, u: Any) -> dict[str, Array]:
    """Outputs -> samples (n,) for samples of the states x (nx, n) and of the inputs u (nu, n)."""
    count = x.shape[1]
    p = np.tile(list(values(sub).p.values()), (count, 1)).T
    y = symbolic(sub).function().map(count)(x, u, p)[1].full()
    return dict(zip(quantities(sub.outputs), y, strict=True))


def stimuli(sub: Subsystem, recorded: Mapping[str, Array]) -> dict[str, Array]:
    """Inputs that vary and affect a variant of the part -> samples (n,), with the digits of the file."""
    declared = quantities(sub.inputs)
    models = [symbolic(s) for s in FAMILIES.get(sub.component, {sub.name: sub}).values()]
    rates = {q.rate for q in declared.values()}
    inputs = {}
    for i, name in enumerate(declared):
        samples = recorded.get(f"{sub.component}.{name}", recorded.get(name))
        used = name in rates or any(  # otherwise only for initialisation
            ca.depends_on(column(m.dx, m.y), m.u[i]) for m in models
        )
        if used and samples is not None and np.ptp(samples) > 0:
            inputs[name] = np.array([float(f"{x:.{INPUT_DIGITS}g}") for x in samples])
    return inputs


def start_values(sub: Subsystem, inputs: Mapping[str, Array]) -> Values:
    """Values of the experiment: those of the subsystem, with the first samples of the inputs."""
    v = values(sub)
    return Values(v.p, {n: float(inputs[n][0]) if n in inputs else u for n, u in v.u.items()}, v.x)


# ---- result of an experiment


def solve(sub: Subsystem, v: Values, inputs: Mapping[str, Array], count: int) -> dict[str, Array]:
    """Outputs -> samples (count + 1,) at the end of each step, with the extrapolated inputs."""
    model = symbolic(sub)
    nominal = np.array([q.nominal for q in quantities(sub.states).values()])
    tau, z = ca.SX.sym("tau"), ca.SX.sym("z", nominal.size)
    extrapolated = _extrapolated(sub, model.u, tau)
    f, g = model.function(), model.initial()
    ode = {
        "x": z,
        "t": tau,
        "p": column(model.u, model.p),
        "ode": f(z * nominal, extrapolated, model.p)[0] / nominal,
    }
    options = {"reltol": EXPERIMENT_TOLERANCE, "abstol": EXPERIMENT_TOLERANCE, "max_num_steps": 1_000_000}
    step = ca.integrator("step", "cvodes", ode, 0.0, STEP, options)
    end = ca.Function(
        "end", [model.x, model.u, model.p], [f(model.x, ca.substitute(extrapolated, tau, STEP), model.p)[1]]
    )
    samples = [[float(inputs[n][k]) if n in inputs else u for n, u in v.u.items()] for k in range(count + 1)]
    p = list(v.p.values())
    x = g(list(v.x.values()), samples[0], p).full()[:, 0]
    rows = [f(x, samples[0], p)[1].full()[:, 0]]
    for u in samples[:-1]:
        x = step(x0=x / nominal, p=[*u, *p])["xf"].full()[:, 0] * nominal
        rows.append(end(x, u, p).full()[:, 0])
    return dict(zip(quantities(sub.outputs), np.array(rows).T, strict=True))


def _extrapolated(sub: Subsystem, u: ca.SX, tau: ca.SX) -> Any:
    """Inputs at tau, each extrapolated by its rate inputs."""
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


def compared_outputs(sub: Subsystem, inputs: Mapping[str, Array], result: Mapping[str, Array]) -> list[str]:
    """Outputs of the result: those that vary and do not jump when the next inputs are set.

    Inputs without a rate jump at each communication point. Excluded are outputs with a warning below
    their nominal value, such as forces of end stops: in ordinary operation they are zero.
    """
    model, outputs = symbolic(sub), quantities(sub.outputs)
    jumping = [
        model.u[i] for i, (n, q) in enumerate(quantities(sub.inputs).items()) if n in inputs and not q.rate
    ]
    return [
        name
        for i, (name, q) in enumerate(outputs.items())
        if (q.warn_above is None or q.warn_above > q.nominal)
        and np.ptp(result[name]) > CONSTANT_OF_NOMINAL * q.nominal
        and not ca.depends_on(model.y[i], column(*jumping))
    ]


def write_experiments() -> None:
    """Write the experiments of all variants, operator, actuation, controller and composed machine."""
    empty, loaded = machine_signals(), machine_signals([STEM])
    variants = [sub for family in FAMILIES.values() for sub in family.values()]
    for sub in (*variants, OPERATOR, ACTUATION, CONTROLLER, HARVESTER):
        write_reference(sub, loaded if "payload_mass" in quantities(sub.inputs) else empty)


def write_reference(sub: Subsystem, recorded: Mapping[str, Array]) -> None:
    """Write the files of the experiment to the folder of the subsystem; its variants share the inputs."""
    inputs = stimuli(sub, recorded)
    count = round(STOP / STEP)
    time = np.arange(count + 1) * STEP
    if inputs and sub.name == sub.component:
        rows = np.column_stack([time, *inputs.values()])
        write_columns(data_file(sub, "input.csv"), ("time", *inputs), rows, INPUT_DIGITS)
    if not quantities(sub.states):
        return  # outputs are algebraic functions of the inputs, so there is nothing to solve
    v = start_values(sub, inputs)
    result = solve(sub, v, inputs, count)
    compared = compared_outputs(sub, inputs, result)
    rows = np.column_stack([time, *(result[n] for n in compared)])[::EXPERIMENT_EVERY]
    write_columns(data_file(sub, "result.csv"), ("time", *compared), rows, RESULT_DIGITS)
    interface = interface_of(sub, v)
    settable = {
        x.name: x.start
        for x in (*interface.parameters, *interface.inputs, *interface.states)
        if x.start is not None
    }
    write_whole(data_file(sub, "parameters.ssv"), reference_parameters(sub, settable))


# ---- the work cycle

TOLERANCE = 1e-11  # relative tolerance of CVODES
EVERY = 4  # samples per row of the trace: 50 Hz, above twice the fastest structural mode (17 Hz)
SIGNALS = (
    *("swing.swing_command", "boom_stick.boom_command", "boom_stick.stick_command"),
    *(f"{sub.name}.{n}" for sub in (*FERIC.subsystems.values(), SUPPLY) for n in quantities(sub.outputs)),
)


def work_cycle() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Time (n,) and commands (n, 3) of the work cycle, rounded to fit into ten digits."""
    time, commands = sample(WORK_CYCLE, WORK_CYCLE_STOP)
    return time, np.round(commands, 9)


def write_with_stems(path: Path) -> None:
    """Write the scenario of the work cycle with stems; each step of the payload is two rows, 1 ms apart."""
    time, commands = work_cycle()
    moves = PROGRAMS[WITH_STEMS]
    steps = [t for s in moves if isinstance(s, Stem) for t in (s.start, s.start + s.hold)]
    rows = np.unique(np.round([*time, *(t - 1e-3 for t in steps)], 9))
    columns = [np.interp(rows, time, column) for column in commands.T]
    table = np.column_stack([rows, *columns, payload(moves, rows + 1e-9)])
    write_columns(path, ("time", *COMMANDS, "payload_mass"), table, 10)


def trace() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Time (n,) and SIGNALS (n, m) of the monolithic model over the work cycle, at 200 Hz."""
    time, commands = work_cycle()
    model = join(FERIC.subsystems, FERIC.connections, FERIC.inputs)
    inputs = np.tile(model.u, (time.size, 1))
    inputs[:, [model.inputs.index(name) for name in COMMANDS]] = commands
    states, _ = simulate(model, time, inputs, tolerance=TOLERANCE)
    # rates of the commands influence outputs only, such as the rate of a load pressure
    operated = _outputs(OPERATOR, time[None, :], ca.DM(0, time.size))
    for name in COMMANDS:
        inputs[:, model.inputs.index(f"{name}_rate")] = operated[f"{name}_rate"]
    parameters = ca.repmat(ca.DM(model.p), 1, time.size)
    outputs = model.outputs.map(time.size)(states.T, inputs.T, parameters).full()
    driven = {
        target: inputs[:, model.inputs.index(name)]
        for name, targets in FERIC.inputs.items()
        for target in targets
    }
    recorded = driven | dict(zip(model.output_names, outputs, strict=True))
    recorded |= _supplied(recorded)
    return time, np.column_stack([recorded[name] for name in SIGNALS])


def main(folder: Path) -> None:
    """Write scenario and trace to `folder`; operator's program and experiments to the models' folders."""
    time, commands = work_cycle()
    write_columns(
        folder / "scenarios" / "work_cycle.csv", ("time", *COMMANDS), np.column_stack([time, commands]), 10
    )
    write_with_stems(folder / "scenarios" / f"{WITH_STEMS}.csv")
    time, signals = trace()
    rows = np.column_stack([time, signals])[::EVERY]
    write_columns(folder / "reference" / "work_cycle.csv", ("time", *SIGNALS), rows, 9)
    write_experiments()


if __name__ == "__main__":
    if len(sys.argv) != 2 or not Path(sys.argv[1]).is_dir():
        sys.exit("python -m benchmarks.reference: expected one argument, the folder data")
    main(Path(sys.argv[1]))
