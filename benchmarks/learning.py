"""Accuracy of the tip with a controller that has learned its valves.

    python -m benchmarks.learning [--combinations N] [--seed S]

Each combination is a machine that its controller does not know: dead bands, areas and hysteresis of the
valves, payload, supply pressure, oil temperature and hoses are drawn at random, and so are the variants of
the drives, sensors or none, and the path. The machine does other work first (`work`) and then follows the
path; the error counts along the path alone. Reads build/harvester_control.ssp and
build/faults/harvester_sensors.ssp.
"""

import argparse
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from fmus.controller.paths import COLUMNS, PATHS, Point, Route, controller_inputs, sample, start, start_angles
from fmus.machine.parts import FERIC, MACHINES
from fmus.machine.ssp import section_flows
from orchestrator import Trace, run
from orchestrator.base.errors import Problem
from orchestrator.base.signals import rms

IDEAL, SENSORS = Path("build/harvester_control.ssp"), Path("build/faults/harvester_sensors.ssp")
TIP = [f"manipulator.tip_{n}" for n in ("x", "y", "height")]
USE = "controller.pressure_use"
SUPPLY = "supply.supply_pressure"
LEARNING = "controller.learning"
DRIVES = ("swing", "boom_stick")
LEAST_MARGIN = 25  # bar
QUICK = ("lumped", "quasistatic")  # with sensors; the others take a minute, for noise every millisecond
AXES = ("swing", "boom", "stick")
LEARNED = ("dead_band_up", "dead_band_down", "flow_up", "flow_down", "half_width")
COMPENSATED = {"swing": "compensated", "boom_stick": "compensated", "supply": "load_sensing"}
KINDS: Mapping[str, Mapping[str, str]] = {
    **MACHINES,
    "quasistatic": {"swing": "quasistatic", "boom_stick": "quasistatic"},
    "compensated": COMPENSATED,
    "compensated, friction": {**COMPENSATED, "manipulator": "pendulum_friction"},
}
PRESSURES: Mapping[str, tuple[str, ...]] = {
    **dict.fromkeys(KINDS, ("supply.pressure_setting",)),
    **dict.fromkeys(("compensated", "compensated, friction"), ("supply.pressure_cut_off",)),
    "detailed": ("supply.pump_1_pressure_setting", "supply.pump_2_pressure_setting"),
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


def tracked(case: Case, record: Sequence[str] = ()) -> tuple[Array, Trace, float]:
    """Distance between commanded point and tip [m] over the trace, and the begin of the path [s]."""
    wanted, begin = scenario(case)
    route = start_angles(case.path, start(ROUTES[case.path]), {})
    trace = run(
        SENSORS if case.sensors else IDEAL,
        wanted,
        record=[*TIP, USE, SUPPLY, *record],
        record_step=0.01,
        swap=KINDS[case.kind],
        parameters=["line", "compensated"] if "compensated" in case.kind else ["line"],
        set={**route, LEARNING: 1.0, **case.given},
    ).trace
    radius, height, angle = (
        np.interp(trace.time, wanted.time, wanted[f"path_{n}"]) for n in ("radius", "height", "angle")
    )
    place = radius * np.cos(angle), radius * np.sin(angle), height
    return np.linalg.norm([trace[n] - w for n, w in zip(TIP, place, strict=True)], axis=0), trace, begin


def dead_band(kind: str, by: float) -> dict[str, float]:
    """Start values: dead bands of all valves wider by this [V] than the controller assumes."""
    if kind == "detailed":
        edges = [f"{part}.spool_overlap_{e}" for part in DRIVES for e in ("pa", "at", "pb", "bt")]
        return dict.fromkeys(edges, 0.06 + by / 10)
    return {f"{part}.valve_dead_band": 0.6 + by for part in DRIVES}


def areas(kind: str, share: float) -> dict[str, float]:
    """Start values: areas of the valves, or flows of the sections, over what the controller assumes."""
    if "compensated" in kind:
        own = ("swing.swing", "boom_stick.boom", "boom_stick.stick")
        given = section_flows(FERIC, FERIC.controller)
        flows = {f"{n}_section_flow": given[f"controller.{n.split('.')[1]}_section_flow"] for n in own}
        return {n: share * v for n, v in flows.items()}
    return {f"{part}.valve_area": share * 4e-5 for part in DRIVES}


def drawn(number: int, seed: int) -> Case:
    """A combination."""
    rng = np.random.default_rng((seed, number))
    kind = list(KINDS)[number % len(KINDS)]
    path = list(ROUTES)[rng.integers(len(ROUTES))]
    given = {
        **dead_band(kind, rng.uniform(-0.2, 0.2)),
        **areas(kind, rng.uniform(0.8, 1.2)),
        "valve_actuation.hysteresis": rng.uniform(0.02, 0.06),
        "manipulator.payload_mass": rng.uniform(0, 800),
        **dict.fromkeys(PRESSURES[kind], rng.uniform(150e5, 210e5)),
        "supply.oil_temperature_start": 273.15 + rng.uniform(-10, 60),
    }
    softer = rng.uniform(1, 5)
    if kind != "detailed":
        given |= {"boom_stick.boom_hose_capacitance": softer * 5.4e-13}
        given |= {"boom_stick.stick_hose_capacitance": softer * 7.2e-13}
    sensors = bool(rng.random() < 0.5) and kind in QUICK
    return Case(kind, path, sensors, given, seed=number)


@dataclass(frozen=True)
class Outcome:
    """Largest error and RMS along the path [mm], and the pressure left above what the load needs [bar]."""

    case: Case
    largest: float
    rms: float
    margin: float


def outcome(case: Case) -> Outcome:
    """Run a combination."""
    error, trace, begin = tracked(case)
    on = trace.time >= begin
    least = sliding_window_view(trace[USE][on] * trace[SUPPLY][on], 100).min(axis=1)  # that last a second
    available = case.given[PRESSURES[case.kind][0]]
    margin = (available - least.max() + 5e5) / 1e5
    return Outcome(case, 1e3 * error[on].max(), 1e3 * rms(error[on]), margin)


def shares(found: Sequence[Outcome], label: str) -> None:
    """Print the shares within the bars."""
    if found:
        inner, outer = (
            sum(o.largest <= most and o.rms <= mean for o in found) / len(found)
            for most, mean in ((10, 4), (20, 8))
        )
        print(f"{label:40s} {len(found):4d}  10/4 mm: {inner:4.0%}  20/8 mm: {outer:4.0%}")


def dead_bands() -> None:
    """Print largest errors and RMS for dead bands that the controller does not know, without sensors."""
    print("dead band, largest / RMS [mm]: line, square; with learning, without")
    for kind in ("lumped", "detailed", "compensated"):
        for by in (0.0, 0.2, -0.2):
            cells = []
            for learning in (1.0, 0.0):
                for path in ("line", "square"):
                    given = dead_band(kind, by) | {LEARNING: learning}
                    error, trace, begin = tracked(Case(kind, path, False, given))
                    on = 1e3 * error[trace.time >= begin]
                    cells.append(f"{on.max():5.1f} /{rms(on):5.1f}")
            print(f"{kind:12s} {0.6 + by:.1f} V  " + "  ".join(cells), flush=True)


def main() -> None:
    """Print shares and the worst combinations."""
    parser = argparse.ArgumentParser(description="Accuracy of the tip with learned valves")
    parser.add_argument("--combinations", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--off", action="store_true", help="without learning")
    args = parser.parse_args()
    begin, found, failed = time.monotonic(), list[Outcome](), 0
    dead_bands()
    for number in range(args.combinations):
        case = drawn(number, args.seed)
        if args.off:
            case = replace(case, given={**case.given, LEARNING: 0.0})
        try:
            found.append(outcome(case))
        except Problem as problem:
            failed += 1
            print(f"{case}: {problem}")
    carried = [o for o in found if o.margin > LEAST_MARGIN]
    shares(carried, f"margin above {LEAST_MARGIN} bar")
    for kind in KINDS:
        shares([o for o in carried if o.case.kind == kind], f"  {kind}")
    for sensors in (False, True):
        shares([o for o in carried if o.case.sensors == sensors], f"  {'sensors' if sensors else 'ideal'}")
    light = [o for o in carried if o.case.given["manipulator.payload_mass"] < 300]
    shares(light, "  payload below 300 kg")
    shares(found, "all")
    for o in sorted(carried, key=lambda o: -o.largest)[:8]:
        print(f"{o.largest:6.1f} {o.rms:5.1f} mm, {o.margin:.0f} bar: {o.case}")
    print(f"{len(found)} runs, {failed} failed, {time.monotonic() - begin:.0f} s")


if __name__ == "__main__":
    main()
