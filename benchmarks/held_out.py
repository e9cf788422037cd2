"""`--accuracy` on machines that its tuning never saw.

    python -m benchmarks.held_out [--cases 300] [--tuning] [--cost] [--processes 2] [--out FILE]

A case is a random machine in the folder that `make demo` builds: a variant of each part, factors of 0.5 to 2
on VARIED of the PARAMETERS, commands (the operator's work cycle, or strokes between random levels with
corners at random times), and an accuracy of 1e-2 to 1e-5. The truth is `reference`, which has no coupling.
The file, docs/held-out.jsonl, has a line for each case:

    asked, error      the accuracy, and the largest true RMS error of a joint speed over its range
    estimate          what the card says of it
    runs, steps       number of runs, and of the steps of all
    cpu, cheapest     processor time of the steps of all runs [s], and with --cost that of the cheapest equal
                      steps that are as accurate as asked, found by exhaustive search, without an estimate
    why               the message if the accuracy was not reached

Case n of a seed is the same whatever ran before, and cases that the file has are not run again. So the
command goes on where it was interrupted. The numbers in docs/coupling.md are those of the seed HELD_OUT.
Constants may be tuned with `--tuning`, never with HELD_OUT.
"""

from __future__ import annotations

import json
import re
import sys
import time
from argparse import ArgumentParser
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from fmus.machine.parts import FAMILIES
from orchestrator import Coupling, Problem, Trace, load, reference, run
from orchestrator.engine import run as engine_run
from orchestrator.engine import simulation_loop
from orchestrator.engine.job import Job
from orchestrator.engine.result import RunEnd
from orchestrator.ssp.swap import with_swaps
from orchestrator.ssp.system import System

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "docs" / "held-out.jsonl"
MARKS = "<!-- held out -->\n", "<!-- end -->"
HELD_OUT, TUNING = 20261125, 1  # seeds
STOP = 3.0  # s
RECORD_STEP = 1e-3  # s, of the reference
TOLERANCE = 1e-7  # of the reference, over the accuracy
POWERS = -5.0, -2.0  # of ten, of the accuracies
FACTORS = 0.5, 2.0
VARIED = 6
PARAMETERS = {
    "swing": ("bulk_modulus", "line_length", "line_bore", "motor_displacement", "valve_full_command"),
    "boom_stick": (
        *("bulk_modulus", "density", "boom_hose_length", "stick_hose_length", "boom_hose_bore"),
        *("stick_hose_bore", "boom_dead_volume", "stick_dead_volume", "valve_full_command"),
    ),
    "manipulator": (
        *("head_mass", "boom_mass", "stick_mass", "boom_inertia", "stick_inertia", "column_inertia"),
        *("boom_joint_damping", "stick_joint_damping", "boom_piston_damping", "stick_piston_damping"),
    ),
}
LEVERS = ("swing_command", "boom_command", "stick_command")
STROKES, CORNERS, RAMP = 2 / 3, 5, 0.15  # share of cases with strokes; their number; time of each [s]
SPEEDS = [f"manipulator.{joint}_speed" for joint in ("swing", "boom", "stick")]
TOLD = re.compile(r"estimated RMS error (\S+) of the range")
STANDING = 1e-3  # rad/s: range of a joint that does not move
# what --cost tries
COUPLINGS = (*(Coupling("gauss-seidel", order=n) for n in (0, 2, 3)), Coupling("hermite"))
STEPS = (1e-4, 2e-4, 5e-4, 1e-3, 2e-3, 4e-3, 8e-3, 1.6e-2)  # s
TIME_LIMIT = 300.0  # s, of the steps of one run


@dataclass(frozen=True)
class Case:
    """A machine, what it does, and the accuracy that is asked for."""

    variants: Mapping[str, str]
    factors: Mapping[str, float]
    commands: Mapping[str, list[float]] | None
    asked: float


@dataclass(frozen=True)
class Outcome:
    """What came out of a case, see above; error: NaN if nothing moves."""

    number: int
    variants: Sequence[str]
    asked: float
    error: float = float("nan")
    estimate: float = float("nan")
    runs: int = 0
    steps: int = 0
    cpu: float = 0.0
    cheapest: float = float("nan")
    master: str = ""
    why: str = ""


