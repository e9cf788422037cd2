"""Derivatives of the machine's outputs by parameters: exact ones, and differences between runs of its FMU.

`make bench-sensitivities`: a minute of the work cycle at 200 Hz with a measured supply pressure. Times are
processor time in runs of the FMU at its usual tolerance, without derivatives. The exact ones come with those
by the states at the start, which an FMU cannot be asked for.

The reference are exact ones at a tolerance of 1e-11, which the tests compare with CVODES. The error of a
parameter is the RMS over samples and outputs, each output over its range, in relation to the RMS of the
reference. Of differences the change with the smallest error counts, which a user does not know.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.played import Fmu
from fmus.identification.refinement.compiled_model import CompiledModel
from fmus.machine.one_block import HARVESTER
from fmus.operator_input.work_cycle import COMMANDS, WORK_CYCLE, WORK_CYCLE_STOP, sample
from fmus.parameters import values

FREE = (
    *("valve_area", "valve_dead_band", "motor_displacement", "bulk_modulus"),
    *("internal_leakage_resistance", "external_leakage_resistance"),
    *("line_capacitance", "line_resistance", "line_inertance"),
    *(
        f"{axis}_hose_{kind}"
        for axis in ("boom", "stick")
        for kind in ("capacitance", "resistance", "inertance")
    ),
    *("swing_damping", "boom_joint_damping", "stick_joint_damping"),
)
OUTPUTS = (
    *("swing_pressure_a", "swing_pressure_b"),
    *(f"{axis}_{side}_pressure" for axis in ("boom", "stick") for side in ("head", "rod")),
    *("swing_angle", "boom_angle", "stick_angle", "swing_flow_a", "boom_head_flow", "stick_head_flow"),
)
STOP, NOISE = 60.0, 1e4  # s; Pa, of the pressure sensor
REPEATS = 5
PERTURBATIONS = tuple(10.0**-n for n in range(2, 8))
Array = np.ndarray


def recorded(names: tuple[str, ...]) -> tuple[Array, Array]:
    """Time and inputs: the work cycle, begun again when it is over, and the noise of the pressure sensor."""
    again = [replace(move, start=move.start + WORK_CYCLE_STOP) for move in WORK_CYCLE]
    grid, commands = sample([*WORK_CYCLE, *(m for m in again if m.start < STOP - 5)], STOP)
    given = values(HARVESTER).u
    u = np.tile([given[name] for name in names], (grid.size, 1))
    u[:, [names.index(name) for name in COMMANDS]] = commands
    u[:, names.index("supply_pressure")] += NOISE * np.random.default_rng(6).standard_normal(grid.size)
    return grid, u


def exact(model: CompiledModel, grid: Array, u: Array) -> Array:
    """Derivatives with what the parameters do at the start, shape (n, ny, np)."""
    x0, start = model.start(model.p0, u[0])
    piece = model.segment(x0, model.p0, grid, u)
    return piece.y_p + piece.y_x @ start


def differences(fmu: Fmu, p: Array, tolerance: float, size: float, central: bool) -> Array:
    """The same from runs of the FMU with one parameter changed by a share `size` of it."""
    base = None if central else fmu(p, tolerance)
    columns = []
    for j in range(p.size):
        step = size * p[j] * np.eye(p.size)[j]
        below = fmu(p - step, tolerance) if base is None else base
        columns.append((fmu(p + step, tolerance) - below) / (size * p[j] * (2 if central else 1)))
    return np.stack(columns, axis=2)


def seconds(call: Callable[[], object]) -> float:
    """Processor time of the fastest of some calls."""
    spent = []
    for _ in range(REPEATS):
        begin = time.process_time()
        call()
        spent.append(time.process_time() - begin)
    return min(spent)


def main() -> None:
    """Print the table."""
    begin = time.perf_counter()
    model = CompiledModel(HARVESTER, OUTPUTS, FREE)
    ready = time.perf_counter() - begin
    grid, u = recorded(model.inputs)
    p = model.p0
    x0, _ = model.start(p, u[0])
    tight = CompiledModel(HARVESTER, OUTPUTS, FREE, tolerance=1e-11)
    reference = exact(tight, grid, u)
    span = np.ptp(model.segment(x0, p, grid, u, False).y, axis=0)[:, None]

    def errors(found: Array) -> Array:
        size = np.sqrt(np.mean((reference / span) ** 2, axis=(0, 1)))
        return np.sqrt(np.mean(((found - reference) / span) ** 2, axis=(0, 1))) / size

    with tempfile.TemporaryDirectory() as folder:
        fmu = Fmu(Path(folder), (model.inputs, FREE, OUTPUTS), grid, u)
        unit = seconds(lambda: fmu(p, 1e-6))
        same = np.abs(fmu(p, 1e-6) - model.segment(x0, p, grid, u, False).y).max(axis=0) / span[:, 0]
        print(
            f"{grid.size} samples, {len(OUTPUTS)} outputs, {len(FREE)} parameters, {len(model.states)} states"
        )
        print(f"model ready in {ready:.1f} s; outputs of FMU and model differ by {same.max():.0e} of range")
        print(f"a run of the FMU: {unit:.3f} s\n")
        print(f"{'':<22}{'tolerance':>10}{'change':>8}{'columns':>9}{'time':>8}{'worst':>10}{'median':>10}")

        def row(
            name: str, tolerance: float, columns: int, spent: float, error: Array | None, change: str = ""
        ) -> None:
            told = "" if error is None else f"{error.max():>10.0e}{np.median(error):>10.0e}"
            cells = f"{tolerance:>10.0e}{change:>8}{columns:>9}{spent / unit:>8.1f}"
            print(f"{name:<22}{cells}{told}", flush=True)

        for tolerance in (1e-6, 1e-7, 1e-8):
            own = CompiledModel(HARVESTER, OUTPUTS, FREE, tolerance=tolerance)
            bare = seconds(lambda own=own: own.segment(x0, p, grid, u, False))
            row("no derivatives", tolerance, 0, bare, None)
            spent = seconds(lambda own=own: own.segment(x0, p, grid, u))
            row("exact", tolerance, len(FREE) + len(model.states), spent, errors(exact(own, grid, u)))
        for tolerance in (1e-6, 1e-8):
            run = seconds(lambda tolerance=tolerance: fmu(p, tolerance))
            for central in (False, True):
                tried = {s: errors(differences(fmu, p, tolerance, s, central)) for s in PERTURBATIONS}
                best = min(tried, key=lambda s: np.median(tried[s]))
                runs = 2 * len(FREE) if central else 1 + len(FREE)
                name = "central differences" if central else "forward differences"
                row(name, tolerance, len(FREE), runs * run, tried[best], f"{best:.0e}")


if __name__ == "__main__":
    main()
