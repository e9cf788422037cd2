"""Benchmark of parameter studies: speed, scaling over workers, and results after a kill.

    python -m benchmarks.sweep [--runs 2000] [--seconds 10]
    python -m benchmarks.sweep --lanes    writes the table of docs/sweep.md: lanes against single runs
    python -m benchmarks.sweep --processes --runs 1000 --seconds 2    processor time in lanes and in processes

A Latin hypercube of four factors of build/harvester.ssp, the lumped machine in its work cycle. Each study is
one command, timed from start to end. First all runs with two workers; then half of them with two workers,
with one, and with two again, killed by SIGKILL when half of the runs are stored, and started again. This
takes half a minute. Wall times need an idle computer; the processor time of all processes, printed next to
them, depends less on other load. Some runs of the first study are repeated one by one, by `run` at 1 ms.

Limits: LIMIT [s] for 2000 runs of 10 s on two cores; two workers RATIO times as fast as one; equal results;
outputs within SAME of those of the single runs, relative to their range. Exit status 1 if one is missed. The
times of a smaller study have no limits: most of its time is the start of processes.
"""

from __future__ import annotations

import argparse
import os
import resource
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq

from orchestrator import Coupling, System, batch, load, run, with_swaps
from orchestrator.base.errors import Problem
from orchestrator.data.trace import Trace
from orchestrator.lanes.batch import BatchResult

SYSTEM = Path("build/harvester.ssp")
RUNS, SECONDS = 2000, 10.0  # of the study whose times have limits
LIMIT, RATIO = 12.0, 1.7  # [s] for this study; wall time of one worker over that of two
SAME, SINGLE, MILLISECOND = 1e-4, 16, 1e-3  # of the range; number of single runs; their step [s]
STUDY = """
title = "Speed"
system = "{system}"
method = "latin"
runs = {runs}
seed = 1
stop = {seconds}

[factors]
"swing.motor_displacement" = {{ distribution = "uniform", minimum = 0.9, maximum = 1.1, relative = true }}
"swing.line_capacitance" = {{ distribution = "uniform", minimum = 4.7e-13, maximum = 1.88e-12 }}  # m3/Pa
"manipulator.head_mass" = {{ distribution = "uniform", minimum = 300, maximum = 400, unit = "kg" }}
"supply.pressure_setting" = {{ distribution = "normal", mean = 170, sd = 5, unit = "bar" }}

[outputs]
peak_a = {{ signal = "swing.swing_pressure_a", measure = "maximum", band = true }}
peak_b = {{ signal = "swing.swing_pressure_b", measure = "maximum" }}
angle = {{ signal = "manipulator.swing_angle", measure = "final" }}
"""

# ---- lanes against single runs

MASS = "manipulator.head_mass"
# of the mass, relative: a run amplifies them as it does rounding. Several, because each may or may not decide
# whether a step is divided
CHANGES = (-3e-12, -2e-12, -1e-12, 1e-12, 2e-12, 3e-12)
# bars of the distance of lanes to a run: ten times what stops and cavities make of rounding; above it,
# a multiple of what a change makes, which occurs once, while rounding occurs in each operation: 11 at most
ROUNDING, TIMES = 1e-10, 20.0
COUPLINGS = {  # with their steps [s]; None: adaptive
    "jacobi": (Coupling("jacobi"), 1e-3),
    "jacobi, order 1": (Coupling("jacobi", order=1), 1e-3),
    "jacobi, order 3": (Coupling("jacobi", order=3), 1e-3),
    "gauss-seidel": (Coupling("gauss-seidel"), 1e-3),
    "gauss-seidel, guarded": (Coupling("gauss-seidel", guard=1e-3), 2e-3),
    "gauss-seidel, order 1": (Coupling("gauss-seidel", order=1), 1e-3),
    "gauss-seidel, order 3": (Coupling("gauss-seidel", order=3), 1e-3),
    "gauss-seidel, order 3, guarded": (Coupling("gauss-seidel", order=3, guard=0.01), 4e-3),
    "hermite, 1 pass": (Coupling("hermite", passes=1), 5e-3),
    "hermite, 2 passes": (Coupling("hermite", passes=2), 5e-3),
    "hermite, not guarded": (Coupling("hermite", guard=0.0), 5e-3),
    "hermite": (Coupling("hermite"), 5e-3),
    "hermite, adaptive": (Coupling("hermite", adaptive=1e-4), None),
}
COMPENSATED = {"swing": "compensated", "boom_stick": "compensated"}
MACHINES = {
    "shipped": {},
    "compensated": COMPENSATED,
    "compensated, with a pump": COMPENSATED | {"supply": "engine_pump"},
}
PAGE, MARKS = Path(__file__).parents[1] / "docs/sweep.md", ("<!-- lanes -->\n", "<!-- end -->")