def case(seed: int, number: int) -> Case:
    """Case n of a seed."""
    rng = np.random.default_rng([seed, number])
    variants = {part: str(rng.choice(list(names))) for part, names in FAMILIES.items()}
    names = [f"{part}.{name}" for part, of in PARAMETERS.items() for name in of]
    low, high = np.log(FACTORS)
    factors = {
        str(name): float(np.exp(rng.uniform(low, high))) for name in rng.choice(names, VARIED, replace=False)
    }
    commands = _strokes(rng) if rng.random() < STROKES else None
    return Case(variants, factors, commands, float(10 ** rng.uniform(*POWERS)))


def _strokes(rng: np.random.Generator) -> dict[str, list[float]]:
    """Commands that move to random levels at random times, each within RAMP."""
    begin = np.linspace(0.2, STOP, CORNERS, endpoint=False) + rng.uniform(0.0, 0.3, CORNERS)
    times = [0.0, *np.ravel(np.column_stack([begin, begin + RAMP])).tolist(), 2 * STOP]
    levels = rng.choice([-4.0, -2.0, 0.0, 2.0, 4.0], (len(LEVERS), CORNERS))
    held = np.repeat(np.column_stack([np.zeros(len(LEVERS)), levels]), 2, axis=1)
    return {"time": times, **dict(zip(LEVERS, held.tolist(), strict=True))}


Truth = Mapping[str, tuple[Any, float]]  # of a joint that moves: its speed over time [rad/s], and its range


def splines(trace: Trace) -> Truth:
    """The joint speeds of the reference."""
    spans = {name: float(np.ptp(trace[name])) for name in SPEEDS}
    return {
        name: (CubicSpline(trace.time, trace[name]), span) for name, span in spans.items() if span > STANDING
    }


def error(trace: Trace, truth: Truth) -> float:
    """The largest RMS error of a joint speed over its range; NaN if no joint moves."""
    t = trace.time
    squares = [
        float(np.trapezoid(np.square(trace[name] - true(t)), t)) / (t[-1] - t[0]) / span**2
        for name, (true, span) in truth.items()
    ]
    return float(np.sqrt(max(squares, default=float("nan"))))


class Measured:
    """The number, steps and processor time of runs, also of those that fail or are not accurate enough."""

    def __init__(self) -> None:
        self.ends: list[RunEnd] = []
        self.looks: list[RunEnd] = []  # at the operator alone: their time counts, their steps are of one FMU
        self._simulate = engine_run.simulate
        engine_run.simulate = self._noted
        clocks = {**vars(time), "perf_counter": time.thread_time}
        simulation_loop.time = SimpleNamespace(**clocks)  # type: ignore[assignment]

    def _noted(self, job: Job, *others: Any) -> RunEnd:
        end = self._simulate(job, *others)
        (self.ends if job.options.error_estimate else self.looks).append(end)
        return end


def outcome(seed: int, number: int, build: Path, with_cost: bool) -> Outcome:
    """Run a case and its reference."""
    chosen, measured = case(seed, number), Measured()
    system = with_swaps(load(build / "harvester.ssp"), chosen.variants)
    values = {}
    for name, factor in chosen.factors.items():
        part, _, variable = name.partition(".")
        component = system.components[part]
        own = component.start.get(variable, component.interface.variables[variable].start)
        values[name] = factor * float(own or 0.0)
    same: dict[str, Any] = {"stop": STOP, "set": values}
    ours = {**same, "isolate": False, "record": SPEEDS}
    found = Outcome(number, tuple(chosen.variants.values()), chosen.asked)
    exchanged = with_swaps(load(build / "harvester.ssp"), chosen.variants)
    try:
        solved = reference(
            exchanged, chosen.commands, tolerance=TOLERANCE * chosen.asked, record_step=RECORD_STEP, **same
        )
        truth = splines(solved.trace)
        try:
            result = run(system, chosen.commands, accuracy=chosen.asked, accuracy_of=SPEEDS, **ours)
            found = replace(
                found,
                error=error(result.trace, truth),
                estimate=float(TOLD.search(result.card.notes[-1])[1]),  # type: ignore[index]
                master=result.coupling.master,
            )
        finally:
            ends = tuple(measured.ends)
            found = replace(
                found,
                runs=len(ends),
                steps=sum(e.steps + e.repeated for e in ends),
                cpu=sum(e.wall for e in (*ends, *measured.looks)),
            )
        if with_cost:
            found = replace(found, cheapest=cheapest(system, chosen, truth, ours))
    except Problem as problem:
        found = replace(found, why=str(problem))
    engine_run.simulate = measured._simulate
    return found


