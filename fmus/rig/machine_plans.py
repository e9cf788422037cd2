"""The experiments on the whole machine: one joint at a time, training, and the work cycle held out."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial

from fmus.poses import NOMINAL, POSES, Pose
from fmus.rig.arm import at_work
from fmus.rig.instruments import ANGLE, COMMAND, FLOW, PRESSURE, Instrument
from fmus.rig.moves import DAMPING, TRAINING, TRAINING_STOP, stop, strokes
from fmus.rig.recording import Condition, Experiment
from fmus.scenarios import WORK_CYCLE, WORK_CYCLE_STOP, Move

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


PLANS: Mapping[str, Callable[[str], Experiment]] = {
    **{
        f"damping_{joint}_{n}": partial(_damping, joint, n)
        for joint, runs in DAMPING.items()
        for n in range(1, len(runs) + 1)
    },
    **{f"machine_train_{n}": partial(_training, n) for n in range(1, len(TRAINING) + 1)},
    "machine_test": _test,
}
