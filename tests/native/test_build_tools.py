"""The C inside the FMUs, built by compilers and build systems that are not the project's own."""

from __future__ import annotations

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

from fmus.machine.parts import ALL

pytestmark = shards.c

STEP = 1e-3  # s
TABLE = [("time", float), ("swing_command", float)]
FLAGS = ["-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror", f"-I{HEADERS}"]


def sources(fmu: Path, folder: Path) -> Path:
    """The C file to compile, unpacked with what it includes."""
    with zipfile.ZipFile(fmu) as archive:
        for name in archive.namelist():
            if name.startswith("sources/"):
                archive.extract(name, folder)
    return folder / "sources" / f"{fmu.stem}_fmu.c"


@needs_gcc
@pytest.mark.parametrize("version", ["fmu_dir", "fmi3_dir"])
@pytest.mark.parametrize("name", tuple(ALL))
def test_sources_compile_without_a_warning(request, tmp_path, name, version):
    """The C in sources/ is plain C99 for a compiler that did not build the FMU, with FMPy's FMI headers."""
    code = sources(request.getfixturevalue(version) / f"{name}.fmu", tmp_path)
    run(["gcc", *FLAGS, "-O2", "-fPIC", "-shared", code, "-o", tmp_path / f"{name}.so", "-lm"])


@needs_gcc
def test_two_fmus_link_into_one_program(fmi3_dir, tmp_path):
    """Source FMUs for targets without a loader: with a prefix each, two of them have no name in common.

    With FMI 3, because FMPy's header of FMI 2 has lost the prefix that the standard's has.
    """
    names, objects = ("swing", "manipulator"), []
    for name in names:
        code = sources(fmi3_dir / f"{name}.fmu", tmp_path / name)
        objects.append(tmp_path / f"{name}.o")
        run(["gcc", *FLAGS, f"-DFMI3_FUNCTION_PREFIX={name}_", "-c", code, "-o", objects[-1]])
    main = tmp_path / "main.c"
    declared = "".join(f"const char *{name}_fmi3GetVersion(void);" for name in names)
    calls = " && ".join(f"{name}_fmi3GetVersion()" for name in names)
    main.write_text(f"{declared} int main(void) {{ return !({calls}); }}\n", encoding="utf-8")
    run(["gcc", "-std=c99", main, *objects, "-o", tmp_path / "main", "-lm"])
    run([tmp_path / "main"])


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
