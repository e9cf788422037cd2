"""Instances in threads: they share nothing."""

import platform
import shutil
import subprocess

import pytest
from kit import shards
from kit.needs import needs
from native.bench import CODE, STANDARD, begin, drive, look, moves, needs_gcc, run

THREADS = 8

pytestmark = [
    shards.c,
    needs("POSIX", "the driver has threads of POSIX only"),
]


def work(fmu, steps):
    """A life with everything that computes or allocates."""
    unknown, known = fmu.shown[0] + fmu.states, fmu.shown[0]
    along = f"along 0 {unknown} {known}"
    return [*begin(fmu), *moves(fmu, 0, steps), "save 0", along, "restore 0", "forget 0", look(fmu), "free 0"]


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("name", ["swing", "boom_stick", "manipulator", "operator_input", "harvester"])
def test_eight_threads_give_the_serial_numbers(machines, drivers, tmp_path, version, name):
    """Eight threads with an instance each print, digit by digit, what one alone prints."""
    fmu = machines[version, name]
    script = work(fmu, 300)
    [alone] = drive(drivers[version], fmu, script, tmp_path)
    assert set(drive(drivers[version], fmu, script, tmp_path, threads=THREADS)) == {alone}


def not_randomized() -> tuple[str, ...]:
    """The sanitizer's own memory does not find its place where the system spreads addresses too far."""
    words = ("setarch", platform.machine(), "--addr-no-randomize")
    allowed = shutil.which(words[0]) and subprocess.run([*words, "true"], check=False).returncode == 0
    return words if allowed else ()


@needs_gcc
@pytest.mark.parametrize("version", [2, 3])
def test_no_thread_touches_the_memory_of_another(machines, tmp_path, version):
    """ThreadSanitizer sees no data race between eight instances in eight threads."""
    fmu = machines[version, "swing"]
    sanitized = ("gcc", "-fsanitize=thread", "-O1", "-g", "-fPIC")
    library, program = tmp_path / "swing.so", tmp_path / "drive"
    run([*sanitized, *STANDARD, "-shared", fmu.sources / "swing_fmu.c", "-o", library, "-lm"])
    code = (CODE / "drive.c", CODE / f"fmu{version}.c")
    run([*sanitized, *STANDARD, *code, "-o", program, "-ldl", "-lpthread"])
    drive(program, fmu, work(fmu, 30), tmp_path, threads=THREADS, library=library, before=not_randomized())
