"""The experiments of the rig with their commands and instruments, after section 4 of the paper.

On the benches, commands and pressures are stepped: they are held at levels, with ramps between them. On the
whole machine an operator moves one joint in the damping experiments and all joints in the training
experiments; the test is the work cycle. Training covers the work space, small and large commands and all
pairs of axes, and contains no part of the work cycle. All corners of commands are on the 200 Hz grid.

Instruments read the true signals with noise and quantisation:

    reading = clip(resolution round((true + noise) / resolution)),      0 if |true| is in the dead zone

The noise is white and Gaussian and is added before the converter. In its dead zone a turbine meter stands
still: this depends on the true flow, and its reading has no noise. A 12-bit converter has 4096 codes, one of
them for zero, so the highest value is one code below the end of the range. There is no filter; the sampling
rate is 200 Hz.
"""

import math
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, partial
from hashlib import sha256
from importlib.resources import files
from typing import Any, TypeAlias

import numpy as np

from fmus.machine.machine import Connections, wiring
from fmus.machine.parts import FERIC
from fmus.machine.parts import MACHINES as VARIANTS
from fmus.machine.poses import JOINTS, NOMINAL, POSES, Pose, parameter
from fmus.monolith import Monolith, join, simulate
from fmus.operator_input.work_cycle import COMMANDS, RATE, WORK_CYCLE, WORK_CYCLE_STOP, Move, sample
from fmus.rig.benches import BORE, EDGES, TOLERANCE, drives, hold_test, locked_motor, stick_hose, valve
from orchestrator.base.errors import Problem
from orchestrator.base.units import parse_unit
from orchestrator.data.description import Condition, SignalDescription
from orchestrator.data.table import Array

# ---- instruments and what they record --------------------------------------------------------------


def _converter(
    text: str, unit: str, span: tuple[float, float], noise: float, dead_zone: float = 0.0
) -> SignalDescription:
    """An instrument with a 12-bit converter; its dead zone is where the reading is 0."""
    low, end = span
    step = (end - low) / 2**12
    return SignalDescription(
        unit, sensor=text, noise=noise, resolution=step, span=(low, end - step), dead_zone=dead_zone
    )


PRESSURE = _converter("pressure transducer 0-400 bar, 12 bit", "bar", (0.0, 400.0), 0.1)
# noise as a share of the range as above
RETURN = _converter("pressure transducer -1 to 25 bar, 12 bit", "bar", (-1.0, 25.0), 0.0065)
FLOW = _converter("turbine flow meter +-300 L/min, 12 bit", "L/min", (-300.0, 300.0), 0.3, 10.0)
LEAKAGE = _converter("gear flow meter +-5 L/min, 12 bit", "L/min", (-5.0, 5.0), 0.005)
ANGLE = SignalDescription("deg", sensor="encoder, 65536 counts per turn", resolution=360 / 2**16)
LISTED = PRESSURE, FLOW, LEAKAGE, ANGLE  # in README.md
POSITION = SignalDescription(
    "m", sensor="string potentiometer 0-1 m, 16 bit", noise=2e-6, resolution=2**-16, span=(0.0, 1.0)
)
COMMAND = SignalDescription("V")  # known exactly, because the computer sends it


def generator(seed: int, file: str, signal: str) -> np.random.Generator:
    """Random numbers for one signal of one file; they do not depend on other files and signals."""
    name = sha256(f"{file}/{signal}".encode()).digest()
    return np.random.default_rng([seed, int.from_bytes(name[:8], "little")])


def read(instrument: SignalDescription, true: Array, random: np.random.Generator) -> Array:
    """Readings, shape (n,), in the instrument's unit, of a true signal in SI.

    Of the instrument: `noise`, standard deviation of one sample; `resolution`, step of the converter, 0
    without one; `span`, its lowest and highest reading; `dead_zone`, true magnitude below which it reads 0.
    """
    value = true / parse_unit(instrument.unit).factor
    in_dead_zone = np.abs(value) < instrument.dead_zone
    if instrument.noise:
        value = value + random.normal(0.0, instrument.noise, value.size)
    if instrument.resolution:
        value = instrument.resolution * np.round(value / instrument.resolution)
    value = np.clip(value, *(instrument.span or (-math.inf, math.inf)))  # multiples of the resolution
    return np.where(in_dead_zone, 0.0, value)


