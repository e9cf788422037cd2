"""The experiments of the rig with their commands and instruments, after section 4 of the paper.

On the benches, commands and pressures are stepped: they are held at levels, with ramps between them. On the
whole machine an operator moves one joint in the damping experiments and all joints in the training
experiments; the test is the work cycle. Training covers the work space, small and large commands and all
pairs of axes, and contains no part of the work cycle. All corners of commands are on the 200 Hz grid.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cache, partial
from typing import TypeAlias

import numpy as np

from fmus.machine.machine import Connections, wiring
from fmus.machine.parts import FERIC
from fmus.machine.parts import MACHINES as VARIANTS
from fmus.machine.poses import JOINTS, NOMINAL, POSES, Pose, parameter
from fmus.monolith import Monolith, join, simulate
from fmus.operator_input.work_cycle import COMMANDS, RATE, WORK_CYCLE, WORK_CYCLE_STOP, Move, sample
from fmus.rig.benches import EDGES, TOLERANCE, detailed, locked_motor, stick_hose, valve
from fmus.rig.instruments import ANGLE, COMMAND, FLOW, LEAKAGE, PRESSURE, RETURN, Experiment
from orchestrator.base.errors import Problem
from orchestrator.data.description import Condition, SignalDescription
from orchestrator.data.table import Array


def levels(values: Sequence[float], hold: float, ramp: float, first: float = 1.0) -> tuple[Array, Array]:
    """Time and values, shape (n,): the first level for `first` [s], then each of the others for `hold` [s].

    The `ramp` [s] to a level is the beginning of its hold.
    """
    starts = first + hold * np.arange(len(values) - 1)
    corners = np.concatenate([[0.0], np.column_stack([starts, starts + ramp]).ravel(), [starts[-1] + hold]])
    values_at_corners = np.repeat(np.asarray(values, dtype=float), 2)
    time = np.arange(round(corners[-1] * RATE) + 1) / RATE
    return time, np.interp(time, corners, values_at_corners)


# ---- commands on the whole machine -----------------------------------------------------------------

# slow and fast strokes to and fro: (command [V], hold [s]) of each
_STROKES: Mapping[str, Sequence[tuple[float, float]]] = {
    "swing": ((2.0, 1.5), (-3.0, 1.2), (3.5, 1.0), (-2.5, 1.0), (1.5, 1.5), (-3.2, 0.8)),
    "boom": ((2.2, 1.4), (-1.6, 1.8), (3.0, 1.0), (-2.4, 1.2), (1.5, 1.6), (-1.4, 1.4), (3.2, 0.7)),
    "stick": ((2.0, 1.6), (-2.0, 1.6), (3.0, 1.1), (-2.6, 1.2), (1.5, 1.8), (-1.5, 1.8), (3.2, 0.8)),
}
_RISE = {"swing": 0.5, "boom": 0.3, "stick": 0.4}  # s, of the command at the start of a stroke
_FALL = {"swing": 1.3, "boom": 0.5, "stick": 0.6}  # s, at its end
_PAUSE = 0.3  # s between strokes


def _one_by_one(
    joint: str, rows: Sequence[tuple[float, float]], rise: float, fall: float, pause: float
) -> list[Move]:
    """Strokes of one joint from 1 s on: (command [V], hold [s]) of each."""
    moves, start = [], 1.0
    for command, hold in rows:
        moves.append(Move(joint, start, command, rise, hold, fall))
        start = round(end_of(moves[-1:]) + pause, 3)
    return moves


def end_of(moves: Sequence[Move]) -> float:
    """The time at which the last move ends [s]."""
    return round(max(m.start + m.rise + m.hold + m.fall for m in moves), 3)


# initial poses of the damping experiments and the sign of their first stroke. All strokes stay inside the
# range of the joint. The lever arm dl/dq differs in the two experiments of a joint, so that friction of
# piston and joint can be separated.
DAMPING: Mapping[str, Sequence[tuple[Pose, int]]] = {
    "swing": ((Pose(0.2, -1.4), 1), (Pose(0.4, -1.9), -1)),
    "boom": ((Pose(0.0, -1.4), 1), (Pose(0.5, -1.8), 1)),
    "stick": ((Pose(0.4, -1.1), 1), (Pose(0.3, -2.0), -1)),
}


def _moves(table: str) -> tuple[Move, ...]:
    """Moves from a table: joint, start [s], command [V], rise, hold, fall [s] of each."""
    rows = (row.split() for row in table.split(";"))
    return tuple(Move(joint, *map(float, numbers)) for joint, *numbers in rows)


# first low and close to the machine, then high and far away
TRAIN_1 = _moves("""
    boom  1.0 2.8 0.4 0.9 0.6;    swing 1.6 2.6 0.5 1.3 1.4;    stick 2.6 -2.8 0.4 1.2 0.6;
    boom  4.0 4.2 0.5 0.7 0.9;    swing 5.2 -1.6 0.4 1.0 0.8;   stick 5.6 -1.5 0.4 1.4 0.5;
    boom  7.4 -2.2 0.4 1.4 0.6;   swing 8.2 -3.6 0.6 1.5 1.6;   stick 9.0 3.2 0.4 1.0 0.6;
    boom  10.8 1.4 0.3 1.0 0.4;   stick 12.0 1.6 0.3 0.9 0.4;   swing 12.4 1.4 0.4 1.2 0.8;
    boom  13.6 3.2 0.4 0.8 0.7;   swing 15.2 3.8 0.7 1.2 1.8;   stick 15.6 -3.4 0.5 1.0 0.8;
    boom  17.6 -1.5 0.4 1.6 0.5;  stick 18.6 2.4 0.4 1.3 0.6;   swing 19.6 -2.2 0.5 0.9 1.0;
    boom  21.0 -2.8 0.5 0.9 0.8;  stick 22.0 4.2 0.6 0.7 1.0;   swing 23.0 -2.8 0.5 1.0 1.4;
    boom  24.2 1.8 0.3 0.8 0.5;   stick 25.2 -1.8 0.4 1.0 0.5;  swing 26.4 1.8 0.4 0.6 0.9;
    boom  27.0 -1.6 0.4 0.8 0.5