def cheapest(system: System, chosen: Case, truth: Truth, options: Mapping[str, Any]) -> float:
    """The least processor time of equal steps that are as accurate as asked [s]."""
    best = float("inf")
    for coupling in COUPLINGS:
        for step in reversed(STEPS):
            try:
                result = run(system, chosen.commands, master=coupling, step=step, **options)
            except Problem:
                continue
            if error(result.trace, truth) <= chosen.asked:
                best = min(best, result.card.wall)
                break
    return best


def table(outcomes: Sequence[Outcome]) -> str:
    """The numbers of the page; met: the true error is at most what was asked."""
    lines = [
        "|accuracy|machines|met|estimate 0.5 to 2 times the truth|steps over those of 1 ms: median|most|",
        "|---|--:|--:|--:|--:|--:|",
    ]
    groups = [(f"{10.0**p:g} to {10.0 ** (p + 1):g}", 10.0**p, 10.0 ** (p + 1)) for p in range(-5, -2)]
    for name, low, high in (*groups, ("all", 0.0, 1.0)):
        of = [o for o in outcomes if low <= o.asked < high and (o.error == o.error or o.why)]
        if not of:
            continue
        met = np.mean([o.error <= o.asked for o in of])
        near = np.mean([0.5 <= o.estimate / o.error <= 2.0 for o in of if o.error == o.error])
        work = np.array([o.steps for o in of]) * 1e-3 / STOP
        shares = f"{100 * met:.1f} %|{100 * near:.1f} %|{np.median(work):.2f}|{np.max(work):.2f}"
        lines.append(f"|{name}|{len(of)}|{shares}|")
    return "\n".join(lines)


def read(file: Path) -> list[Outcome]:
    """The outcomes in a file, by number."""
    lines = file.read_text(encoding="utf-8").splitlines() if file.exists() else []
    return sorted((Outcome(**json.loads(line)) for line in lines), key=lambda o: o.number)


def write(outcomes: Sequence[Outcome]) -> None:
    """Write the table into docs/coupling.md."""
    page = ROOT / "docs" / "coupling.md"
    before, rest = page.read_text(encoding="utf-8").split(MARKS[0])
    after = rest[rest.index(MARKS[1]) :]
    page.write_text(f"{before}{MARKS[0]}{table(outcomes)}\n{after}", encoding="utf-8")


def main() -> None:
    """Run what is missing in the file, and print the summary."""
    parser = ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--cases", type=int, default=300)
    parser.add_argument("--tuning", action="store_true")
    parser.add_argument("--cost", action="store_true")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--build", type=Path, default=Path("build"))
    parser.add_argument("--out", type=Path)
    given = parser.parse_args()
    seed, began = TUNING if given.tuning else HELD_OUT, time.monotonic()
    file = given.out or (Path("build/tuning.jsonl") if given.tuning else RESULTS)
    outcomes = {o.number: o for o in read(file)}
    missing = [n for n in range(given.cases) if n not in outcomes]
    with ProcessPoolExecutor(given.processes) as pool, file.open("a") as lines:
        started = [pool.submit(outcome, seed, n, given.build, given.cost) for n in missing]
        for done in as_completed(started):
            found = done.result()
            outcomes[found.number] = found
            lines.write(json.dumps(asdict(found)) + "\n")
            lines.flush()
            print(found, file=sys.stderr, flush=True)
    chosen = [o for o in outcomes.values() if o.number < given.cases]
    print(table(chosen))
    costs = [o.cpu / o.cheapest for o in chosen if 0.0 < o.cheapest < float("inf")]
    if costs:
        print("cost over the cheapest: median {:.2f}, 95 % {:.2f}".format(*np.quantile(costs, [0.5, 0.95])))
    if file == RESULTS:
        write(chosen)
    print(f"{time.monotonic() - began:.0f} s for {len(missing)} cases in {given.processes} processes")


if __name__ == "__main__":
    main()
