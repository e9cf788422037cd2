"""How fast is a study, how does it scale, and does it survive a kill?

    python -m benchmarks.sweep [--runs 2000] [--seconds 10]

A Latin hypercube of four numbers of build/harvester.ssp, the lumped machine in its work cycle, by the command
line: from its start to its end, everything included. First all runs with two workers; then half of them with
two workers, with one, and with two again, killed by SIGKILL when half is kept, and started again. Some four
minutes. Wall times want an idle machine; processor time, of all processes together, is told beside them
because it depends less on that.

Bars: LIMIT [s] for 2000 runs of 10 s on two cores; two workers RATIO times one; equal content. Exit status
1 if one is missed.
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

import pyarrow.parquet as pq

SYSTEM = Path("build/harvester.ssp")
LIMIT, RATIO = 180.0, 1.7  # [s] for 2000 runs of 10 s; of one worker over two
STUDY = """
title = "Speed"
system = "{system}"
method = "latin"
runs = {runs}
seed = 1
stop = {seconds}

[factors]
"swing.motor_displacement" = {{ distribution = "uniform", minimum = 0.9, maximum = 1.1, relative = true }}
"swing.line_capacitance" = {{ distribution = "uniform", minimum = 4.7e-13, maximum = 1.88e-12 }}
"manipulator.head_mass" = {{ distribution = "uniform", minimum = 300, maximum = 400, unit = "kg" }}
"supply.pressure_setting" = {{ distribution = "normal", mean = 170, sd = 5, unit = "bar" }}

[outputs]
peak_a = {{ signal = "swing.swing_pressure_a", measure = "maximum", band = true }}
peak_b = {{ signal = "swing.swing_pressure_b", measure = "maximum" }}
angle = {{ signal = "manipulator.swing_angle", measure = "final" }}
"""


@dataclass(frozen=True)
class Cost:
    """Times of a command [s]: on the clock, and of all processors."""

    wall: float
    cpu: float

    def __str__(self) -> str:
        return f"{self.wall:6.1f} s on the clock, {self.cpu:6.1f} s of processors"


def started(study: Path, out: Path, workers: int) -> subprocess.Popen[bytes]:
    """The command line."""
    command = [sys.executable, "-m", "orchestrator", "sweep", str(study), "--out", str(out), "--no-report"]
    return subprocess.Popen(
        [*command, "--workers", str(workers)], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE
    )


def timed(study: Path, out: Path, workers: int) -> Cost:
    """A study from begin to end."""
    before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    process = started(study, out, workers)
    _, told = process.communicate()
    if process.returncode:
        raise SystemExit(told.decode().splitlines()[-1])
    after, wall = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter() - began
    return Cost(wall, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)


def kept(out: Path) -> int:
    """How many runs are finished."""
    return sum(pq.read_metadata(f).num_rows for f in out.glob("parts/batch-*.parquet"))


def killed(study: Path, out: Path, runs: int) -> int:
    """Kill a study half-way, start it again; the runs that were kept at the kill."""
    process = started(study, out, 2)
    while kept(out) < runs // 2 and process.poll() is None:
        time.sleep(0.1)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    there = kept(out)
    timed(study, out, 2)
    return there


def same(a: Path, b: Path) -> bool:
    """Are the results the same, byte by byte?"""
    names = ("runs.parquet", "bands.parquet")
    return all((a / name).read_bytes() == (b / name).read_bytes() for name in names)


@dataclass(frozen=True)
class Bar:
    """Something that has to be reached."""

    what: str
    found: str
    wanted: str
    met: bool


def table(bars: list[Bar]) -> str:
    """A row for each bar."""
    rows = [("bar", "found", "wanted", "")]
    rows += [(b.what, b.found, b.wanted, "met" if b.met else "MISSED") for b in bars]
    widths = [max(len(row[i]) for row in rows) for i in range(4)]
    lines = [
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows
    ]
    return "\n".join([lines[0], "-" * (sum(widths) + 6), *lines[1:]])


def written(home: Path, runs: int, seconds: float) -> Path:
    """The file of a study."""
    file = home / f"{runs}.toml"
    file.write_text(STUDY.format(system=SYSTEM.resolve(), runs=runs, seconds=seconds), encoding="utf-8")
    return file


def measured(home: Path, runs: int, seconds: float) -> list[Bar]:
    """All studies, told as they end; the bars."""
    whole = timed(written(home, runs, seconds), home / "whole", 2)
    print(f"{runs} runs, two workers: {whole}, {whole.cpu / runs:.3f} s of processors per run", flush=True)
    half = written(home, runs // 2, seconds)
    two = timed(half, home / "two", 2)
    print(f"{runs // 2} runs, two workers: {two}", flush=True)
    one = timed(half, home / "one", 1)
    print(f"{runs // 2} runs, one worker:  {one}", flush=True)
    there = killed(half, home / "killed", runs // 2)
    print(f"{runs // 2} runs, two workers: killed when {there} were kept, started again\n", flush=True)
    limit, ratio = LIMIT * runs * seconds / (2000 * 10.0), one.wall / two.wall
    found = {
        "one and two workers": same(home / "two", home / "one"),
        "killed": same(home / "two", home / "killed"),
    }
    unlike = [name for name, equal in found.items() if not equal]
    return [
        Bar(f"{runs} runs of {seconds:g} s", f"{whole.wall:.1f} s", f"< {limit:g} s", whole.wall < limit),
        Bar("one worker over two", f"{ratio:.2f}", f">= {RATIO:g}", ratio >= RATIO),
        Bar(
            "content: one, two, killed",
            f"differs: {', '.join(unlike)}" if unlike else "equal",
            "equal",
            not unlike,
        ),
    ]


def main() -> int:
    """Run, tell, and judge."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=2000)
    parser.add_argument("--seconds", type=float, default=10.0)
    given = parser.parse_args()
    print(f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f} before", flush=True)
    with tempfile.TemporaryDirectory() as folder:
        bars = measured(Path(folder), given.runs, given.seconds)
    print(table(bars))
    return 0 if all(b.met for b in bars) else 1


if __name__ == "__main__":
    sys.exit(main())
