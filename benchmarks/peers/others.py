"""Two systems of FMUs that other people made, as they offer them for download.

    quarter truck   chassis, wheel and ground by 20-sim, the example of the Open Simulation Platform. From the
                    repository Ecos-platform/ecos: data/ssp/1.0/quarter_truck/quarter-truck.ssp
    DC motor        stimuli, machine and mass by Dymola, an example of OMSimulator. From the repository
                    OpenModelica/OMSimulator: testsuite/tests/resources/dcmotor/resources/*.fmu

The FMUs of the truck contain C code, and binaries for Windows only, so they are compiled here. They hold
their inputs, declare no dependencies and integrate by RK4 at 1 ms or less. Those of the motor contain CVODE.
"""

from __future__ import annotations

import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
from scipy.linalg import expm

from fmus.export.compile import PLATFORMS, host
from orchestrator.ssp.load import assemble
from orchestrator.ssp.write import write_ssp

TRUCK = "quarter-truck.ssp"
TRUCK_WIRES = (
    ("chassis.p.e", "wheel.p1.e"),
    ("wheel.p1.f", "chassis.p.f"),
    ("wheel.p.e", "ground.p.e"),
    ("ground.p.f", "wheel.p.f"),
)
MOTOR = {"stimuli": "stimuli_model", "machine": "emachine_model", "mass": "edrive_mass"}
MOTOR_WIRES = (
    ("stimuli.U", "machine.U"),
    ("stimuli.M_load", "mass.M_B"),
    ("machine.M", "mass.M_A"),
    ("mass.wA", "machine.w"),
    ("mass.phiA", "machine.phi"),
)


def truck(source: Path, folder: Path) -> Path:
    """Write the system of the quarter truck, with binaries for this computer, to `folder`."""
    with zipfile.ZipFile(source) as archive:
        fmus = {n: _compiled(archive, n, folder) for n in ("chassis", "wheel", "ground")}
    return write_ssp(assemble(fmus, TRUCK_WIRES, stop=3.0, step=1e-3), folder / "truck.ssp")


def motor(source: Path, folder: Path) -> Path:
    """Write the system of the DC motor to `folder`."""
    fmus = {component: source / f"{name}.fmu" for component, name in MOTOR.items()}
    return write_ssp(assemble(fmus, MOTOR_WIRES, stop=1.0, step=1e-3), folder / "motor.ssp")


def _compiled(archive: zipfile.ZipFile, name: str, folder: Path) -> Path:
    """Copy an FMU and add its binary."""
    work, target = folder / name, folder / f"{name}.fmu"
    with zipfile.ZipFile(archive.extract(f"resources/{name}.fmu", folder)) as fmu:
        fmu.extractall(work)
    platform = PLATFORMS[host()]
    binary = work / f"binaries/{platform.folders[0]}/{name}{platform.suffix}"
    binary.parent.mkdir(parents=True)
    sources = map(str, sorted(work.glob("sources/*.c")))
    # -w: the warnings are not ours to mend
    options = ("-O2", "-w", "-DNO_FUNCTION_PREFIX", "-shared", "-fPIC")
    command = [sys.executable, "-m", "ziglang", "cc", *options, *sources, "-o", str(binary), "-lm"]
    subprocess.run(command, check=True)
    with zipfile.ZipFile(target, "w") as fmu:
        for file in sorted(p for p in work.rglob("*") if p.is_file()):
            fmu.write(file, file.relative_to(work).as_posix())
    return target


def truck_solution(time: np.ndarray) -> dict[str, np.ndarray]:
    """Positions of chassis and wheel [m]: the linear equations of the C code, solved by matrix exponentials.

    At t = 1 s the ground rises by 0.1 m. The FMU gives its velocity through a filter of 10 Hz.
    Deviations from rest: velocities v, w and positions z, y of chassis and wheel; position of the ground and
    its velocity g.

    400 v' = 15000 (y - z) + 1000 (w - v)        40 w' = 150000 (r - y) - 15000 (y - z) - 1000 (w - v)
    g' = - 20 pi g, from g = 20 pi 0.1           r' = g
    """
    bandwidth, step, begin = 20 * np.pi, 0.1, 1.0
    spring, damper, tyre, chassis, wheel = 15000.0, 1000.0, 150000.0, 400.0, 40.0
    a = np.zeros((6, 6))  # of z, v, y, w, r, g
    a[0, 1] = a[2, 3] = a[4, 5] = 1.0
    a[1] = np.array([-spring, -damper, spring, damper, 0, 0]) / chassis
    a[3] = np.array([spring, damper, -spring - tyre, -damper, tyre, 0]) / wheel
    a[5, 5] = -bandwidth
    start = np.array([0, 0, 0, 0, 0, bandwidth * step])
    moved = np.array([expm(a * max(t - begin, 0.0)) @ start for t in time])
    return {"chassis.zChassis": 1.0 + moved[:, 0], "wheel.zWheel": 0.5 + moved[:, 2]}
