"""Chains of equal FMUs in one system: set-up, and the time of a step for each of them.

    python -m benchmarks.peers.many [--count 10 50 200 400] [--repeats 3]

The FMU is the first mass of `oscillator.py`; the position of each pulls the next one. Jacobi, 10 000
steps of 1 ms, one signal recorded. Each run is a process of its own, in turn; `set-up` is from the path of
the SSP to the first step, `both` with all steps: medians of the wall time, and of the processor time.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from itertools import pairwise
from pathlib import Path
from statistics import median

from rich.console import Console
from rich.progress import track
from rich.table import Table

from benchmarks.peers.oscillator import fmu
from benchmarks.peers.tools import Spent, find, left_out
from orchestrator.ssp.load import assemble
from orchestrator.ssp.write import write_ssp

STEP, STEPS = 1e-3, 10_000
# label -> tool, options
TOOLS = {
    "Ecos": ("ecos", {}),
    "Ecos, one thread": ("ecos", {"threads": 1}),
    "libcosim, no worker": ("libcosim", {"workers": 0}),
    "ours": ("ours", {"master": "jacobi"}),
    "ours, isolated": ("ours", {"master": "jacobi", "isolate": True}),
}


def chain(folder: Path, count: int) -> Path:
    """The system."""
    mass = fmu(folder, "mass_a")
    names = [f"mass_{i}" for i in range(count)]
    wires = [f"{a}.x -> {b}.x2" for a, b in pairwise(names)]
    system = assemble(dict.fromkeys(names, mass), wires, name="chain", stop=STEP * STEPS, step=STEP)
    return write_ssp(system, folder / f"chain_{count}.ssp")


def once(label: str, system: Path) -> dict[str, list[float]]:
    """Wall and processor time [s] of set-up and of both, in this process, without the imports of Python."""
    tool, options = TOOLS[label]
    run, signal = find(tool), "mass_1.x"
    begin = Spent.until_now()
    done = run(system, STEP * STEPS, [signal], [signal], step=STEP, **options)
    both = Spent.until_now() - begin
    setup = both - done.spent
    return {"setup": [setup.wall, setup.cpu], "both": [both.wall, both.cpu], "steps": [done.steps]}


def main() -> None:
    """Print a table for each number of FMUs."""
    described = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=described)
    parser.add_argument("--count", type=int, nargs="+", default=[10, 50, 200, 400], help="FMUs")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--once", nargs=2, metavar=("TOOL", "SSP"), help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.once:
        print(json.dumps(once(asked.once[0], Path(asked.once[1]))))
        return
    console = Console(highlight=False)
    labels = list(TOOLS)
    for tool in dict.fromkeys(tool for tool, _ in TOOLS.values()):
        try:
            find(tool)
        except (ImportError, OSError) as reason:
            console.print(left_out(tool, reason))
            labels = [label for label in labels if TOOLS[label][0] != tool]
    columns = "", "set-up [s]", "both [s]", "CPU of both [s]", "us per step and FMU"
    for count in asked.count:
        table = Table(*columns, title=f"{count} FMUs")
        with tempfile.TemporaryDirectory() as folder:
            system = chain(Path(folder), count)
            found = {label: list[dict[str, list[float]]]() for label in labels}
            for _ in track(range(asked.repeats), f"{count} FMUs", console=console, transient=True):
                for label in labels:
                    command = [sys.executable, "-m", "benchmarks.peers.many", "--once", label, str(system)]
                    told = subprocess.run(command, capture_output=True, text=True, check=False)
                    if told.returncode:
                        console.print(f"{label}: {told.stderr.strip().splitlines()[-1]}")
                    else:
                        found[label].append(json.loads(told.stdout.splitlines()[-1]))
        for label, runs in found.items():
            if not runs:
                continue
            setup, both = (median(r[k][0] for r in runs) for k in ("setup", "both"))
            cpu = median(r["both"][1] for r in runs)
            step = median((r["both"][0] - r["setup"][0]) / r["steps"][0] for r in runs) / count * 1e6
            table.add_row(label, f"{setup:.3f}", f"{both:.3f}", f"{cpu:.3f}", f"{step:.3f}")
        console.print(table)


if __name__ == "__main__":
    main()