@dataclass(frozen=True)
class Machine:
    """A machine, coupling (None: suggested), step (None: adaptive or suggested) [s], head mass [kg]."""

    system: System
    coupling: Coupling | None
    step: float | None
    mass: float
    scenario: dict[str, list[float]] | None = None
    stop: float = 3.0

    @property
    def options(self) -> dict[str, Any]:
        """Of `batch` and `run`."""
        steps = {"record_step": 0.01} if self.step is None else {"step": self.step}
        return ({"master": self.coupling} if self.coupling else {}) | {"stop": self.stop} | steps

    def lanes(self) -> BatchResult:
        """All outputs in lanes."""
        return batch(self.system, {MASS: [self.mass]}, self.scenario, lanes=True, **self.options)

    def run(self, change: float = 0.0) -> Trace:
        """All outputs of the run of the machine, or of one whose mass differs."""
        outputs = [str(port) for port in self.system.ports("output")]
        start = {MASS: self.mass * (1.0 + change)}
        options = {"record": outputs, "isolate": False, **self.options}
        return run(self.system, self.scenario, set=start, **options).trace

    def changed(self, single: Trace) -> float:
        """The largest distance of the run to one of a machine whose mass differs by one of CHANGES."""
        return max(self.distance(self.run(change), single) for change in CHANGES)

    def distance(self, a: Trace, b: Trace) -> float:
        """Largest difference of an output at any time, over the larger of its range and nominal value."""
        nominal = {name: self.system.variable(self.system.port(name)).nominal or 1.0 for name in b.signals}
        size = {name: max(np.ptp(values), abs(nominal[name])) for name, values in b.signals.items()}
        return float(max(np.abs(a[name] - values).max() / size[name] for name, values in b.signals.items()))


def agreement() -> str:
    """A table: distance of lanes to the run, and of the run to that of another mass; the work cycle."""
    system = load(SYSTEM)
    rows = [["coupling", *MACHINES], ["-"] * (1 + len(MACHINES))]
    for name, coupling in COUPLINGS.items():
        cells = [_cell(Machine(with_swaps(system, swaps), *coupling, 350.0)) for swaps in MACHINES.values()]
        rows.append([name, *cells])
        print("|".join(rows[-1]), flush=True)
    return "".join(f"|{'|'.join(row)}|\n" for row in rows)


def _cell(machine: Machine) -> str:
    """Both distances; that in lanes first."""
    try:
        single = machine.run()
    except Problem:
        return "both fail" if machine.lanes().status == ["failed"] else "only the run fails"
    return f"{machine.distance(machine.lanes().trace(0), single):.0e}, {machine.changed(single):.0e}"


def write_agreement() -> None:
    """Put the table in its place in docs/sweep.md."""
    before, rest = PAGE.read_text(encoding="utf-8").split(MARKS[0])
    after = rest[rest.index(MARKS[1]) :]
    PAGE.write_text(f"{before}{MARKS[0]}{agreement()}{after}", encoding="utf-8")


@dataclass(frozen=True)
class Cost:
    """Times of a command [s]: wall time, and processor time of all processes."""

    wall: float
    cpu: float

    def __str__(self) -> str:
        return f"wall time {self.wall:6.1f} s, processor time {self.cpu:6.1f} s"


def start(study: Path, out: Path, workers: int) -> subprocess.Popen[bytes]:
    """Start the command."""
    command = [sys.executable, "-m", "orchestrator", "sweep", str(study), "--out", str(out), "--no-report"]
    return subprocess.Popen(
        [*command, "--workers", str(workers)], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE
    )


def time_study(study: Path, out: Path, workers: int) -> Cost:
    """Run a study and measure its times."""
    before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    process = start(study, out, workers)
    _, messages = process.communicate()
    if process.returncode:
        raise SystemExit(messages.decode().splitlines()[-1])
    after, wall = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter() - began
    return Cost(wall, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)


def print_processes(runs: int, seconds: float) -> None:
    """Print the processor time of machines in lanes and one by one in processes, in turn, and the ratio."""
    masses, spent = {MASS: np.linspace(300.0, 400.0, runs)}, []
    options = {"step": MILLISECOND, "stop": seconds, "record": ["manipulator.swing_angle"], "workers": 2}
    for lanes in (True, False):
        before = os.times()
        result = batch(SYSTEM, masses, lanes=lanes, **options)
        spent.append(sum(os.times()[:4]) - sum(before[:4]))
        where = f"in {'lanes' if lanes else 'processes'}, {result.wall:.3g} s of wall time"
        print(f"{runs} machines, {seconds:g} s, {where}: {spent[-1]:.3g} s", flush=True)
    print(f"ratio {spent[1] / spent[0]:.1f}")


def stored_runs(out: Path) -> int:
    """Number of finished runs in the folder."""
    return sum(pq.read_metadata(f).num_rows for f in out.glob("parts/batch-*.parquet"))