""")
# first far away and high, then close and low
TRAIN_2 = _moves("""
    stick 1.0 2.6 0.4 1.3 0.6;    swing 1.4 -3.0 0.6 1.4 1.5;   boom  2.2 -2.6 0.4 1.2 0.7;
    stick 4.4 1.5 0.3 1.2 0.4;    boom  5.0 1.6 0.3 1.1 0.5;    swing 5.6 2.0 0.4 1.0 1.0;
    stick 7.2 3.6 0.5 0.9 0.8;    boom  8.0 -1.4 0.4 1.2 0.5;   swing 8.6 3.4 0.6 1.3 1.6;
    boom  10.6 4.0 0.5 0.7 0.9;   stick 11.4 -2.2 0.4 1.2 0.6;  swing 12.8 1.5 0.4 0.9 0.8;
    boom  13.4 -2.4 0.4 1.1 0.6;  stick 14.6 -1.6 0.4 1.4 0.5;  swing 15.4 -3.8 0.7 1.4 1.8;
    boom  16.2 2.2 0.4 1.0 0.5;   stick 17.8 2.9 0.4 0.9 0.6;   boom  19.2 -1.8 0.4 1.3 0.5;
    swing 20.2 -1.5 0.4 1.2 0.8;  stick 20.8 -3.2 0.5 0.9 0.8;  boom  22.6 3.0 0.4 0.9 0.7;
    swing 23.2 2.8 0.6 1.0 1.4;   stick 24.2 1.8 0.3 1.0 0.5;   boom  25.6 -2.0 0.4 1.1 0.6;
    stick 26.2 -2.4 0.4 0.8 0.6
