"""FMUs of other people in `run` and in FMPy, at the same step.

    python -m benchmarks.foreign FOLDER ... [--tolerance TOL]

Each FMU in the folders is simulated by FMPy (Co-Simulation) and by `run`: from its own start to its own stop
time (1 s if it has none), at most STEPS steps, at the step that `run` chooses, with the start values and the
tolerance of its DefaultExperiment. `--tolerance` is for `run` only, to see what another one changes. Equal
files are simulated once. A row of the table has

    FMU          its path, shortened; FMI: version; tool: that generated it
    result       equal: no output differs by more than EQUAL of its range; differs; not run
    difference   the largest, over the range of the output (at least 1e-3 of its magnitude), and the output
    reason       why it was not run or differs

If a run ends early, the rows until then are compared, and FMPy must end there too, or go on without a finite
value. Exit status 1: an FMU differs.
"""

from __future__ import annotations

import hashlib
import subprocess
import sys
import tempfile
from argparse import ArgumentParser
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from orchestrator import Problem, load
from orchestrator.base.text import TextTable
from orchestrator.data.trace import Trace
from orchestrator.engine.run import attempt
from orchestrator.engine.time_grid import step_length
from orchestrator.ssp.system import Component

STEPS = 20_000
DEFAULT_STOP = 1.0  # s
EQUAL = 1e-6  # of the range of an output
TIME = 120.0  # s of wall time for each side
FMPY = """
import fmpy.fmi2, fmpy.fmi3, math, numpy, sys
fmu, start, stop, step, file, *outputs = sys.argv[1:]

def with_equal_steps(do_step):
    def call(self, currentCommunicationPoint, communicationStepSize, **others):
        size = communicationStepSize
        size = float(step) if math.isclose(size, float(step), rel_tol=1e-6) else size
        return do_step(self, currentCommunicationPoint, size, **others)
    return call

for slave in (fmpy.fmi2.FMU2Slave, fmpy.fmi3.FMU3Slave):
    slave.doStep = with_equal_steps(slave.doStep)
times = dict(start_time=float(start), stop_time=float(stop), output_interval=float(step))
numpy.save(file, fmpy.simulate_fmu(fmu, False, fmi_type="CoSimulation", output=outputs, **times))
"""


@dataclass(frozen=True)
class Row:
    """A line of the table."""

    name: str
    fmi: str
    tool: str
    result: str = "not run"
    difference: str = ""
    reason: str = ""


def fmus(folders: Sequence[Path]) -> Iterator[Path]:
    """The FMUs in the folders, equal files once."""
    seen = set[str]()
    for folder in folders:
        for path in sorted(folder.rglob("*.fmu")) if folder.is_dir() else [folder]:
            digest = hashlib.sha256(path.read_bytes()).hexdigest()
            if digest not in seen:
                seen.add(digest)
                yield path


def by_fmpy(fmu: Path, start: float, stop: float, step: float, outputs: Sequence[str]) -> Trace:
    """The result of FMPy, in a process of its own; raises Problem if it fails."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "result.npy"
        arguments = [str(a) for a in (fmu, repr(start), repr(stop), repr(step), file, *outputs)]
        try:
            done = subprocess.run(
                [sys.executable, "-c", FMPY, *arguments], capture_output=True, timeout=TIME, check=False
            )
        except subprocess.TimeoutExpired:
            raise Problem(f"FMPy: more than {TIME:g} s") from None
        if done.returncode:
            lines = done.stderr.decode(errors="replace").strip().splitlines()
            raise Problem(f"FMPy: {lines[-1] if lines else f'exit status {done.returncode}'}")
        found = np.load(file)
    return Trace(found["time"], {name: np.asarray(found[name], float) for name in found.dtype.names[1:]})


def by_run(
    component: Component, start: float, stop: float, step: float, tolerance: float | None
) -> tuple[Trace, str]:
    """The result of `run`, and why it ended early; raises Problem if it did not begin."""
    fmu = component.source
    assert fmu is not None
    times = {"start": start, "stop": stop, "step": step}
    result, failure = attempt(fmu.path, tolerance=tolerance, time_limit=TIME, **times)
    return result.trace, failure


def compared(ours: Trace, other: Trace, component: str, early: str) -> tuple[str, str, str]:
    """Result, difference and reason of a row."""
    rows, others = len(ours.time), len(other.time)
    beyond = [values[rows:] for values in other.signals.values()]
    if early and others > rows and not all(np.isfinite(values).all() for values in beyond):
        others = rows
    if rows != others or not np.allclose(ours.time, other.time[:rows], rtol=1e-9, atol=1e-9):
        times = f"{rows} rows to {ours.time[-1]:g} s, FMPy {others} to {other.time[-1]:g} s"
        return "differs", "", f"{times}; {early}" if early else times
    worst, name = 0.0, ""
    for signal, truth in other.signals.items():
        values = truth[:rows]
        span = max(float(np.ptp(values)), 1e-3 * float(np.abs(values).max()), 1e-300)
        change = float(np.abs(ours[f"{component}.{signal}"] - values).max()) / span
        worst, name = max((worst, name), (change, signal))
    return (
        "equal" if worst <= EQUAL else "differs",
        f"{worst:.1e} {name}",
        f"until both fail: {early}" if early else "",
    )


def simulated(path: Path, name: str, tolerance: float | None) -> Row:
    """Simulate an FMU on both sides."""
    from fmpy import read_model_description

    try:
        described = read_model_description(str(path), validate=False)
        row = Row(name, described.fmiVersion, described.generationTool or "?")
    except Exception as error:
        row = Row(name, "?", "?", reason=str(error).splitlines()[0])
    try:
        system = load(path)
        (component,) = system.components.values()
        face, step = component.interface, step_length(system, None)
        start = face.start or 0.0
        stop = min(start + DEFAULT_STOP if face.stop is None else face.stop, start + STEPS * step)
        outputs = [v.name for v in face.of("output") if v.kind != "String"]
        ours, early = by_run(component, start, stop, step, tolerance)
        other = by_fmpy(path, start, stop, step, outputs)
    except Problem as problem:
        return Row(row.name, row.fmi, row.tool, reason=str(problem).removeprefix(f"{path}: "))
    return Row(row.name, row.fmi, row.tool, *compared(ours, other, component.name, early))


def main() -> int:
    """Print the table."""
    parser = ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folders", nargs="+", type=Path)
    parser.add_argument("--tolerance", type=float)
    given, rows = parser.parse_args(), list[Row]()
    for path in fmus(given.folders):
        rows.append(simulated(path, "/".join(path.parts[-3:]), given.tolerance))
        print(f"{rows[-1].name}: {rows[-1].result} {rows[-1].difference}", file=sys.stderr, flush=True)
    table = [[r.name, r.fmi, r.tool, r.result, r.difference, r.reason] for r in rows]
    print("\n".join(TextTable(["FMU", "FMI", "tool", "result", "difference", "reason"], table).lines()))
    print(", ".join(f"{count} {result}" for result, count in Counter(r.result for r in rows).items()))
    return int(any(r.result == "differs" for r in rows))


if __name__ == "__main__":
    sys.exit(main())
