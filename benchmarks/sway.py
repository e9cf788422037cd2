"""Sway that a move of the tip leaves in the hanging head, with its time law shaped and not.

    python -m benchmarks.sway [--moves N] [--seed S]

Moves from rest to rest at random places, straight or along a circle about the column, at random speeds, on
machines whose head swings. The residual sway is the largest angle of the head from the vertical within a
period after the move. The shaper has the period of the head, or one that is wrong by a share. Reads
build/harvester_control.ssp.
"""

import argparse
import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fmus.controller.paths import COLUMNS, Point, Route, controller_inputs, sample, start_angles
from fmus.machine.feasible import MECHANICS
from fmus.machine.parts import MACHINES
from fmus.machine.path_following import HARVESTER
from fmus.machine.sway import Mode, shaped, together
from orchestrator import Trace, load, run
from orchestrator.base.signals import rms
from orchestrator.ssp.swap import with_swaps

MACHINE = Path("build/harvester_control.ssp")
NAMES = HARVESTER
KINDS: Mapping[str, Mapping[str, str]] = {
    "lumped, pendulum": {"manipulator": "pendulum"},
    "detailed": MACHINES["detailed"],
    "compensated, pendulum_friction": {
        **{"swing": "compensated", "boom_stick": "compensated", "supply": "load_sensing"},
        "manipulator": "pendulum_friction",
    },
}
SETS = {"compensated, pendulum_friction": ["line", "compensated"]}
WRONG = (0.0, -0.1, 0.1, -0.2, 0.2)  # of the period
HEAD = ["manipulator.head_angle", "manipulator.head_side_angle"]
TIP = ["manipulator.tip_x", "manipulator.tip_y", "manipulator.tip_height"]
REST = 5.0  # s, after a move
Array = NDArray[np.float64]


def straight(begin: Point, end: Point, speed: float) -> Trace:
    """Inputs of the controller for a straight move [m, m/s]."""
    time, points, velocities = sample(Route((begin, end), speed=speed))
    return Trace(time, dict(zip(COLUMNS, controller_inputs(points, velocities).T, strict=True)))


def circular(radius: float, height: float, begin: float, turn: float, speed: float) -> Trace:
    """The same along a circle about the column, from an angle by a turn [rad]."""
    time, points, _ = sample(Route(((0.0, 0.0, 0.0), (radius * abs(turn), 0.0, 0.0)), speed=speed))
    angle = begin + math.copysign(1.0, turn) * points[:, 0] / radius
    still, ones = np.zeros_like(time), np.ones_like(time)
    columns = (still, still, np.gradient(angle, time), radius * ones, height * ones, angle, ones, ones)
    return Trace(time, dict(zip(COLUMNS, columns, strict=True)))


def moves(count: int, seed: int) -> list[tuple[str, Trace]]:
    """Random moves, straight and circular in turn."""
    rng, found = np.random.default_rng(seed), list[tuple[str, Trace]]()
    while len(found) < count:
        (r, s), (a, b), (z, y) = rng.uniform(3.6, 5.2, 2), rng.uniform(-0.8, 0.8, 2), rng.uniform(0.3, 1.9, 2)
        speed, level = rng.uniform(0.3, 0.9), rng.random() < 0.5
        if len(found) % 2:
            found.append(("circle", circular(r, z, a, math.copysign(0.2, b) + b, speed)))
            continue
        points = [(p * np.cos(q), p * np.sin(q), h) for p, q, h in ((r, a, z), (s, b, z if level else y))]
        found.append(("straight", straight(points[0], points[1], speed)))
    return found


def residual(kind: str, move: Trace, modes: Sequence[Mode] = ()) -> tuple[float, float]:
    """Sway after a move [rad], shaped for some modes; largest error of the tip [m]."""
    wanted = shaped(move, NAMES.path, NAMES.velocity, modes) if modes else move
    place = [wanted[n] for n in NAMES.path]
    velocities = {n: np.gradient(x, wanted.time) for n, x in zip(NAMES.velocity, place, strict=True)}
    wanted = replace(wanted, signals={**wanted.signals, **velocities})
    first: Point = (float(place[0][0]), float(place[1][0]), float(place[2][0]))
    trace = run(
        MACHINE,
        wanted,
        record=[*HEAD, *TIP],
        record_step=0.01,
        stop=float(wanted.time[-1]) + REST,
        swap=KINDS[kind],
        parameters=SETS.get(kind, ["line"]),
        set=start_angles("move", first, {}),
    ).trace
    radius, height, angle = (np.interp(trace.time, wanted.time, x) for x in place)
    path = radius * np.cos(angle), radius * np.sin(angle), height
    error = np.linalg.norm([trace[n] - x for n, x in zip(TIP, path, strict=True)], axis=0)
    end = wanted.time[-1] - Route(()).wait  # a move is followed by a rest
    after = (trace.time >= end) & (trace.time <= end + 2.2)
    return float(np.hypot(*(trace[n][after] for n in HEAD)).max()), float(error.max())


def main() -> None:
    """Print the residual sway of each machine and kind of move."""
    parser = argparse.ArgumentParser(description="Sway that a move leaves in the hanging head")
    parser.add_argument("--moves", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    print("RMS of the sway after a move [mrad], largest error of the tip [mm]; period wrong by")
    print(f"{'':42s} unshaped     " + "  ".join(f"{w:+6.0%}" for w in WRONG) + "   change    error")
    for kind, swaps in KINDS.items():
        begin, system = time.monotonic(), with_swaps(load(MACHINE), swaps)
        modes = together(MECHANICS.sway(system.components["manipulator"]))
        given = moves(args.moves, args.seed)
        for shape in ("straight", "circle"):
            chosen = [m for s, m in given if s == shape]
            free = [residual(kind, m) for m in chosen]
            held = [[residual(kind, m, [(t * (1 + w), z) for t, z in modes]) for m in chosen] for w in WRONG]
            before, after = (1e3 * rms(np.array([x for x, _ in f])) for f in (free, held[0]))
            each = "  ".join(f"{1e3 * rms(np.array([x for x, _ in h])):6.1f}" for h in held)
            errors = " / ".join(f"{1e3 * max(e for _, e in f):.0f}" for f in (free, held[0]))
            print(
                f"{kind:32s} {shape:9s} {before:8.1f}     {each}   {after / before - 1:+.0%}  {errors}",
                flush=True,
            )
        periods = ", ".join(f"{t:.2f} s" for t, _ in modes)
        print(f"  period {periods}, {len(given)} moves, {time.monotonic() - begin:.0f} s", flush=True)


if __name__ == "__main__":
    main()
