"""Sensitivity indices of a million runs: time, memory, and their difference from those of SALib alone.

`make bench-indices`: each method in a process of its own, for Sobol's function of 13 factors, whose indices
are known in closed form [Saltelli and Sobol' 1995, Reliability Engineering & System Safety 50, 225-239]. The
peak of the memory contains design, outputs and Python; `design` is the peak before the analysis. SALib's
`analyze` is called with the same columns and two resamples, for the time without intervals.
"""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys
import time
from collections.abc import Callable

import numpy as np
from SALib.analyze import morris, rbd_fast, sobol

from orchestrator.studies import design
from orchestrator.studies.analysis import sensitivity
from orchestrator.studies.analysis.results import FIRST, MU_STAR, TOTAL, OutputSamples, Sensitivity
from orchestrator.studies.study import Factor, Output, Study

FACTORS = 13
WEIGHT = np.arange(FACTORS, dtype=float)  # a of each factor: the larger, the smaller its effect
METHODS = {"saltelli": "Sobol'", "morris": "Morris", "latin": "RBD-FAST"}
Array = np.ndarray
Spent = tuple[float, float]  # s of the clock, s of the processor


def function(x: Array) -> Array:
    """Product of (|4 x_i - 2| + a_i) / (1 + a_i)."""
    y = np.ones(len(x))
    for column, a in zip(x.T, WEIGHT, strict=True):
        y *= (np.abs(4 * column - 2) + a) / (1 + a)
    return y


def closed_form() -> tuple[Array, Array]:
    """First-order and total indices."""
    own = 1 / (3 * (1 + WEIGHT) ** 2)
    whole = np.prod(1 + own)
    return own / (whole - 1), own * whole / (1 + own) / (whole - 1)


def samples(method: str, rows: int) -> OutputSamples:
    """The project's design with at most so many rows, and its outputs."""
    runs = {"saltelli": 2 ** int(np.log2(rows / (FACTORS + 2))), "morris": rows // (FACTORS + 1)}
    factors = tuple(
        Factor(f"x{i}", "uniform", {"minimum": 0.0, "maximum": 1.0}, unit="m") for i in range(FACTORS)
    )
    output = Output("y", "a.y", "final", 0.0, 1.0)
    space = {"factors": factors, "choices": (), "outputs": (output,)}
    study = Study("g", "none.ssp", method, runs.get(method, rows), 1, stop=1.0, **space)
    x = design.samples(study)
    return OutputSamples(factors, x, function(x)[:, None])


def timed(call: Callable[[], object]) -> tuple[object, Spent]:
    """What a call returns, and its time."""
    begin = time.perf_counter(), time.process_time()
    found = call()
    return found, (time.perf_counter() - begin[0], time.process_time() - begin[1])


def peak() -> float:
    """Largest memory of this process so far [MB]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3


def ours(method: str, data: OutputSamples) -> Sensitivity:
    """As `harvester sweep` does for a study without choices in which all runs succeeded."""
    if method == "saltelli":
        return sensitivity.sobol_indices(data, len(data.y) // (FACTORS + 2))
    found = (
        sensitivity.elementary_effects(data) if method == "morris" else sensitivity.from_sample(data, False)
    )
    assert not isinstance(found, str), found
    return found


def salib(method: str, data: OutputSamples) -> dict[str, Array]:
    """SALib's own indices by our names."""
    problem, y = design.problem(data.names), data.y[:, 0]
    settings = {"num_resamples": 2, "seed": 1}
    if method == "saltelli":
        found = sobol.analyze(problem, y, calc_second_order=False, **settings)
        return {FIRST: found["S1"], TOTAL: found["ST"]}
    if method == "morris":
        return {MU_STAR: morris.analyze(problem, data.x, y, **settings)["mu_star"]}
    return {FIRST: rbd_fast.analyze(problem, data.x, y, **settings)["S1"]}


def row(method: str, rows: int) -> str:
    """One line of the table."""
    data = samples(method, rows)
    before = peak()
    found, (wall, processor) = timed(lambda: ours(method, data))
    most = peak()
    theirs, (alone, _) = timed(lambda: salib(method, data))
    truth = dict(zip((FIRST, TOTAL), closed_form(), strict=True))
    by_name = {effect.name: effect for effect in found.effects}
    differences, errors = [], []
    for key, values in theirs.items():
        estimates = np.array([by_name[name].estimates[key].value for name in data.names])
        differences.append(np.max(np.abs(estimates - np.array(values, float))))
        errors.append(np.max(np.abs(estimates - truth[key])) if key in truth else np.nan)
    cells = f"{wall:>9.1f}{processor:>11.1f}{alone:>11.1f}{before:>9.0f}{most:>9.0f}"
    return f"{METHODS[method]:<10}{len(data.y):>9}{cells}{max(differences):>12.0e}{max(errors):>13.1e}"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rows", type=int, default=1_000_000)
    parser.add_argument("--method", choices=METHODS)
    options = parser.parse_args()
    if options.method:
        print(row(options.method, options.rows), flush=True)
        return
    print(f"{FACTORS} factors; time [s], memory [MB], largest difference of an index", flush=True)
    head = ("rows", "time"), ("processor", "SALib"), ("design", "peak"), ("from SALib", "from truth")
    widths = (9, 9, 11, 11, 9, 9, 12, 13)
    names = [name for pair in head for name in pair]
    print(" " * 10 + "".join(f"{n:>{w}}" for n, w in zip(names, widths, strict=True)), flush=True)
    for method in METHODS:
        command = [
            sys.executable,
            "-m",
            "benchmarks.indices",
            "--method",
            method,
            "--rows",
            str(options.rows),
        ]
        subprocess.run(command, check=True)


if __name__ == "__main__":
    main()
