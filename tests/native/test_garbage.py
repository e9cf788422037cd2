"""Garbage in: random sequences of calls with random arguments, through the C interface."""

import os
import re
import sys

import pytest
from kit import shards
from native.bench import CODE, STANDARD, begin, drive, needs_gcc, run, unpack

from fmus.export.compile import FLAGS, PLATFORMS, host

pytestmark = shards.c

# for more: NATIVE_FUZZ_CALLS=1000000 NATIVE_FUZZ_SEED=7 NATIVE_FUZZ_MODELS="manipulator harvester"
CALLS = int(os.environ.get("NATIVE_FUZZ_CALLS", "50000"))  # of each program below
SEED = int(os.environ.get("NATIVE_FUZZ_SEED", "1"))
MODELS = os.environ.get("NATIVE_FUZZ_MODELS", "swing").split()
SANITIZED = ("gcc", "-O1", "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")


def fuzz(compiler, sources, version, folder):
    """Build the fuzz driver with an FMU's sources, run it; what it counted, by name."""
    program = folder / "fuzz"
    [source] = sources.glob("*_fmu.c")
    includes = (f"-I{CODE}", f"-I{sources}", f'-DSOURCES="{source.name}"')
    run([*compiler, *STANDARD, *includes, CODE / f"fuzz{version}.c", "-o", program, "-lm"])
    text = run([program, SEED, CALLS]).stdout
    return {name: int(n) for name, n in re.findall(r"(\w+) (\d+)[,\n]", text)}


@needs_gcc
@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("name", [*MODELS, "wild"])
def test_sanitizers_find_nothing(machines, wild, tmp_path, version, name):
    """Random calls cause no memory error, no undefined behaviour, no hang, and no status OK with NaN.

    Of `wild` most values are not finite.
    """
    fmu = unpack(wild[version], tmp_path / "fmu") if name == "wild" else machines[version, name]
    counted = fuzz(SANITIZED, fmu.sources, version, tmp_path)
    assert counted["calls"] >= CALLS
    assert min(counted["OK"], counted["refused"]) > CALLS / 10  # it gets somewhere, and it is garbage


@pytest.mark.parametrize("version", [2, 3])
def test_the_optimised_code_lets_no_odd_number_through(wild, tmp_path, version):
    """The compiler and the flags of the shipped binaries do not optimise the checks for NaN away."""
    fmu = unpack(wild[version], tmp_path / "fmu")
    flags = [flag for flag in FLAGS if flag.startswith(("-O", "-f")) and flag != "-fvisibility=hidden"]
    zig = [sys.executable, "-m", "ziglang", "cc", "-target", PLATFORMS[host()].target]
    assert fuzz([*zig, *flags], fmu.sources, version, tmp_path)["calls"] >= CALLS


@pytest.mark.parametrize("version", [2, 3])
def test_a_step_without_end_is_given_up(wild, drivers, tmp_path, version):
    """A step that would take the solver for hours ends with an error that says so."""
    fmu = unpack(wild[version], tmp_path / "fmu")
    with pytest.raises(AssertionError, match="more inner steps than allowed"):
        drive(drivers[version], fmu, [*begin(fmu), "step 0 1e9 1"], tmp_path)
