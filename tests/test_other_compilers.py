"""The C inside the FMUs, built by compilers and build systems that are not the project's own."""

from __future__ import annotations

import os
import platform
import shutil
import subprocess
import sysconfig
import zipfile
from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmpy import extract, simulate_fmu

from fmus.machine import SUBSYSTEMS

STEP = 1e-3  # s
TABLE = [("time", float), ("swing_command", float)]


@pytest.mark.parametrize("name", tuple(SUBSYSTEMS))
def test_sources_compile_without_a_warning(fmu_dir, tmp_path, name):
    """The C in sources/ is plain C99 for a compiler that did not build the FMU, with FMPy's FMI headers."""
    compiler = shutil.which("gcc")
    if compiler is None or platform.system() != "Linux":
        pytest.skip("gcc on Linux is not there; the project's own compiler is tested by every build")
    with zipfile.ZipFile(fmu_dir / f"{name}.fmu") as archive:
        code = [archive.extract(n, tmp_path) for n in archive.namelist() if n.startswith("sources/")]
    flags = ["-std=c99", "-O2", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-fPIC", "-shared"]
    headers = Path(fmpy.__file__).parent / "c-code"
    sources = [path for path in code if path.endswith(".c")]
    library = str(tmp_path / f"{name}.so")
    command = [compiler, *flags, f"-I{headers}", *sources, "-o", library, "-lm"]
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr


@pytest.mark.skipif(not (shutil.which("make") and shutil.which("cc")), reason="needs make and a C compiler")
def test_fmpy_builds_the_sources_itself(fmu_dir, tmp_path, monkeypatch):
    """`fmpy compile` builds swing.fmu from its model description and sources; the result runs the same."""
    from fmpy.build import build_platform_binary

    monkeypatch.setenv("PATH", sysconfig.get_path("scripts") + os.pathsep + os.environ["PATH"])  # cmake
    folder = Path(extract(str(fmu_dir / "swing.fmu"), str(tmp_path / "swing")))
    shutil.rmtree(folder / "binaries")
    (tmp_path / "build").mkdir()
    build_platform_binary(folder, tmp_path / "build")
    table = np.array([(0.0, 0.0), (0.2, 0.0), (0.7, 4.0), (1.5, 4.0), (2.0, 0.0)], dtype=TABLE)
    runs = [
        simulate_fmu(str(fmu), stop_time=3.0, output_interval=STEP, input=table)
        for fmu in (fmu_dir / "swing.fmu", folder)
    ]
    for output in runs[0].dtype.names:
        ours, theirs = (run[output] for run in runs)
        # same C, other compiler: rounding, amplified by the step control of the solver to its tolerance, 1e-6
        assert np.max(np.abs(ours - theirs)) <= 1e-6 * np.ptp(ours) + 1e-12, output
