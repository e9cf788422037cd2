"""Accuracy of the tip with a controller that has learned its valves.

    python -m benchmarks.learning [--combinations N] [--seed S]

Each combination is a machine that its controller does not know: dead bands, areas and hysteresis of the
valves, payload, supply pressure, oil temperature and hoses are drawn at random, and so are the variants of the
drives, sensors or none, and the path. The machine does other work first (`work`) and then follows the path;
the error counts along the path alone. Reads build/harvester_control.ssp and
build/faults/harvester_sensors.ssp.
"""

import argparse
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fmus.controller.paths import COLUMNS, PATHS, Point, Route, controller_inputs, sample
from fmus.machine.parts import MACHINES
from orchestrator import Trace, run
from orchestrator.base.errors import Problem

IDEAL, SENSORS = Path("build/harvester_control.ssp"), Path("build/faults/harvester_sensors.ssp")
TIP = [f"manipulator.tip_{n}" for n in ("x", "y", "height")]
USE = "controller.pressure_use"
AXES = ("swing", "boom", "stick")
LEARNED = ("dead_band_up", "dead_band_down", "flow_up", "flow_down", "half_width")
COMPENSATED = {"swing": "compensated", "boom_stick": "compensated", "supply": "load_sensing"}
KINDS: Mapping[str, Mapping[str, str]] = {
    **MACHINES,
    "quasistatic": {"swing": "quasistatic", "boom_stick": "quasistatic"},
    "compensated": COMPENSATED,
    "compensated, friction": {**COMPENSATED, "manipulator": "pendulum_friction"},
}
CYCLE = Route(
    tuple(
        (radius * np.cos(angle), radius * np.sin(angle), height)
        for radius, height, angle in (
            *((4.5, 0.5, 0.0), (5.5, 0.2, 0.0), (5.5, 1.2, 0.0), (3.8, 1.8, 0.8)),
            *((3.8, 0.8, 0.8), (3.8, 1.8, 0.8), (4.5, 0.5, 0.0)),
        )
    ),
    speed=0.6,
    wait=1.0,
)
ROUTES = {**PATHS, "cycle": CYCLE}
Array = NDArray[np.float64]


def work(start: Point, seconds: float, seed: int) -> tuple[Array, Array]:
    """Points and velocities (n, 3) of straight motions between random points, from rest to rest, and back."""
    rng, here, clock = np.random.default_rng(seed), start, 0.0
    points, velocities, sign = list[Array](), list[Array](), 1.0
    while here != start or clock == 0:
        radius, angle, height = rng.uniform(3.6, 5.2), sign * rng.uniform(0.0, 0.5), rng.uniform(0.3, 1.9)
        there: Point = (radius * np.cos(angle), radius * np.sin(angle), height)
        there, sign = there if clock < seconds - 6 else start, -sign
        _, way, speed = sample(Route((here, there), speed=rng.uniform(0.3, 0.9), wait=0.3))
        points.append(way)
        velocities.append(speed)
        here, clock = there, clock + len(way) / 200
    return np.concatenate(points), np.concatenate(velocities)


@dataclass(frozen=True)
class Case:
    """A machine, its path, and the seconds of other work before it."""

    kind: str
    path: str
    sensors: bool
    given: Mapping[str, float]
    before: float = 45.0
    seed: int = 0
    sets: tuple[str, ...] = ()

    def __str__(self) -> str:
        given = ", ".join(f"{n.split('.')[-1]} {v:.3g}" for n, v in self.given.items())
        return f"{self.kind}, {self.path}, {'sensors' if self.sensors else 'ideal'}: {given}"


def scenario(case: Case) -> tuple[Trace, float]:
    """Inputs of the controller, and the time at which the path begins."""
    _, points, velocities = sample(ROUTES[case.path])
    begin = 0.0
    if case.before:
        first, speeds = work(ROUTES[case.path].points[0], case.before, case.seed)
        points, velocities = np.concatenate([first, points]), np.concatenate([speeds, velocities])
        begin = len(first) / 200
    columns = controller_inputs(points, velocities).T
    return Trace(np.arange(len(points)) / 200, dict(zip(COLUMNS, columns, strict=True))), begin


def tracked(case: Case, record=(), changes=None, files=None, extra=None) -> tuple[Array, Array, Trace, float]:
    """Time, distance between commanded point and tip [m], the trace, begin of the path."""
    from fmus.controller.paths import start, start_angles

    wanted, begin = scenario(case)
    if extra:
        wanted = replace(wanted, signals={**wanted.signals, **{k: f(wanted.time, begin) for k, f in extra.items()}})
    given = dict(start_angles(case.path, start(ROUTES[case.path]), {})) | dict(case.given)
    sets = ["compensated"] if "compensated" in case.kind else []
    ideal, sens = files or (IDEAL, SENSORS)
    result = run(sens if case.sensors else ideal, wanted, record=[*TIP, USE, *record], record_step=0.01,
        swap=KINDS[case.kind], parameters=["line", *sets], set=given)  # fmt: skip
    trace = result.trace
    radius, height, angle = (np.interp(trace.time, wanted.time, wanted[f"path_{n}"]) for n in ("radius", "height", "angle"))
    place = radius * np.cos(angle), radius * np.sin(angle), height
    error = np.linalg.norm([trace[n] - w for n, w in zip(TIP, place, strict=True)], axis=0)
    return trace.time, error, trace, begin


def dead_band(kind: str, by: float) -> dict[str, float]:
    if kind == "detailed":
        return {f"{part}.spool_overlap_{e}": 0.06 + by / 10 for part in ("swing", "boom_stick") for e in ("pa", "at", "pb", "bt")}
    return {f"{part}.valve_dead_band": 0.6 + by for part in ("swing", "boom_stick")}
