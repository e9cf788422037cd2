"""The experiments of the rig with their commands and instruments, after section 4 of the paper.

On the benches, commands and pressures are stepped: they are held at levels, with ramps between them. On the
whole machine an operator moves one joint in the damping experiments and all joints in the training
experiments; the test is the work cycle. Training covers the work space, small and large commands and all
pairs of axes, and contains no part of the work cycle. All corners of commands are on the 200 Hz grid.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache, partial
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from fmus.machine.parts import Connections, parts, wiring
from fmus.machine.poses import JOINTS, NOMINAL, POSES, Pose, parameter
from fmus.machine.work_cycle import COMMANDS, RATE, WORK_CYCLE, WORK_CYCLE_STOP, Move, sample
from fmus.monolith import Monolith, join, simulate
from fmus.rig.benches import EDGES, TOLERANCE, detailed, locked_motor, stick_hose, valve
from fmus.rig.instruments import ANGLE, COMMAND, FLOW, LEAKAGE, PRESSURE, RETURN, Experiment, Instrument
from orchestrator.base.errors import Problem
from orchestrator.data.description import Condition

Array = NDArray[np.float64]


def levels(values: Sequence[float], hold: float, ramp: float, first: float = 1.0) -> tuple[Array, Array]:
    """Time and values, shape (n,): the first level for `first` [s], then each of the others for `hold` [s].

    The `ramp` [s] to a level is the beginning of its hold.
    """
    starts = first + hold * np.arange(len(values) - 1)
    corners = np.concatenate([[0.0], np.column_stack([starts, starts + ramp]).ravel(), [starts[-1] + hold]])
    values_at_corners = np.repeat(np.asarray(values, dtype=float), 2)
    time = np.arange(round(corners[-1] * RATE) + 1) / RATE
    return time, np.interp(time, corners, values_at_corners)


def up_and_down(steps: Sequence[float]) -> list[float]:
    """Levels from zero up all steps and down again to zero."""
    up = [0.0, *steps]
    return up + up[-2::-1]


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


def strokes(joint: str, sign: int = 1) -> list[Move]:
    """Strokes of one joint to and fro, from 1 s on; sign -1 reverses the directions."""
    moves, start = [], 1.0
    for command, hold in _STROKES[joint]:
        moves.append(Move(joint, start, sign * command, _RISE[joint], hold, _FALL[joint]))
        start = round(end_of(moves[-1:]) + _PAUSE, 3)
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

TRAIN_1: tuple[Move, ...] = (  # first low and close to the machine, then high and far away
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
TRAIN_2: tuple[Move, ...] = (  # first far away and high, then close and low
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
# moves and initial pose
TRAINING = ((TRAIN_1, Pose(-0.1, -1.5, -0.4)), (TRAIN_2, Pose(0.7, -0.95, 0.5)))
TRAINING_STOP = 30.0  # s

# slow strokes of the boom to and fro about the same angles: (command [V], hold [s]) up, then down
_WEIGHING = ((1.2, 2.0), (-1.0, 2.0))
WEIGHING_POSE = Pose(0.1, -1.2)
WEIGHED = 300.0  # kg, payload of the loaded experiment


def weighing_strokes(pairs: int = 3) -> list[Move]:
    """Strokes of the boom up and down, slower than 2 cm/s, from 1 s on."""
    moves, start = [], 1.0
    for command, hold in _WEIGHING * pairs:
        moves.append(Move("boom", start, command, 0.5, hold, 0.5))
        start = round(end_of(moves[-1:]) + 0.5, 3)
    return moves


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


def _instruments(signals: Mapping[str, Array], flow: Instrument = FLOW) -> dict[str, Instrument]:
    """The instruments of the signals, from their names; flow: the meter for flows."""
    by_quantity = {"command": COMMAND, "pressure": PRESSURE}
    return {name: by_quantity.get(name.split("_")[0], flow) for name in signals}


def _rest(machine: str) -> Experiment:
    """Ten seconds with the pump off: every pressure and flow is zero."""
    bench = {
        "pressure_in": PRESSURE,
        "pressure_out": PRESSURE,
        "pressure_a": PRESSURE,
        "pressure_b": PRESSURE,
    }
    bench |= dict.fromkeys(("flow", "flow_in", "flow_out"), FLOW) | dict.fromkeys(
        ("flow_a", "drain_flow"), LEAKAGE
    )
    sensors = bench | {n: i for n, i in INSTRUMENTS.items() if i not in (COMMAND, ANGLE)}
    time = np.arange(round(REST * RATE) + 1) / RATE
    signals = {n: np.zeros_like(time) for n in sensors}
    return Experiment("rest", "Pump off, at rest", "rest", "train", machine, {}, time, signals, sensors)


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
        instruments=_instruments(signals),
    )


def _hose(
    machine: str, name: str, title: str, procedure: str, signals: dict[str, Array], time: Array
) -> Experiment:
    p = detailed()
    conditions = {
        "length": Condition(p.stick_hose_length, "m"),
        "diameter": Condition(p.stick_hose_bore, "m"),
        "density": Condition(p.density, "kg/m3"),
    }
    return Experiment(
        name, title, procedure, "train", machine, conditions, time, signals, _instruments(signals)
    )


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


def _motor(stepped: str, machine: str) -> Experiment:
    low, medium = MOTOR_OTHER
    steps = [2.0, *MOTOR_STEPS, *reversed(MOTOR_STEPS)]
    others = [low, *(low for _ in MOTOR_STEPS), *(medium for _ in MOTOR_STEPS)]
    time, stepped_pressure = levels(steps, MOTOR_HOLD, MOTOR_RAMP)
    _, other_pressure = levels(others, MOTOR_HOLD, MOTOR_RAMP)
    pressures = (1e6 * stepped_pressure, 1e6 * other_pressure)
    signals = locked_motor(machine, time, *(pressures if stepped == "A" else reversed(pressures)))
    return Experiment(
        name=f"motor_leakage_{1 if stepped == 'A' else 2}",
        title=f"Swing motor, shaft locked, pressure at port {stepped} stepped",
        procedure="motor_leakage",
        use="train",
        machine=machine,
        conditions={"shaft": "locked"},
        time=time,
        signals=signals,
        instruments=_instruments(signals, LEAKAGE),
    )


BENCH_EXPERIMENTS: Mapping[str, Callable[[str], Experiment]] = {
    "rest": _rest,
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
def _monolith(machine: str) -> tuple[Monolith, Connections, Mapping[str, tuple[str, ...]]]:
    """The machine as one model, its connections, and its inputs with the variables that they set."""
    components = parts(**_VARIANTS[machine])
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


INSTRUMENTS: Mapping[str, Instrument] = {
    **dict.fromkeys(("swing.swing_command", "boom_stick.boom_command", "boom_stick.stick_command"), COMMAND),
    "swing.tank_pressure": RETURN,
    **dict.fromkeys(("swing.supply_pressure", "swing.swing_pressure_a", "swing.swing_pressure_b"), PRESSURE),
    **{
        f"boom_stick.{joint}_{side}_pressure": PRESSURE
        for joint in ("boom", "stick")
        for side in ("head", "rod")
    },
    **{f"manipulator.{joint}_angle": ANGLE for joint in ("swing", "boom", "stick")},
    **dict.fromkeys(("swing.swing_flow_a", "boom_stick.boom_head_flow", "boom_stick.stick_head_flow"), FLOW),
}


def _machine_experiment(
    name: str,
    title: str,
    moves: Sequence[Move],
    stop: float,
    pose: Pose,
    conditions: Mapping[str, str | Condition],
    use: str,
    machine: str,
    procedure: str = "machine",
    held: float = 0.0,
) -> Experiment:
    time, signals = simulate_machine(machine, moves, stop, pose, held)
    return Experiment(
        name=name,
        title=title,
        procedure=procedure,
        use=use,
        machine=machine,
        conditions=conditions,
        time=time,
        signals={n: signals[n] for n in INSTRUMENTS},
        instruments=INSTRUMENTS,
        unrecorded={n: values for n, values in signals.items() if n not in INSTRUMENTS},
    )


def _damping(joint: str, number: int, machine: str) -> Experiment:
    pose, sign = DAMPING[joint][number - 1]
    moves = strokes(joint, sign)
    title = f"Only the {joint} moves, pose {number}"
    name, stop = f"damping_{joint}_{number}", end_of(moves) + 1.0
    return _machine_experiment(name, title, moves, stop, pose, {"joint": joint}, "train", machine, "damping")


def _weighing(name: str, held: float, machine: str) -> Experiment:
    moves = weighing_strokes()
    title = f"Slow strokes of the boom, {f'payload of {held:g} kg' if held else 'empty head'}"
    stated = {"payload": Condition(held, "kg")}
    where = (end_of(moves) + 1.0, WEIGHING_POSE, stated, "train", machine)
    return _machine_experiment(f"weighing_{name}", title, moves, *where, "weighing", held)


def _training(number: int, machine: str) -> Experiment:
    moves, pose = TRAINING[number - 1]
    title = f"All axes at work, training {number}"
    return _machine_experiment(
        f"machine_train_{number}", title, moves, TRAINING_STOP, pose, {}, "train", machine
    )


def _test(machine: str) -> Experiment:
    title = "Work cycle, held out"
    return _machine_experiment(
        "machine_test", title, WORK_CYCLE, WORK_CYCLE_STOP, POSES[NOMINAL], {}, "test", machine
    )


MACHINE_EXPERIMENTS: Mapping[str, Callable[[str], Experiment]] = {
    **{
        f"damping_{joint}_{n}": partial(_damping, joint, n)
        for joint, runs in DAMPING.items()
        for n in range(1, len(runs) + 1)
    },
    **{f"machine_train_{n}": partial(_training, n) for n in range(1, len(TRAINING) + 1)},
    "machine_test": _test,
    "weighing_empty": partial(_weighing, "empty", 0.0),
    "weighing_loaded": partial(_weighing, "loaded", WEIGHED),
}

Machine: TypeAlias = Literal["lumped", "detailed"]
MACHINES: Mapping[str, str] = {
    "lumped": "lumped drives, rigid head, ideal supply: the set of the paper",
    "detailed": "detailed drives, friction with stiction, swinging head, supply of engine and pumps",
}
EXPERIMENTS: Mapping[str, Callable[[str], Experiment]] = {**BENCH_EXPERIMENTS, **MACHINE_EXPERIMENTS}


@cache
def experiment(name: str, machine: str) -> Experiment:
    """One experiment by the name of its files; simulated once and then kept in memory."""
    if machine not in MACHINES:
        raise Problem(f"machine is {machine!r}, expected {' or '.join(MACHINES)}")
    return EXPERIMENTS[name](machine)


def experiments(machine: str) -> Iterator[Experiment]:
    """All experiments on a machine; each is simulated when the iterator reaches it."""
    return (experiment(name, machine) for name in EXPERIMENTS)
