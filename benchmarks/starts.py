"""From which starts does the joint refinement converge, and how long does it take?

    python -m benchmarks.starts [--starts 8] [--seconds 30]

The same recording of the lumped rig and the same starts, drawn about the truth with a standard deviation of
30 % for each parameter, by two routes:

    exact         multiple shooting, exact sensitivities of the compiled model: the default
    differences   single shooting, forward differences between runs of the native harvester.fmu, whose
                  states cannot be set

Without priors on the parameters, so that only the recording can lead back. A search has converged when it
ends within one standard deviation of the best end of its route.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.black_box import BlackBox
from benchmarks.played import Fmu
from fmus.identification.machine import FREE, nominal, problem
from fmus.identification.recordings.reading import read
from fmus.identification.refinement.compiled_model import CompiledModel, SimulationFailed
from fmus.identification.refinement.problem import EstimationProblem
from fmus.identification.refinement.refine import (
    RefinementResult,
    compiled,
    refine,
)
from fmus.rig.experiments import experiment
from fmus.rig.recordings import write
from orchestrator.base.errors import Problem

AWAY = 0.3  # standard deviation of a start, relative
CHANGE = 1e-4  # relative, of the differences: the best one of benchmarks.sensitivities
TOLERANCE = 1e-6  # of the FMU's solver, its usual one
JOINTS = ("swing", "boom", "stick")


def task(folder: Path, seconds: float) -> EstimationProblem:
    """The first training recording against the machine; nothing is known but the recording."""
    csv, _ = write(folder, experiment("machine_train_1", "lumped"), 0)
    whole = problem([read(csv).window(0.0, seconds)], nominal(), FREE)
    return replace(whole, free=tuple(replace(f, sd=None) for f in whole.free))


class Played:
    """Whole runs of harvester.fmu from the pose of the recording."""

    def __init__(
        self, folder: Path, given: EstimationProblem, inputs: tuple[str, ...], u: np.ndarray
    ) -> None:
        run = given.training[0]
        pose = {f"initial_{j}_angle": float(np.mean(run.measured_states[f"{j}_angle"][:100])) for j in JOINTS}
        names = (inputs, (*given.names, *pose), given.outputs)
        self.pose, self.fmu = np.array(list(pose.values())), Fmu(folder, names, run.time, u)

    def __call__(self, p: np.ndarray, *_: np.ndarray) -> np.ndarray:
        """Outputs at the samples."""
        try:
            return self.fmu(np.concatenate([p, self.pose]), TOLERANCE)
        except RuntimeError:
            raise SimulationFailed("the FMU failed", 0.0) from None


def main() -> None:
    """Print a row per start and route, then the sums."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--starts", type=int, default=8)
    parser.add_argument("--seconds", type=float, default=30.0)
    chosen = parser.parse_args()
    random = np.random.default_rng(0)
    with tempfile.TemporaryDirectory() as name:
        given = task(Path(name), chosen.seconds)
        model = compiled(given)
        u = np.column_stack([given.training[0].inputs[n] for n in model.inputs])
        played = Played(Path(name), given, model.inputs, u)
        box = BlackBox(played, model.inputs, given.outputs, given.names, model.p0, CHANGE)
        routes = {"exact": model, "differences": box}
        low, high = given.bounds()
        starts = [given.initial() + AWAY * random.standard_normal(len(FREE)) for _ in range(chosen.starts)]
        print(f"{len(FREE)} parameters, {len(given.outputs)} outputs, {chosen.seconds:g} s at 200 Hz\n")
        print(f"{'start':>5}  {'route':<12}{'iterations':>11}{'time':>9}{'residual':>10}  end")
        found: dict[str, list[tuple[RefinementResult | None, float]]] = {route: [] for route in routes}
        for k, z in enumerate(starts):
            for route, simulator in routes.items():
                begun = time.perf_counter()
                one = _search(given, simulator, np.clip(z, low, high))
                found[route].append((one, time.perf_counter() - begun))
                print(f"{k:>5}  {route:<12}{_row(*found[route][-1])}", flush=True)
        print()
        for route, ends in found.items():
            print(f"{route}: {_sum(ends)}")


def _row(one: RefinementResult | None, spent: float) -> str:
    if one is None:
        return f"{'':>11}{spent:>8.1f}s{'':>10}  cannot be simulated from there"
    return f"{len(one.history):>11}{spent:>8.1f}s{one.history[-1].residual:>10.4g}  {one.reason}"


def _sum(ends: list[tuple[RefinementResult | None, float]]) -> str:
    """How many reached the best end of the route, how long that took, how far that end is from the truth."""
    known = [(one, spent) for one, spent in ends if one is not None]
    if not known:
        return f"0 of {len(ends)} starts converged"
    best = min((one for one, _ in known), key=lambda one: one.history[-1].residual)
    sd = best.statistics.sd(best.robust)
    good = [spent for one, spent in known if np.max(np.abs(one.z - best.z) / sd) < 1]
    off = np.abs(best.z - best.problem.initial()) / sd
    told = f"{len(good)} of {len(ends)} starts converged, {np.mean(good):.1f} s each"
    return f"{told}; truth within 1.96 standard deviations in {np.sum(off < 1.96)} of {off.size} parameters"


def _search(
    given: EstimationProblem, simulator: CompiledModel | BlackBox, z: np.ndarray
) -> RefinementResult | None:
    try:
        if isinstance(simulator, BlackBox):
            return refine(given, simulator, segment=np.inf, horizon=np.inf, start=z)
        return refine(given, simulator, start=z)
    except Problem:
        return None  # it cannot be simulated from there


if __name__ == "__main__":
    main()
