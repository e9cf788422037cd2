"""A mass on a spring with a driving force: a small model with known parameters."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from kit.toy import toy

from fmus.contract import Quantity, Subsystem
from fmus.identification.refinement.compiled_model import CompiledModel
from fmus.identification.refinement.problem import (
    EstimationProblem,
    MeasuredRun,
    RecordingMap,
    free_parameters,
)
from fmus.parameters import Values
from orchestrator.data.recording import Recording, Sensor


def _dynamics(x: Any, u: Any, p: Any) -> dict[str, Any]:
    pushed = p.gain / p.loss * u.push
    speed = pushed + p.offset - p.stiffness * x.position - p.damping * x.speed
    return {"position": x.speed, "speed": speed}


def _oscillator(name: str, dynamics: Any) -> Subsystem:
    """A mass on a spring with these dynamics, whose position is measured."""
    parameters = {
        "stiffness": Quantity("1/s2", "Stiffness over mass", 10.0, minimum=0.0),
        "damping": Quantity("1/s", "Damping over mass", minimum=0.0, maximum=3.0),
        "gain": Quantity("m/s2", "Acceleration per input", minimum=0.0),
        "loss": Quantity("1", "What the gain is divided by", minimum=0.0),
        "offset": Quantity("m/s2", "Constant acceleration", 0.1),
    }
    states = {"position": "m", "speed": Quantity("m/s", "Speed", 3.0)}
    shown = {"y": {"position": "m"}, "g": lambda x, *_: {"position": x.position}}
    return toy(name, p=parameters, x=states, u={"push": "1"}, f=dynamics, **shown)


OSCILLATOR = _oscillator("oscillator", _dynamics)
INVERTED = _oscillator("inverted", lambda x, u, p: _dynamics(replace(x, position=-x.position), u, p))
TRUTH = {"stiffness": 12.0, "damping": 0.3, "gain": 5.0, "loss": 1.0, "offset": 0.2}
NUMBERS = Values(p=TRUTH, u={"push": 0.0}, x={"position": 0.0, "speed": 0.0})
NOISE = 0.02  # m, about 2 % of the motion
FREE = ("stiffness", "damping", "gain")


def recording(seed: int = 0, seconds: float = 12.0, noise=NOISE, dead_zone: float = 0.0) -> Recording:
    """A recording of the true model at 50 Hz, from rest at the origin, driven by steps."""
    rng = np.random.default_rng(seed)
    time = np.arange(round(50 * seconds) + 1) / 50
    push = np.repeat(np.random.default_rng(99).choice([-1.0, 0.0, 1.0], len(time) // 50 + 1), 50)[: len(time)]
    model = CompiledModel(OSCILLATOR, ("position",), (), NUMBERS, 1e-9)
    position = model.segment(np.zeros(2), np.zeros(0), time, push[:, None], False).y[:, 0]
    read = position + noise * rng.standard_normal(len(time))
    return Recording(
        time,
        {"push": push, "position": read},
        {"push": "1", "position": "m"},
        Path(f"oscillator_{seed}.csv"),
        procedure="machine",
        sensors={"position": Sensor("ruler", noise or NOISE, dead_zone=dead_zone)},
    )


def upright() -> Recording:
    """The inverted model over 4 s at 200 Hz, stabilised and excited by its input; alone it grows by e^14."""
    rng = np.random.default_rng(0)
    time = np.arange(801) / 200
    kicks = np.repeat(rng.choice([-1.0, 1.0], 17), 50)
    model, x = CompiledModel(INVERTED, ("position",), (), NUMBERS, 1e-10), np.zeros(2)
    push, position = np.zeros(len(time)), np.zeros(len(time))
    for i in range(800):
        push[i + 1] = kicks[i] - 5 * x[0] - 1.2 * x[1]
        window = slice(i, i + 2)
        x = model.segment(x, np.zeros(0), time[window], push[window, None], False).x
        position[i + 1] = x[0]
    read = position + NOISE / 10 * rng.standard_normal(len(time))
    signals = {"push": push, "position": read}
    return replace(recording(), time=time, signals=signals, sensors={"position": Sensor("ruler", NOISE / 10)})


def run(read: Recording, sub: Subsystem = OSCILLATOR) -> MeasuredRun:
    """The measured run of a recording."""
    return RecordingMap(sub, ("position",), rest=("speed",), values=NUMBERS).run(read)


def problem(
    *runs: MeasuredRun,
    free: tuple[str, ...] = FREE,
    off: float = 1.2,
    priors: dict[str, tuple[float, float | None]] | None = None,
    held_out: tuple[MeasuredRun, ...] = (),
) -> EstimationProblem:
    """The oscillator with measured runs; initial values are `off` times the truth."""
    start = {name: (off * TRUTH[name], None) for name in free}
    parameters = free_parameters(OSCILLATOR, free, start | (priors or {}), NUMBERS)
    return EstimationProblem(OSCILLATOR, ("position",), parameters, runs, held_out, NUMBERS)