""")
# moves and initial pose
TRAINING = ((TRAIN_1, Pose(-0.1, -1.5, -0.4)), (TRAIN_2, Pose(0.7, -0.95, 0.5)))
TRAINING_STOP = 30.0  # s

# strokes of the boom up and down about the same angles, slower than 2 cm/s
_WEIGHING = ((1.2, 2.0), (-1.0, 2.0)) * 3
WEIGHING_POSE = Pose(0.1, -1.2)
WEIGHED = 300.0  # kg, payload of the loaded experiment

# ---- experiments on the benches --------------------------------------------------------------------

REST = 10.0  # s
HOLD = 2.0  # s: 0.5 s to settle and 300 samples
RAMP = 0.05  # s, between levels

# V; fine below 2 V, where the edges open. Up to about 1 V the flow is in the dead zone of the meter.
VALVE_STEPS = (*np.arange(0.25, 2.01, 0.25), *np.arange(2.5, 10.01, 0.5))
# V; 25 flows, nearly equidistant from 15 to 281 L/min
HOSE_STEPS = tuple(np.round(np.linspace(1.25, 10.0, 25), 3))
HOSE_THROTTLE = 1.05e11  # C_R [Pa.s2/m6]: 281 L/min at 10 V

# four groups: resistance C_R of the throttle [Pa.s2/m6], levels of the command [V], hold and ramp [s]. A
# small resistance gives fast changes of flow, for the inertance; a large one of pressure, for the
# capacitance. Each step up is followed by a step down, so that sampling errors at the corners cancel. Flows
# exceed the dead zone of the meters.
GROUPS: tuple[tuple[float, Sequence[float], float, float], ...] = (
    (6e11, (3.0, 8.0) * 20, 0.5, 0.06),
    (1.5e12, (3.0, 6.0, 9.0, 6.0) * 10, 0.5, 0.06),
    (3e12, (2.5, 4.0, 10.0, 4.0) * 10, 0.5, 0.08),
    (6e12, (2.0, 6.0) * 20, 0.5, 0.08),
)

# MPa; locked motor: set pressures of the stepped port, at a low and a medium pressure of the other port
MOTOR_STEPS = tuple(range(2, 21, 2))
MOTOR_OTHER = (2.0, 8.0)
MOTOR_HOLD, MOTOR_RAMP = 3.0, 0.2  # s


Named: TypeAlias = tuple[str, str]  # procedure, title
Signals: TypeAlias = Mapping[str, Array]


def _bench(
    named: Named, time: Array, signals: Signals, flow: SignalDescription = FLOW, **conditions: str | Condition
) -> Experiment:
    """An experiment on a bench, with the instruments that the names of its signals tell; flow: the meter."""
    by_quantity = {"command": COMMAND, "pressure": PRESSURE}
    instruments = {name: by_quantity.get(name.split("_")[0], flow) for name in signals}
    return Experiment(*named, time, signals, instruments, conditions)


def _rest(_: str) -> Experiment:
    """Ten seconds with the pump off: every pressure and flow is zero."""
    bench = {f"pressure_{place}": PRESSURE for place in ("in", "out", "a", "b")}
    bench |= dict.fromkeys(("flow", "flow_in", "flow_out"), FLOW)
    bench |= dict.fromkeys(("flow_a", "drain_flow"), LEAKAGE)
    sensors = bench | {n: i for n, i in INSTRUMENTS.items() if i not in (COMMAND, ANGLE)}
    time = np.arange(round(REST * RATE) + 1) / RATE
    signals = {n: np.zeros_like(time) for n in sensors}
    return replace(_bench(("rest", "Pump off, at rest"), time, signals), instruments=sensors)


def _edge(edge: str, machine: str) -> Experiment:
    up = (0.0, *VALVE_STEPS)
    time, steps = levels((*up, *up[-2::-1]), HOLD, RAMP)
    command = EDGES[edge] * steps
    signals = {"command": command, **valve(machine, edge, time, command)}
    return _bench(("valve", f"Valve edge {edge}, stepped command"), time, signals, edge=edge)


def _hose(named: Named, time: Array, signals: Signals) -> Experiment:
    p = detailed()
    length, bore = (Condition(value, "m") for value in (p.stick.hose.length, p.stick.hose.bore))
    density = Condition(p.density, "kg/m3")
    return _bench(named, time, signals, length=length, diameter=bore, density=density)


def _hose_resistance(machine: str) -> Experiment:
    time, command = levels((0.0, *HOSE_STEPS), HOLD, RAMP)
    outputs = stick_hose(machine, HOSE_THROTTLE, time, command)
    signals = {n: outputs[n] for n in ("pressure_in", "pressure_out")} | {"flow": outputs["flow_out"]}
    return _hose(("hose_resistance", "Hose of 4 m and 3/4 in, stepped flow"), time, signals)


def _hose_dynamics(number: int, machine: str) -> Experiment:
    resistance, steps, hold, ramp = GROUPS[number - 1]
    time, command = levels((0.0, *steps), hold, ramp)
    signals = {"command": command, **stick_hose(machine, resistance, time, command)}
    return _hose(("hose_dynamics", f"Hose of 4 m and 3/4 in, fast changes, group {number}"), time, signals)


def _motor(stepped: str, machine: str) -> Experiment:
    low, medium = MOTOR_OTHER
    steps = [2.0, *MOTOR_STEPS, *reversed(MOTOR_STEPS)]
    others = [low, *(low for _ in MOTOR_STEPS), *(medium for _ in MOTOR_STEPS)]
    time, stepped_pressure = levels(steps, MOTOR_HOLD, MOTOR_RAMP)
    _, other_pressure = levels(others, MOTOR_HOLD, MOTOR_RAMP)
    pressures = (1e6 * stepped_pressure, 1e6 * other_pressure)
    signals = locked_motor(machine, time, *(pressures if stepped == "A" else reversed(pressures)))
    title = f"Swing motor, shaft locked, pressure at port {stepped} stepped"
    return _bench(("motor_leakage", title), time, signals, LEAKAGE, shaft="locked")


BENCH_EXPERIMENTS: dict[str, Callable[[str], Experiment]] = {
    "rest": _rest,
    **{f"valve_{edge.replace('-', '').lower()}": partial(_edge, edge) for edge in EDGES},
    "hose_resistance": _hose_resistance,
    **{f"hose_dynamics_{n}": partial(_hose_dynamics, n) for n in range(1, len(GROUPS) + 1)},
    **{f"motor_leakage_{n}": partial(_motor, port) for n, port in enumerate("AB", 1)},
}

# ---- experiments on the whole machine --------------------------------------------------------------


@cache
def _monolith(machine: str) -> tuple[Monolith, Connections, Mapping[str, tuple[str, ...]]]:
    """The machine as one model, its connections, and its inputs with the variables that they set."""
    components = FERIC.chosen(**VARIANTS[machine])
    wires, inputs = wiring(components)
    return join(components, wires, inputs), wires, inputs


def simulate_machine(
    machine: str, moves: Sequence[Move], stop: float, pose: Pose, held: float = 0.0
) -> tuple[Array, dict[str, Array]]:
    """Time (n,) [s] at 200 Hz, and all outputs and inputs (n,) by `component.variable`, in SI units.

    held   payload [kg] that the head holds from the start
    """
    model, wires, targets = _monolith(machine)
    time, commands = sample(moves, stop)
    inputs = np.tile(model.u, (time.size, 1))
    inputs[:, [model.inputs.index(name) for name in COMMANDS]] = commands
    inputs[:, model.inputs.index("payload_mass")] = held
    p = model.p.copy()
    for joint in (*JOINTS, "swing"):
        p[model.parameters.index(f"manipulator.{parameter(joint)}")] = getattr(pose, joint)
    _, outputs = simulate(model, time, inputs, p, TOLERANCE)
    signals = dict(zip(model.output_names, outputs.T, strict=True))
    for column, name in zip(inputs.T, model.inputs, strict=True):
        signals |= dict.fromkeys(targets[name], column)
    return time, signals | {target: signals[source] for source, target in wires}


_RECORDED = (
    (COMMAND, "swing.swing_command boom_stick.boom_command boom_stick.stick_command swing.tank_pressure"),
    (PRESSURE, "swing.supply_pressure swing.swing_pressure_a swing.swing_pressure_b"),
    (PRESSURE, "boom_stick.boom_head_pressure boom_stick.boom_rod_pressure"),
    (PRESSURE, "boom_stick.stick_head_pressure boom_stick.stick_rod_pressure"),
    (ANGLE, "manipulator.swing_angle manipulator.boom_angle manipulator.stick_angle"),
    (FLOW, "swing.swing_flow_a boom_stick.boom_head_flow boom_stick.stick_head_flow"),
)
INSTRUMENTS: Mapping[str, SignalDescription] = {n: i for i, names in _RECORDED for n in names.split()} | {
    "swing.tank_pressure": RETURN
}


def _driven(
    named: Named,
    moves: Sequence[Move],
    stop: float,
    pose: Pose,
    machine: str,
    held: float = 0.0,
    use: str = "train",
    **conditions: str | Condition,
) -> Experiment:
    """An experiment on the whole machine; arguments as in `simulate_machine`."""
    time, signals = simulate_machine(machine, moves, stop, pose, held)
    recorded = {n: signals.pop(n) for n in INSTRUMENTS}
    return Experiment(*named, time, recorded, INSTRUMENTS, conditions, signals, use)


def _damping(joint: str, number: int, machine: str) -> Experiment:
    pose, sign = DAMPING[joint][number - 1]
    rows = [(sign * command, hold) for command, hold in _STROKES[joint]]
    moves = _one_by_one(joint, rows, _RISE[joint], _FALL[joint], _PAUSE)
    named = ("damping", f"Only the {joint} moves, pose {number}")
    return _driven(named, moves, end_of(moves) + 1.0, pose, machine, joint=joint)


def _weighing(held: float, machine: str) -> Experiment:
    moves = _one_by_one("boom", _WEIGHING, 0.5, 0.5, 0.5)
    named = ("weighing", f"Slow strokes of the boom, {f'payload of {held:g} kg' if held else 'empty head'}")
    payload = Condition(held, "kg")
    return _driven(named, moves, end_of(moves) + 1.0, WEIGHING_POSE, machine, held, payload=payload)


def _training(number: int, machine: str) -> Experiment:
    moves, pose = TRAINING[number - 1]
    return _driven(("machine", f"All axes at work, training {number}"), moves, TRAINING_STOP, pose, machine)


def _test(machine: str) -> Experiment:
    named, pose = ("machine", "Work cycle, held out"), POSES[NOMINAL]
    return _driven(named, WORK_CYCLE, WORK_CYCLE_STOP, pose, machine, use="test")


MACHINE_EXPERIMENTS: dict[str, Callable[[str], Experiment]] = {
    **{
        f"damping_{joint}_{n}": partial(_damping, joint, n)
        for joint, runs in DAMPING.items()
        for n in range(1, len(runs) + 1)
    },
    **{f"machine_train_{n}": partial(_training, n) for n in range(1, len(TRAINING) + 1)},
    "machine_test": _test,
    "weighing_empty": partial(_weighing, 0.0),
    "weighing_loaded": partial(_weighing, WEIGHED),
}

MACHINES: Mapping[str, str] = {
    "lumped": "lumped drives, rigid head, ideal supply: the set of the paper",
    "detailed": "detailed drives, friction with stiction, swinging head, supply of engine and pumps",
}
# name of the files -> the experiment on a machine
EXPERIMENTS = BENCH_EXPERIMENTS | MACHINE_EXPERIMENTS


@cache
def experiment(name: str, machine: str) -> Experiment:
    """One experiment by the name of its files; simulated once and then kept in memory."""
    if machine not in MACHINES:
        raise Problem(f"machine is {machine!r}, expected {' or '.join(MACHINES)}")
    return replace(EXPERIMENTS[name](machine), name=name, machine=machine)


def experiments(machine: str) -> Iterator[Experiment]:
    """All experiments on a machine; each is simulated when the iterator reaches it."""
    return (experiment(name, machine) for name in EXPERIMENTS)
