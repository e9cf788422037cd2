"""The C inside the FMUs means the same to every compiler, however it optimises."""

import os
import shutil
import sysconfig
from pathlib import Path

import numpy as np
import pytest
from fmpy import extract, simulate_fmu
from kit import shards
from kit.needs import needs
from native.bench import STANDARD, assert_same, cycle, drive, needs_gcc, numbers, run

from fmus.operator_input.work_cycle import WORK_CYCLE_STOP

pytestmark = shards.c

GCC = {
    "O0": (3, "-O0"),
    "O2": (2, "-O2"),
    "Os": (3, "-Os"),
    "fused": (2, "-O3", "-march=native", "-ffp-contract=fast"),  # a * b + c rounded once: other roundings
    "undefined": (2, "-O1", "-fsanitize=undefined", "-fno-sanitize-recover=all"),
}


@needs_gcc
@pytest.mark.parametrize(("version", "flags"), [(v, f) for v, *f in GCC.values()], ids=GCC)
def test_gcc_gives_the_numbers_of_the_shipped_binary(machines, drivers, tmp_path, version, flags):
    """Over the work cycle the whole machine built by gcc is the one in the FMU; nothing is undefined in C."""
    fmu = machines[version, "harvester"]
    library = tmp_path / "harvester.so"
    run(["gcc", *flags, *STANDARD, "-fPIC", "-shared", fmu.sources / "harvester_fmu.c", "-o", library, "-lm"])
    script = cycle(fmu, WORK_CYCLE_STOP)
    [ours] = drive(drivers[version], fmu, script, tmp_path)
    [theirs] = drive(drivers[version], fmu, script, tmp_path, library=library)
    assert_same(numbers(ours), numbers(theirs))


# ---- The C inside the FMUs, built by a build system that is not the project's own

STEP = 1e-3  # s
TABLE = [("time", float), ("swing_command", float)]


@needs("make and cc")
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
    options = {"stop_time": 3.0, "output_interval": STEP, "input": table}
    runs = [simulate_fmu(str(path), **options) for path in (fmu, folder)]
    for output in runs[0].dtype.names:
        ours, theirs = (run[output] for run in runs)
        # same C, other compiler: rounding, amplified by the step control of the solver to its tolerance, 1e-6
        assert np.max(np.abs(ours - theirs)) <= 1e-6 * np.ptp(ours) + 1e-12, output
