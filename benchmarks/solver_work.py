"""What the solvers inside the FMUs do at some settings of the master, and how much of a run that takes.

    python -m benchmarks.solver_work [--stop 12]

For each setting build/harvester.ssp runs a few times, and once with FMUs whose C sources were compiled with
counters. The tables give numbers per simulated second:

    steps       communication steps of the component, those of further passes included
    inner       inner steps that its solver tried
    Jacobians   df/dx; LU: factorisations; solves: substitutions with one of them
    f           evaluations of the derivatives, without those inside a Jacobian
    ms          wall time inside the component [ms]; `all` has that of the whole loop, with the master
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Mapping
from pathlib import Path

from rich.console import Console
from rich.table import Table

from fmus.export.compile import HEADERS
from orchestrator import Coupling, Result, run

SYSTEM = Path("build/harvester.ssp")
RUNS = 7  # the least time of them counts
# label -> master, step [s], tolerance of the FMUs (None: their own, 1e-6)
SETTINGS: Mapping[str, tuple[Coupling, float, float | None]] = {
    "gauss-seidel, 1 ms": (Coupling("gauss-seidel"), 1e-3, None),
    "gauss-seidel order 3, 40/3 ms, FMUs at 1e-3": (Coupling("gauss-seidel", 3), 4e-2 / 3, 1e-3),
    "hermite, 2 passes, 20 ms, FMUs at 1e-3": (Coupling("hermite", passes=2), 2e-2, 1e-3),
}
COLUMNS = {
    "steps": ("fmi2DoStep",),
    "inner": ("rodas", "rodas3", "kutta", "cash_karp"),
    "Jacobians": ("model_jacobian",),
    "LU": ("model_factorise",),
    "solves": ("model_solve",),
    "f": ("model_dynamics", "model_derivatives"),
}


def simulate(system: Path, stop: float, label: str) -> Result:
    """One run in this process, with one signal recorded."""
    master, step, tolerance = SETTINGS[label]
    options = {"master": master, "step": step, "tolerance": tolerance, "stop": stop}
    return run(system, record=["manipulator.swing_speed"], isolate=False, **options)


def counting(system: Path, folder: Path) -> Path:
    """The system with FMUs that count."""
    out = folder / "counting.ssp"
    with zipfile.ZipFile(system) as archive, zipfile.ZipFile(out, "w") as copy:
        for name in archive.namelist():
            content = archive.read(name)
            copy.writestr(
                name, _counting(folder, Path(name).stem, content) if name.endswith(".fmu") else content
            )
    return out


def _counting(folder: Path, part: str, fmu: bytes) -> bytes:
    plain, counting = folder / f"{part}.fmu", folder / f"{part}_counting.fmu"
    plain.write_bytes(fmu)
    with zipfile.ZipFile(plain) as archive, zipfile.ZipFile(counting, "w") as copy:
        archive.extractall(folder / part)
        sources, library = folder / part / "sources", folder / "library"
        command = [sys.executable, "-m", "ziglang", "cc", "-O3", "-std=c99", "-D_POSIX_C_SOURCE=200809L"]
        command += ["-fPIC", "-shared", "-ffp-contract=off", "-fno-math-errno", "-fno-trapping-math"]
        command += ["-finstrument-functions", f'-DMODEL="{part}_fmu.c"', f'-DPART="{part}"', f"-I{HEADERS}"]
        command += [f"-I{sources}", str(Path(__file__).with_name("counts.c")), "-lm", "-o", str(library)]
        subprocess.run(command, check=True)
        for name in archive.namelist():
            copy.writestr(name, library.read_bytes() if name.startswith("binaries/") else archive.read(name))
    return counting.read_bytes()


def counted(system: Path, stop: float, label: str) -> dict[str, dict[str, int]]:
    """Component -> function -> calls, of one run in a process of its own."""
    with tempfile.TemporaryDirectory() as folder:
        code = f"from benchmarks.solver_work import *; simulate(Path({str(system)!r}), {stop}, {label!r})"
        subprocess.run([sys.executable, "-c", code], env={**os.environ, "COUNTS": folder}, check=True)
        tables = {file.name: file.read_text(encoding="utf-8").split() for file in Path(folder).iterdir()}
    return {part: dict(zip(w[::2], map(int, w[1::2]), strict=True)) for part, w in tables.items()}


def main() -> None:
    """Print a table for each setting."""
    described = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=described)
    parser.add_argument("--stop", type=float, default=12.0, help="[s] of the work cycle")
    stop = parser.parse_args().stop
    with tempfile.TemporaryDirectory() as folder:
        system = counting(SYSTEM, Path(folder))
        for label in SETTINGS:
            calls = counted(system, stop, label)
            ends = [simulate(SYSTEM, stop, label).card for _ in range(RUNS)]
            table = Table("component", *COLUMNS, "ms", title=label, title_justify="left")
            for part, numbers in sorted(calls.items()):
                cells = (sum(numbers[name] for name in names) / stop for names in COLUMNS.values())
                inside = min(end.inside[part] for end in ends)
                table.add_row(part, *(f"{cell:.1f}" for cell in cells), f"{1e3 * inside / stop:.4f}")
            table.add_row("all", *[""] * len(COLUMNS), f"{1e3 * min(e.wall for e in ends) / stop:.4f}")
            Console().print(table)


if __name__ == "__main__":
    main()