def kill_and_restart(study: Path, out: Path, runs: int) -> int:
    """Kill a study half-way and start it again; returns the number of runs stored at the kill."""
    process = start(study, out, 2)
    while stored_runs(out) < runs // 2 and process.poll() is None:
        time.sleep(0.1)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    stored = stored_runs(out)
    time_study(study, out, 2)
    return stored


def equal_results(a: Path, b: Path) -> bool:
    """Are the results equal, byte by byte?"""
    contents = [{f.relative_to(at): f.read_bytes() for f in at.glob("*.parquet/*")} for at in (a, b)]
    return contents[0] == contents[1]


def difference(out: Path, seconds: float) -> float:
    """Largest difference of an output to single runs with the same factors, over its range in all runs."""
    table, worst = pq.read_table(out / "runs.parquet"), 0.0
    columns = {name: table[name].to_numpy() for name in table.column_names}
    factors = [name.removeprefix("factor:") for name in columns if name.startswith("factor:")]
    signals = ["swing.swing_pressure_a", "swing.swing_pressure_b", "manipulator.swing_angle"]
    for i in range(min(SINGLE, table.num_rows)):
        values = {name: float(columns[f"start:{name}"][i]) for name in factors}  # in the units of the FMUs
        trace = run(SYSTEM, set=values, step=MILLISECOND, stop=seconds, record=signals, isolate=False).trace
        a, b, angle = (trace[name] for name in signals)
        for name, value in (("peak_a", a.max()), ("peak_b", b.max()), ("angle", angle[-1])):
            worst = max(worst, abs(columns[f"output:{name}"][i] - value) / np.ptp(columns[f"output:{name}"]))
    return float(worst)


@dataclass(frozen=True)
class Check:
    """One measured value and its limit."""

    name: str
    value: str
    limit: str
    passed: bool


def table(checks: list[Check]) -> str:
    """A row for each check."""
    rows = [("check", "value", "limit", "")]
    rows += [(c.name, c.value, c.limit, "passed" if c.passed else "MISSED") for c in checks]
    widths = [max(len(row[i]) for row in rows) for i in range(4)]
    lines = [
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows
    ]
    return "\n".join([lines[0], "-" * (sum(widths) + 6), *lines[1:]])


def write_study(home: Path, runs: int, seconds: float) -> Path:
    """Write the file of a study."""
    file = home / f"{runs}.toml"
    file.write_text(STUDY.format(system=SYSTEM.resolve(), runs=runs, seconds=seconds), encoding="utf-8")
    return file


def measure(home: Path, runs: int, seconds: float) -> list[Check]:
    """Run all studies, print their times, and return the checks."""
    every = time_study(write_study(home, runs, seconds), home / "all", 2)
    print(f"{runs} runs, two workers: {every}, {every.cpu / runs:.3f} s per run", flush=True)
    apart = difference(home / "all", seconds)
    half = write_study(home, runs // 2, seconds)
    two = time_study(half, home / "two", 2)
    print(f"{runs // 2} runs, two workers: {two}", flush=True)
    one = time_study(half, home / "one", 1)
    print(f"{runs // 2} runs, one worker:  {one}", flush=True)
    stored = kill_and_restart(half, home / "killed", runs // 2)
    print(f"{runs // 2} runs, two workers: killed when {stored} were stored, started again\n", flush=True)
    limit, ratio = LIMIT * runs * seconds / (RUNS * SECONDS), one.wall / two.wall
    equal = {
        "one and two workers": equal_results(home / "two", home / "one"),
        "killed": equal_results(home / "two", home / "killed"),
    }
    different = [name for name, same in equal.items() if not same]
    times = [
        Check(f"{runs} runs of {seconds:g} s", f"{every.wall:.1f} s", f"< {limit:g} s", every.wall < limit),
        Check("one worker over two", f"{ratio:.2f}", f">= {RATIO:g}", ratio >= RATIO),
    ]
    shorter = runs < RUNS or seconds < SECONDS
    return ([] if shorter else times) + [
        Check("outputs: single runs", f"{apart:.1e} of range", f"< {SAME:g}", apart < SAME),
        Check(
            "results: one, two, killed",
            f"differs: {', '.join(different)}" if different else "equal",
            "equal",
            not different,
        ),
    ]


def main() -> int:
    """Run all studies, print the checks; status 1 if one is missed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=RUNS)
    parser.add_argument("--seconds", type=float, default=SECONDS)
    parser.add_argument("--lanes", action="store_true", help="write the table of lanes against single runs")
    parser.add_argument("--processes", action="store_true", help="compare lanes with processes")
    arguments = parser.parse_args()
    if arguments.processes:
        print_processes(arguments.runs, arguments.seconds)
        return 0
    if arguments.lanes:
        write_agreement()
        return 0
    print(f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f} before", flush=True)
    with tempfile.TemporaryDirectory() as folder:
        checks = measure(Path(folder), arguments.runs, arguments.seconds)
    print(table(checks))
    return 0 if all(c.passed for c in checks) else 1


if __name__ == "__main__":
    sys.exit(main())