@dataclass(frozen=True)
class Experiment:
    """One experiment on one machine, with its true signals.

    time         shape (n,) [s], 200 Hz
    signals      true signals that are recorded, in SI units, each of shape (n,)
    instruments  instrument of each signal
    conditions   constant quantities of the experiment and its text conditions
    unrecorded   true signals that are not recorded, in SI units; for tests
    use          "train" for identification, "test" for validation
    name         of its files, without suffix
    machine      "lumped" or "detailed"
    """

    procedure: str
    title: str
    time: Array
    signals: Mapping[str, Array]
    instruments: Mapping[str, SignalDescription]
    conditions: Mapping[str, str | Condition] = field(default_factory=dict)
    unrecorded: Mapping[str, Array] = field(default_factory=dict)
    use: str = "train"
    name: str = ""
    machine: str = ""


def record(experiment: Experiment, seed: int) -> dict[str, Array]:
    """Readings of each signal, shape (n,), in the unit of its instrument."""
    return {
        name: read(experiment.instruments[name], true, generator(seed, experiment.name, name))
        for name, true in experiment.signals.items()
    }


# ---- commands ---------------------------------------------------------------------------------------


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

_TABLES: Mapping[str, Any] = tomllib.loads((files("fmus.rig") / "experiments.toml").read_text("utf-8"))


def _one_by_one(
    joint: str, rows: Sequence[tuple[float, float]], rise: float, fall: float, pause: float = 0.3
) -> list[Move]:
    """Strokes of one joint from 1 s on: (command [V], hold [s]) of each, with pauses [s] between them."""
    moves, start = [], 1.0
    for command, hold in rows:
        moves.append(Move(joint, start, command, rise, hold, fall))
        start = round(_end_of(moves[-1:]) + pause, 3)
    return moves


def _end_of(moves: Sequence[Move]) -> float:
    """The time at which the last move ends [s]."""
    return round(max(m.start + m.rise + m.hold + m.fall for m in moves), 3)


# moves and initial pose
TRAINING: Sequence[tuple[Sequence[Move], Pose]] = tuple(
    ([Move(*row) for row in one["moves"]], Pose(*one["pose"])) for one in _TABLES["training"]
)
TRAINING_STOP = 30.0  # s
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
    by_quantity = {"command": COMMAND, "pressure": PRESSURE, "position": POSITION}
    instruments = {name: by_quantity.get(name.split("_")[0], flow) for name in signals}
    return Experiment(*named, time, signals, instruments, conditions)


def _rest(_: str) -> Experiment:
    """Ten seconds with the pump off: every pressure and flow is zero."""
    sensors = {f"pressure_{place}": PRESSURE for place in ("in", "out", "a", "b")}
    sensors |= dict.fromkeys(("flow", "flow_in", "flow_out"), FLOW)
    sensors |= dict.fromkeys(("flow_a", "drain_flow"), LEAKAGE)
    sensors |= {n: i for n, i in INSTRUMENTS.items() if i not in (COMMAND, ANGLE)}
    time = np.arange(round(REST * RATE) + 1) / RATE
    return Experiment("rest", "Pump off, at rest", time, {n: np.zeros_like(time) for n in sensors}, sensors)


def _edge(edge: str, machine: str) -> Experiment:
    up = (0.0, *VALVE_STEPS)
    time, steps = levels((*up, *up[-2::-1]), HOLD, RAMP)
    command = EDGES[edge] * steps
    signals = {"command": command, **valve(machine, edge, time, command)}
    return _bench(("valve", f"Valve edge {edge}, stepped command"), time, signals, edge=edge)


def _hose(
    named: Named, resistance: float, steps: Sequence[float], hold: float, ramp: float, machine: str
) -> Experiment:
    """The hose of the stick, its throttle [Pa.s2/m6] at the end, with commands as in `levels` [V]."""
    procedure, change = named
    p = drives("detailed")
    length, bore = (Condition(value, "m") for value in (p.stick.hose.length, p.stick.hose.bore))
    time, command = levels((0.0, *steps), hold, ramp)
    signals = stick_hose(machine, resistance, time, command)
    if procedure == "hose_dynamics":
        signals = {"command": command, **signals}
    else:  # one meter, at the end
        signals = {n: signals[n] for n in ("pressure_in", "pressure_out")} | {"flow": signals["flow_out"]}
    titled, density = (procedure, f"Hose of 4 m and 3/4 in, {change}"), Condition(p.density, "kg/m3")
    return _bench(titled, time, signals, length=length, diameter=bore, density=density)


