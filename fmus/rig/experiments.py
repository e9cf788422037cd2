"""Which experiments there are: section 4 of the paper, each with its commands and instruments.

On the benches, levels are stepped: held, with straight lines between them. On the whole machine an operator
moves one joint at a time, then all of them for training, and drives the work cycle that is held out. Training
covers the work space, small and large commands and all pairs of axes together; no part of it repeats the work
cycle. All corners of commands lie on the 200 Hz grid.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache, partial
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from fmus.machine.parts import Wires, parts, wiring
from fmus.machine.poses import JOINTS, NOMINAL, POSES, Pose, parameter
from fmus.machine.work_cycle import COMMANDS, RATE, WORK_CYCLE, WORK_CYCLE_STOP, Move, sample
from fmus.monolith import Monolith, join, simulate
from fmus.rig.benches import EDGES, TOLERANCE, detailed, locked_motor, stick_hose, valve
from fmus.rig.instruments import ANGLE, COMMAND, FLOW, LEAKAGE, PRESSURE, Condition, Experiment, Instrument
from orchestrator.base.errors import Problem

Array = NDArray[np.float64]


def levels(values: Sequence[float], hold: float, ramp: float, rest: float = 1.0) -> tuple[Array, Array]:
    """Time and values, shape (n,): the first level for `rest` [s], then each next one for `hold` [s].

    The `ramp` [s] towards a level is the beginning of its hold.
    """
    starts = rest + hold * np.arange(len(values) - 1)
    corners = np.concatenate([[0.0], np.column_stack([starts, starts + ramp]).ravel(), [starts[-1] + hold]])
    held = np.repeat(np.asarray(values, dtype=float), 2)
    time = np.arange(round(corners[-1] * RATE) + 1) / RATE
    return time, np.interp(time, corners, held)


def up_and_down(steps: Sequence[float]) -> list[float]:
    """Zero, the steps upwards, and down again to zero."""
    up = [0.0, *steps]
    return up + up[-2::-1]


# ---- commands on the whole machine -----------------------------------------------------------------

# strokes there and back, slow and fast; (command [V], hold [s]) of each
_STROKES: Mapping[str, Sequence[tuple[float, float]]] = {
    "swing": ((2.0, 1.5), (-3.0, 1.2), (3.5, 1.0), (-2.5, 1.0), (1.5, 1.5), (-3.2, 0.8)),
    "boom": ((2.2, 1.4), (-1.6, 1.8), (3.0, 1.0), (-2.4, 1.2), (1.5, 1.6), (-1.4, 1.4), (3.2, 0.7)),
    "stick": ((2.0, 1.6), (-2.0, 1.6), (3.0, 1.1), (-2.6, 1.2), (1.5, 1.8), (-1.5, 1.8), (3.2, 0.8)),
}
_RISE = {"swing": 0.5, "boom": 0.3, "stick": 0.4}  # s
_FALL = {"swing": 1.3, "boom": 0.5, "stick": 0.6}
_PAUSE = 0.3  # s between strokes


def strokes(joint: str, sign: int = 1) -> list[Move]:
    """One joint there and back from 1 s on, several times; `sign` -1 begins the other way."""
    moves, start = [], 1.0
    for command, hold in _STROKES[joint]:
        moves.append(Move(joint, start, sign * command, _RISE[joint], hold, _FALL[joint]))
        start = round(stop(moves[-1:]) + _PAUSE, 3)
    return moves


def stop(moves: Sequence[Move]) -> float:
    """When the last move is over [s]."""
    return round(max(m.start + m.rise + m.hold + m.fall for m in moves), 3)


# start poses of the damping runs and the way they begin: inside the stroke of the joint that moves, and with
# different levers dl/dq in the two runs, so that friction of piston and joint can be told apart
DAMPING: Mapping[str, Sequence[tuple[Pose, int]]] = {
    "swing": ((Pose(0.2, -1.4), 1), (Pose(0.4, -1.9), -1)),
    "boom": ((Pose(0.0, -1.4), 1), (Pose(0.5, -1.8), 1)),
    "stick": ((Pose(0.4, -1.1), 1), (Pose(0.3, -2.0), -1)),
}

TRAIN_1: tuple[Move, ...] = (  # low and near, then high and far
    Move("boom", 1.0, 2.8, 0.4, 0.9, 0.6),
    Move("swing", 1.6, 2.6, 0.5, 1.3, 1.4),
    Move("stick", 2.6, -2.8, 0.4, 1.2, 0.6),
    Move("boom", 4.0, 4.2, 0.5, 0.7, 0.9),
    Move("swing", 5.2, -1.6, 0.4, 1.0, 0.8),
    Move("stick", 5.6, -1.5, 0.4, 1.4, 0.5),
    Move("boom", 7.4, -2.2, 0.4, 1.4, 0.6),
    Move("swing", 8.2, -3.6, 0.6, 1.5, 1.6),
    Move("stick", 9.0, 3.2, 0.4, 1.0, 0.6),
    Move("boom", 10.8, 1.4, 0.3, 1.0, 0.4),
    Move("stick", 12.0, 1.6, 0.3, 0.9, 0.4),
    Move("swing", 12.4, 1.4, 0.4, 1.2, 0.8),
    Move("boom", 13.6, 3.2, 0.4, 0.8, 0.7),
    Move("swing", 15.2, 3.8, 0.7, 1.2, 1.8),
    Move("stick", 15.6, -3.4, 0.5, 1.0, 0.8),
    Move("boom", 17.6, -1.5, 0.4, 1.6, 0.5),
    Move("stick", 18.6, 2.4, 0.4, 1.3, 0.6),
    Move("swing", 19.6, -2.2, 0.5, 0.9, 1.0),
    Move("boom", 21.0, -2.8, 0.5, 0.9, 0.8),
    Move("stick", 22.0, 4.2, 0.6, 0.7, 1.0),
    Move("swing", 23.0, -2.8, 0.5, 1.0, 1.4),
    Move("boom", 24.2, 1.8, 0.3, 0.8, 0.5),
    Move("stick", 25.2, -1.8, 0.4, 1.0, 0.5),
    Move("swing", 26.4, 1.8, 0.4, 0.6, 0.9),
    Move("boom", 27.0, -1.6, 0.4, 0.8, 0.5),
)
TRAIN_2: tuple[Move, ...] = (  # far and high, then near and low
    Move("stick", 1.0, 2.6, 0.4, 1.3, 0.6),
    Move("swing", 1.4, -3.0, 0.6, 1.4, 1.5),
    Move("boom", 2.2, -2.6, 0.4, 1.2, 0.7),
    Move("stick", 4.4, 1.5, 0.3, 1.2, 0.4),
    Move("boom", 5.0, 1.6, 0.3, 1.1, 0.5),
    Move("swing", 5.6, 2.0, 0.4, 1.0, 1.0),
    Move("stick", 7.2, 3.6, 0.5, 0.9, 0.8),
    Move("boom", 8.0, -1.4, 0.4, 1.2, 0.5),
    Move("swing", 8.6, 3.4, 0.6, 1.3, 1.6),
    Move("boom", 10.6, 4.0, 0.5, 0.7, 0.9),
    Move("stick", 11.4, -2.2, 0.4, 1.2, 0.6),
    Move("swing", 12.8, 1.5, 0.4, 0.9, 0.8),
    Move("boom", 13.4, -2.4, 0.4, 1.1, 0.6),
    Move("stick", 14.6, -1.6, 0.4, 1.4, 0.5),
    Move("swing", 15.4, -3.8, 0.7, 1.4, 1.8),
    Move("boom", 16.2, 2.2, 0.4, 1.0, 0.5),
    Move("stick", 17.8, 2.9, 0.4, 0.9, 0.6),
    Move("boom", 19.2, -1.8, 0.4, 1.3, 0.5),
    Move("swing", 20.2, -1.5, 0.4, 1.2, 0.8),
    Move("stick", 20.8, -3.2, 0.5, 0.9, 0.8),
    Move("boom", 22.6, 3.0, 0.4, 0.9, 0.7),
    Move("swing", 23.2, 2.8, 0.6, 1.0, 1.4),
    Move("stick", 24.2, 1.8, 0.3, 1.0, 0.5),
    Move("boom", 25.6, -2.0, 0.4, 1.1, 0.6),
    Move("stick", 26.2, -2.4, 0.4, 0.8, 0.6),
)
TRAINING = ((TRAIN_1, Pose(-0.1, -1.5, -0.4)), (TRAIN_2, Pose(0.7, -0.95, 0.5)))
TRAINING_STOP = 30.0  # s each

# ---- experiments on the benches --------------------------------------------------------------------

HOLD = 2.0  # s: 0.5 s to settle and 300 samples
RAMP = 0.05  # s, from level to level

# fine below 2 V, where the edges open; the flow meter sees nothing up to about 1 V
VALVE_STEPS = (*np.arange(0.25, 2.01, 0.25), *np.arange(2.5, 10.01, 0.5))
# 25 flows, nearly evenly from 15 to 281 L/min
HOSE_STEPS = tuple(np.round(np.linspace(1.25, 10.0, 25), 3))
HOSE_THROTTLE = 1.05e11  # C_R [Pa.s2/m6]: 281 L/min at 10 V

# four groups: throttle C_R [Pa.s2/m6], levels of the command [V], hold and ramp [s]. Small throttles give
# fast flow, for the inertance; large ones fast pressure, for the capacitance. What goes up comes down again,
# so that errors of the 200 Hz clock at the corners cancel. Flows stay above the meters' dead zone.
GROUPS: tuple[tuple[float, Sequence[float], float, float], ...] = (
    (6e11, (3.0, 8.0) * 20, 0.5, 0.06),
    (1.5e12, (3.0, 6.0, 9.0, 6.0) * 10, 0.5, 0.06),
    (3e12, (2.5, 4.0, 10.0, 4.0) * 10, 0.5, 0.08),
    (6e12, (2.0, 6.0) * 20, 0.5, 0.08),
)

# locked motor: set pressures of the driven port [MPa] at a low and a medium pressure of the other one
MOTOR_STEPS = tuple(range(2, 21, 2))
MOTOR_OTHER = (2.0, 8.0)
MOTOR_HOLD, MOTOR_RAMP = 3.0, 0.2  # s


def _meters(signals: Mapping[str, Array], flow: Instrument = FLOW) -> dict[str, Instrument]:
    """The instrument of each signal, by its name."""
    kinds = {"command": COMMAND, "pressure": PRESSURE}
    return {name: kinds.get(name.split("_")[0], flow) for name in signals}


def _edge(edge: str, machine: str) -> Experiment:
    time, steps = levels(up_and_down(VALVE_STEPS), HOLD, RAMP)
    command = EDGES[edge] * steps
    signals = {"command": command, **valve(machine, edge, time, command)}
    return Experiment(
        name=f"valve_{edge.replace('-', '').lower()}",
        title=f"Valve edge {edge}, stepped command",
        procedure="valve",
        use="train",
        machine=machine,
        conditions={"edge": edge},
        time=time,
        signals=signals,
        instruments=_meters(signals),
    )


def _hose(
    machine: str,
    name: str,
    title: str,
    procedure: str,
    signals: dict[str, Array],
    time: Array,
) -> Experiment:
    p = detailed()
    conditions: dict[str, Condition] = {
        "length": (p.stick_hose_length, "m"),
        "diameter": (p.stick_hose_bore, "m"),
        "density": (p.density, "kg/m3"),
        "viscosity": (p.viscosity, "Pa.s"),
    }
    return Experiment(name, title, procedure, "train", machine, conditions, time, signals, _meters(signals))


def _hose_resistance(machine: str) -> Experiment:
    time, command = levels((0.0, *HOSE_STEPS), HOLD, RAMP)
    outputs = stick_hose(machine, HOSE_THROTTLE, time, command)
    signals = {n: outputs[n] for n in ("pressure_in", "pressure_out")} | {"flow": outputs["flow_out"]}
    title = "Hose of 4 m and 3/4 in, stepped flow"
    return _hose(machine, "hose_resistance", title, "hose_resistance", signals, time)


def _hose_dynamics(number: int, machine: str) -> Experiment:
    resistance, steps, hold, ramp = GROUPS[number - 1]
    time, command = levels((0.0, *steps), hold, ramp)
    signals = {"command": command, **stick_hose(machine, resistance, time, command)}
    title = f"Hose of 4 m and 3/4 in, fast changes, group {number}"
    return _hose(machine, f"hose_dynamics_{number}", title, "hose_dynamics", signals, time)


def _motor(driven: str, machine: str) -> Experiment:
    low, medium = MOTOR_OTHER
    steps = [2.0, *MOTOR_STEPS, *reversed(MOTOR_STEPS)]
    others = [low, *(low for _ in MOTOR_STEPS), *(medium for _ in MOTOR_STEPS)]
    time, this = levels(steps, MOTOR_HOLD, MOTOR_RAMP)
    _, other = levels(others, MOTOR_HOLD, MOTOR_RAMP)
    sides = (1e6 * this, 1e6 * other) if driven == "A" else (1e6 * other, 1e6 * this)
    signals = locked_motor(machine, time, *sides)
    return Experiment(
        name=f"motor_leakage_{1 if driven == 'A' else 2}",
        title=f"Swing motor, shaft locked, pressure at port {driven} stepped",
        procedure="motor_leakage",
        use="train",
        machine=machine,
        conditions={"shaft": "locked"},
        time=time,
        signals=signals,
        instruments=_meters(signals, LEAKAGE),
    )


BENCH_EXPERIMENTS: Mapping[str, Callable[[str], Experiment]] = {
    **{f"valve_{edge.replace('-', '').lower()}": partial(_edge, edge) for edge in EDGES},
    "hose_resistance": _hose_resistance,
    **{f"hose_dynamics_{n}": partial(_hose_dynamics, n) for n in range(1, len(GROUPS) + 1)},
    **{f"motor_leakage_{n}": partial(_motor, port) for n, port in enumerate("AB", 1)},
}

# ---- experiments on the whole machine --------------------------------------------------------------

_VARIANTS: Mapping[str, Mapping[str, str]] = {
    "lumped": {},
    "detailed": {
        "swing": "detailed",
        "boom_stick": "detailed",
        "manipulator": "pendulum_friction",
        "supply": "engine_pump",
    },
}


@cache
def _joined(machine: str) -> tuple[Monolith, Wires, Mapping[str, tuple[str, ...]]]:
    chosen = parts(**_VARIANTS[machine])
    wires, inputs = wiring(chosen)
    return join(chosen, wires, inputs), wires, inputs


def at_work(machine: str, moves: Sequence[Move], stop: float, pose: Pose) -> tuple[Array, dict[str, Array]]:
    """Time (n,) [s] at 200 Hz and all outputs and inputs (n,), as `component.variable`, SI."""
    model, wires, ends = _joined(machine)
    time, commands = sample(moves, stop)
    inputs = np.tile(model.u, (time.size, 1))
    inputs[:, [model.inputs.index(name) for name in COMMANDS]] = commands
    p, angles = model.p.copy(), {joint: getattr(pose, joint) for joint in (*JOINTS, "swing")}
    for joint, angle in angles.items():
        p[model.parameters.index(f"manipulator.{parameter(joint)}")] = angle
    _, outputs = simulate(model, time, inputs, p, TOLERANCE)
    known = dict(zip(model.output_names, outputs.T, strict=True))
    for column, name in zip(inputs.T, model.inputs, strict=True):
        known |= dict.fromkeys(ends[name], column)
    return time, known | {target: known[source] for source, target in wires}


INSTRUMENTS: Mapping[str, Instrument] = {
    **dict.fromkeys(("swing.swing_command", "boom_stick.boom_command", "boom_stick.stick_command"), COMMAND),
    **dict.fromkeys(("swing.supply_pressure", "swing.swing_pressure_a", "swing.swing_pressure_b"), PRESSURE),
    **{
        f"boom_stick.{joint}_{side}_pressure": PRESSURE
        for joint in ("boom", "stick")
        for side in ("head", "rod")
    },
    **{f"manipulator.{joint}_angle": ANGLE for joint in ("swing", "boom", "stick")},
    **dict.fromkeys(("swing.swing_flow_a", "boom_stick.boom_head_flow", "boom_stick.stick_head_flow"), FLOW),
}


def _at_work(
    name: str,
    title: str,
    moves: Sequence[Move],
    until: float,
    pose: Pose,
    conditions: Mapping[str, Condition],
    use: str,
    machine: str,
) -> Experiment:
    time, known = at_work(machine, moves, until, pose)
    return Experiment(
        name=name,
        title=title,
        procedure="damping" if "joint" in conditions else "machine",
        use=use,
        machine=machine,
        conditions=conditions,
        time=time,
        signals={n: known[n] for n in INSTRUMENTS},
        instruments=INSTRUMENTS,
        unseen={n: values for n, values in known.items() if n not in INSTRUMENTS},
    )


def _damping(joint: str, number: int, machine: str) -> Experiment:
    pose, sign = DAMPING[joint][number - 1]
    moves = strokes(joint, sign)
    title = f"Only the {joint} moves, pose {number}"
    name, conditions = f"damping_{joint}_{number}", {"joint": joint}
    return _at_work(name, title, moves, stop(moves) + 1.0, pose, conditions, "train", machine)


def _training(number: int, machine: str) -> Experiment:
    moves, pose = TRAINING[number - 1]
    title = f"All axes at work, training {number}"
    return _at_work(f"machine_train_{number}", title, moves, TRAINING_STOP, pose, {}, "train", machine)


def _test(machine: str) -> Experiment:
    title = "Work cycle, held out"
    return _at_work("machine_test", title, WORK_CYCLE, WORK_CYCLE_STOP, POSES[NOMINAL], {}, "test", machine)


MACHINE_EXPERIMENTS: Mapping[str, Callable[[str], Experiment]] = {
    **{
        f"damping_{joint}_{n}": partial(_damping, joint, n)
        for joint, runs in DAMPING.items()
        for n in range(1, len(runs) + 1)
    },
    **{f"machine_train_{n}": partial(_training, n) for n in range(1, len(TRAINING) + 1)},
    "machine_test": _test,
}

Machine: TypeAlias = Literal["lumped", "detailed"]
MACHINES: Mapping[str, str] = {
    "lumped": "lumped drives, rigid head, ideal supply: the set of the paper",
    "detailed": "detailed drives, friction with stiction, swinging head, supply of engine and pumps",
}
EXPERIMENTS: Mapping[str, Callable[[str], Experiment]] = {**BENCH_EXPERIMENTS, **MACHINE_EXPERIMENTS}


@cache
def experiment(name: str, machine: str) -> Experiment:
    """One experiment by the name of its files, simulated the first time it is asked for."""
    if machine not in MACHINES:
        raise Problem(f"machine is {machine!r}, expected {' or '.join(MACHINES)}")
    return EXPERIMENTS[name](machine)


def experiments(machine: str) -> Iterator[Experiment]:
    """All experiments on a machine, simulated one after the other."""
    return (experiment(name, machine) for name in EXPERIMENTS)
