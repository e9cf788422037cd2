"""What a run costs besides its steps: processor time before the first step, of files, of a report.

    python -m benchmarks.costs [--against FOLDER] [--repeats 5] [--fmus 400]

    prepared run       `run` of one step of a loaded system, with all before and after it: in a process of its
                       own, and in the calling one
    command run        `harvester run` for 10 ms: imports, system, FMUs, trace and metadata
    command validate   `harvester validate`, and as a multiple of the time inside the FMUs
    many FMUs          a chain of 400 FMUs from the path of the SSP to the end of its first step

Processor time of a process and all that it starts, the least of some repetitions. With --against, each is
measured in turn with this checkout and another one, FOLDER, and the ratio of both is printed: that depends
little on other load. The system is build/harvester.ssp.
"""

from __future__ import annotations

import argparse
import os
import re
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

from benchmarks.peers.many import chain

ROOT = Path(__file__).parents[1]
PREPARED = """
from orchestrator import load, run
system = load({system!r})
for _ in range({runs}):
    run(system, step=1e-3, stop=1e-3, isolate={isolate})
"""
MANY = """
from orchestrator import load, run
run(load({system!r}), step=1e-3, stop=1e-3, master="jacobi", record=["mass_1.x"], isolate=False)
"""
IMPORTED = "import orchestrator.engine.run, orchestrator.engine.simulation_loop, orchestrator.ssp.load"
WARM, RUNS = 3, 43  # runs of a process; the costs of one are in their difference


def spent(code: Path, arguments: list[str]) -> tuple[float, str]:
    """Processor time [s] of a Python program and its children, with a checkout, and what it prints."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    environment = {**os.environ, "PYTHONPATH": str(code)}
    done = subprocess.run(
        [sys.executable, "-P", *arguments], env=environment, check=True, capture_output=True, text=True
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, done.stdout


def cases(system: Path, many: Path, folder: Path) -> dict[str, tuple[list[str], list[str], int]]:
    """Label -> arguments of a program, those of one whose time is no part of it, number of runs."""
    result: dict[str, tuple[list[str], list[str], int]] = {}
    for label, isolate in (("isolated", True), ("in process", False)):
        programs = (
            ["-c", PREPARED.format(system=str(system), runs=runs, isolate=isolate)] for runs in (RUNS, WARM)
        )
        result[f"prepared run, {label}"] = *programs, RUNS - WARM
    out = ["--out", str(folder / "out" / "trace.csv")]
    command, nothing = ["-m", "orchestrator"], ["-c", ""]
    result["command run"] = [*command, "run", str(system), "--stop", "10ms", *out], nothing, 1
    result["command validate"] = [*command, "validate", str(system), "--out", str(folder)], nothing, 1
    result["many FMUs"] = ["-c", MANY.format(system=str(many))], ["-c", IMPORTED], 1
    return result


def main() -> None:
    """Print a row per case."""
    described = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser("benchmarks.costs", description=__doc__, formatter_class=described)
    parser.add_argument("--against", type=Path, help="another checkout")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--fmus", type=int, default=400)
    parser.add_argument("--system", type=Path, default=Path("build/harvester.ssp"))
    asked = parser.parse_args()
    codes = [ROOT, *([asked.against.resolve()] if asked.against else [])]
    print(f"{'processor time':<26}{'here [s]':>10}" + f"{'there [s]':>11}{'ratio':>8}" * (len(codes) > 1))
    with tempfile.TemporaryDirectory() as name:
        many = chain(Path(name), asked.fmus)
        for label, (whole, part, runs) in cases(asked.system.resolve(), many, Path(name)).items():
            times: dict[Path, list[tuple[float, float]]] = {code: [] for code in codes}
            inside = 0.0
            for _ in range(asked.repeats):
                for code, found in times.items():
                    time, text = spent(code, whole)
                    found.append((time, spent(code, part)[0]))
                    if told := re.search(r"inside the FMUs ([\d.]+) s", text):
                        inside = float(told[1])
            costs = [(min(w for w, _ in found) - min(p for _, p in found)) / runs for found in times.values()]
            row = f"{label:<26}{costs[0]:>10.4f}" + "".join(
                f"{cost:>11.4f}{costs[0] / cost:>8.2f}" for cost in costs[1:]
            )
            multiple = label == "command validate" and inside
            print(row + (f"   {costs[0] / inside:.1f} times the FMUs" if multiple else ""), flush=True)


if __name__ == "__main__":
    main()
