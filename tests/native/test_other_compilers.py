"""The C inside the FMUs means the same to every compiler, however it optimises."""

import pytest
from kit import shards
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