def _motor(stepped: str, machine: str) -> Experiment:
    low, medium = MOTOR_OTHER
    steps = [2.0, *MOTOR_STEPS, *reversed(MOTOR_STEPS)]
    others = [low, *(low for _ in MOTOR_STEPS), *(medium for _ in MOTOR_STEPS)]
    time, stepped_pressure = levels(steps, MOTOR_HOLD, MOTOR_RAMP)
    pressures = (1e6 * stepped_pressure, 1e6 * levels(others, MOTOR_HOLD, MOTOR_RAMP)[1])
    signals = locked_motor(machine, time, *(pressures if stepped == "A" else reversed(pressures)))
    title = f"Swing motor, shaft locked, pressure at port {stepped} stepped"
    return _bench(("motor_leakage", title), time, signals, LEAKAGE, shaft="locked")


# bar that the weights of the hold test need; leakage of the worn seals, 0.6 L/min at 100 bar
WEIGHTS, SEALS = (40.0, 80.0, 120.0, 160.0, 100.0, 60.0), 1e-12


def hold(seals: float = SEALS, square: float = 0.0) -> Experiment:
    """A cylinder holds weights, each for 5 s; leakage past its seals as in `hold_test`."""
    time, pressure = levels([1e5 * weight for weight in WEIGHTS], 5.0, 0.2)
    signals = hold_test(time, pressure, seals, square)
    named, bore = ("seal_leakage", "Cylinder with worn seals, hold test"), Condition(BORE, "m")
    return replace(_bench(named, time, signals, bore=bore), machine="lumped")


BENCH_EXPERIMENTS: dict[str, Callable[[str], Experiment]] = {
    "rest": _rest,
    **{f"valve_{edge.replace('-', '').lower()}": partial(_edge, edge) for edge in EDGES},
    "hose_resistance": partial(
        _hose, ("hose_resistance", "stepped flow"), HOSE_THROTTLE, HOSE_STEPS, HOLD, RAMP
    ),
    **{
        f"hose_dynamics_{n}": partial(
            _hose, ("hose_dynamics", f"fast changes, group {n}"), resistance, steps * times, hold, ramp
        )
        for n, (resistance, steps, times, hold, ramp) in enumerate(_TABLES["groups"], 1)
    },
    **{f"motor_leakage_{n}": partial(_motor, port) for n, port in enumerate("AB", 1)},
    "seal_leakage": lambda _: hold(),
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
    pose: Pose,
    machine: str,
    stop: float = 0.0,
    held: float = 0.0,
    use: str = "train",
    **conditions: str | Condition,
) -> Experiment:
    """An experiment on the whole machine; arguments as in `simulate_machine`; stop 0: 1 s after the moves."""
    time, signals = simulate_machine(machine, moves, stop or _end_of(moves) + 1.0, pose, held)
    recorded = {n: signals.pop(n) for n in INSTRUMENTS}
    return Experiment(*named, time, recorded, INSTRUMENTS, conditions, signals, use)


def _on_machine() -> Iterator[tuple[str, Callable[[str], Experiment]]]:
    """Experiments on the whole machine: name, and a function of the machine."""
    for joint, own in _TABLES["damping"].items():
        for n, (pose, sign) in enumerate(own["recordings"], 1):
            rows = [(sign * command, hold) for command, hold in own["strokes"]]
            strokes = _one_by_one(joint, rows, own["rise"], own["fall"])
            named = ("damping", f"Only the {joint} moves, pose {n}")
            yield f"damping_{joint}_{n}", partial(_driven, named, strokes, Pose(*pose), joint=joint)
    for n, (moves, start) in enumerate(TRAINING, 1):
        named = ("machine", f"All axes at work, training {n}")
        yield f"machine_train_{n}", partial(_driven, named, moves, start, stop=TRAINING_STOP)
    named, start = ("machine", "Work cycle, held out"), POSES[NOMINAL]
    yield "machine_test", partial(_driven, named, WORK_CYCLE, start, stop=WORK_CYCLE_STOP, use="test")
    # strokes of the boom up and down about the same angles, slower than 2 cm/s
    strokes = _one_by_one("boom", ((1.2, 2.0), (-1.0, 2.0)) * 3, 0.5, 0.5, 0.5)
    for name, text, held in (("empty", "empty head", 0.0), ("loaded", f"payload of {WEIGHED:g} kg", WEIGHED)):
        named, load = ("weighing", f"Slow strokes of the boom, {text}"), Condition(held, "kg")
        made = partial(_driven, named, strokes, Pose(0.1, -1.2), held=held, payload=load)
        yield f"weighing_{name}", made


MACHINE_EXPERIMENTS = dict(_on_machine())

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
