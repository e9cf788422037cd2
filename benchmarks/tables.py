"""Benchmark of large studies: writing their tables, and analysing them in little memory.

    python -m benchmarks.tables [--runs 20000] [--method latin] [--folder DIR]
    python -m benchmarks.tables --runs 1000000

A study of build/harvester.ssp with 20 factors, whose table has 500 columns: factors, start values and 42
outputs. Nothing is simulated: the outputs are smooth functions of the factors with noise. They go through the
store of `harvester sweep`, in batches, then a process of its own reads the folder, analyses some outputs and
writes the page. Prints the rate of writing, the size of the folder, the time and the largest memory of both
processes.

Limit: MEMORY [GB] of the process that analyses. Exit status 1 if it is missed.
"""

from __future__ import annotations

import argparse
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from orchestrator.studies import Factor, Output, Study, read_results, store, study_page
from orchestrator.studies.runs import RunOutcome, prepare

SYSTEM = Path("build/harvester.ssp")
COLUMNS, FACTORS, BATCH = 500, 20, 500
MEMORY = 2.0  # [GB], bar of the analysis


def study(runs: int, method: str, outputs: int) -> Study:
    """The study; runs: of the table, which a Saltelli design has from fewer base samples."""
    from orchestrator import load

    operator = load(SYSTEM).components["operator_input"]
    names = [
        f"operator_input.{name}"
        for name, variable in operator.interface.variables.items()
        if variable.causality == "parameter" and variable.is_real and operator.value(name) > 0.0
    ]
    scale = {"minimum": 0.99, "maximum": 1.0}
    factors = [Factor(name, "uniform", scale, relative=True) for name in names[:FACTORS]]
    made = [Output(f"y{i}", "swing.swing_pressure_a", "maximum", start=0.001 * i) for i in range(outputs)]
    base = runs // (FACTORS + 2) if method == "saltelli" else runs
    samples = 1 << base.bit_length() - 1 if method in ("saltelli", "sobol") else base
    return Study("Tables", str(SYSTEM), method, samples, stop=1.0, factors=factors, outputs=made)  # type: ignore[arg-type]


def write(folder: Path, runs: int, method: str) -> None:
    """A finished study, by the store; what is printed."""
    start, spare = time.perf_counter(), prepare(study(1, "latin", 1))
    own = store.design.starts(spare.study, spare.cases, spare.samples)[0]
    fixed = len(store.RESULT) + FACTORS + len(own)
    prepared = prepare(study(runs, method, COLUMNS - fixed))
    count, outputs = len(prepared.samples), len(prepared.study.outputs)
    told(f"{count} runs, {fixed + outputs} columns, {outputs} of them outputs: samples", start)
    start, rng = time.perf_counter(), np.random.default_rng(1)
    weights = rng.random((FACTORS, outputs)) ** 4
    folder.mkdir(parents=True, exist_ok=True)
    results, table = store.Store(folder, prepared), prepared.table.to_numpy()
    told("folder", start)
    start = time.perf_counter()
    for first in range(0, count, BATCH):
        x = 100.0 * (table[first : first + BATCH] - 0.99)
        y = 1e7 * (x @ weights + np.sin(3 * x[:, :1]) * x[:, 1:2] + 0.1 * rng.random((len(x), outputs)))
        batch = [RunOutcome(first + i, "ok", "", values, energy_error=1e-4) for i, values in enumerate(y)]
        results.add(batch)
    results.finish()
    took = time.perf_counter() - start
    files = [*folder.glob("*.parquet/*")]
    size = sum(file.stat().st_size for file in files)
    told(f"written: {count / took:.0f} runs/s, {size / 1e9:.2f} GB in {len(files)} files", start)


def analyse(folder: Path, outputs: int) -> None:
    """Analyse the first outputs and write the page."""
    start, results = time.perf_counter(), read_results(folder)
    study = replace(results.study, outputs=results.study.outputs[:outputs])
    results = store.Results(study, vars(results)["table"], None, results.units)  # `replace` reads the table
    page = study_page.write(folder, results)
    told(f"analysed, page of {(folder / study_page.PAGE).stat().st_size / 1e6:.1f} MB", start)
    sys.stdout.write("\n".join(page.text().splitlines()[:6]) + "\n")


def told(what: str, start: float) -> None:
    """Print what was done, with its time and the largest memory of this process."""
    sys.stdout.write(f"{what}, {time.perf_counter() - start:.1f} s, at most {peak():.2f} GB\n")
    sys.stdout.flush()


def peak(who: int = resource.RUSAGE_SELF) -> float:
    """Largest memory of this process, or of one that has ended [GB]."""
    return resource.getrusage(who).ru_maxrss * 1024 / 1e9


def main() -> bool:
    """Write and analyse, each in a process of its own; True if the limit holds."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--runs", type=int, default=20_000)
    parser.add_argument("--method", default="latin", choices=("latin", "sobol", "saltelli", "morris"))
    parser.add_argument("--folder", type=Path, help="of the study, which stays; an earlier one is analysed")
    parser.add_argument("--outputs", type=int, default=3, help="that are analysed")
    parser.add_argument("--step", choices=("write", "analyse"), help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.step:
        write(given.folder, given.runs, given.method) if given.step == "write" else analyse(
            given.folder, given.outputs
        )
        return True
    folder = given.folder or Path(tempfile.mkdtemp(prefix="tables-"))
    command = [sys.executable, "-m", "benchmarks.tables", "--runs", str(given.runs), "--method", given.method]
    command += ["--outputs", str(given.outputs)]
    try:
        if not store.finished(folder):
            subprocess.run([*command, "--folder", str(folder), "--step", "write"], check=True)
        subprocess.run([*command, "--folder", str(folder), "--step", "analyse"], check=True)
    finally:
        if not given.folder:
            shutil.rmtree(folder)
    print(f"memory: {peak(resource.RUSAGE_CHILDREN):.2f} GB, bar {MEMORY:g} GB")
    return peak(resource.RUSAGE_CHILDREN) <= MEMORY


if __name__ == "__main__":
    raise SystemExit(not main())
