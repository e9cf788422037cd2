"""The C inside the FMUs, built by compilers and build systems that are not the project's own."""

import os
import shutil
import sysconfig
import zipfile
from pathlib import Path

import numpy as np
import pytest
from fmpy import extract, simulate_fmu
from kit import shards
from kit.compile import HEADERS
from native.bench import needs_gcc, run

from fmus.machine.one_block import HARVESTER
from fmus.machine.parts import FERIC

pytestmark = shards.c

STEP = 1e-3  # s
TABLE = [("time", float), ("swing_command", float)]
FLAGS = ["-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror", f"-I{HEADERS}"]


def sources(fmu: Path, folder: Path) -> list[Path]:
    """The .c files, unpacked with what they include."""
    with zipfile.ZipFile(fmu) as archive:
        for name in archive.namelist():
            if name.startswith("sources/"):
                archive.extract(name, folder)
    return sorted((folder / "sources").glob("*.c"))


@needs_gcc
@pytest.mark.parametrize("version", ["fmu_dir", "fmi3_dir"])
@pytest.mark.parametrize("name", [*FERIC.components, HARVESTER.name])
def test_sources_compile_without_a_warning(request, tmp_path, name, version):
    """All .c files in sources/ are plain C99 for another compiler, with FMPy's headers."""
    code = sources(request.getfixturevalue(version) / f"{name}.fmu", tmp_path)
    run(["gcc", *FLAGS, "-O2", "-fPIC", "-shared", *code, "-o", tmp_path / f"{name}.so", "-lm"])


@pytest.mark.skipif(not (shutil.which("make") and shutil.which("cc")), reason="needs make and a C compiler")
@pytest.mark.parametrize("version", ["fmu_dir", "fmi3_dir"])
def test_fmpy_builds_the_sources_itself(request, tmp_path, monkeypatch, version):
    """`fmpy compile` builds swing.fmu from its list of sources, in both versions; it runs the same."""
    from fmpy.build import build_platform_binary

    fmu = request.getfixturevalue(version) / "swing.fmu"
    monkeypatch.setenv("PATH", sysconfig.get_path("scripts") + os.pathsep + os.environ["PATH"])  # cmake
    folder = Path(extract(str(fmu), str(tmp_path / "swing")))
    shutil.rmtree(folder / "binaries")
    (tmp_path / "build").mkdir()
    build_platform_binary(folder, tmp_path / "build")
    table = np.array([(0.0, 0.0), (0.2, 0.0), (0.7, 4.0), (1.5, 4.0), (2.0, 0.0)], dtype=TABLE)
    runs = [
        simulate_fmu(str(path), stop_time=3.0, output_interval=STEP, input=table) for path in (fmu, folder)
    ]
    for output in runs[0].dtype.names:
        ours, theirs = (run[output] for run in runs)
        # same C, other compiler: rounding, amplified by the step control of the solver to its tolerance, 1e-6
        assert np.max(np.abs(ours - theirs)) <= 1e-6 * np.ptp(ours) + 1e-12, output
