"""Valgrind: whatever is done with an FMU, no memory is used wrongly or lost."""

from collections.abc import Iterator

import pytest
from kit import shards
from kit.needs import needs
from native.bench import Fmu, begin, drive, look, push

VALGRIND = ("valgrind", "-q", "--error-exitcode=9", "--leak-check=full", "--errors-for-leak-kinds=all")
NAMES = ("swing", "operator_input", "manipulator", "boom_stick", "harvester")
INSTANCES, STEPS, ROUNDS = 100, 1000, 10
OF_HARVESTER = 20  # instances of the whole machine: the C code around the equations is that of its parts

pytestmark = [
    shards.c,
    needs("valgrind"),
]


def life(fmu: Fmu, steps: int) -> Iterator[str]:
    """All instances run `steps` steps in parallel, with all functions for saved states."""
    part, length = steps // ROUNDS, 1e-4
    instances = OF_HARVESTER if fmu.name == "harvester" else INSTANCES
    unknown, known = fmu.shown[0] + fmu.states, fmu.shown[0]  # a derivative, a state
    for i in range(instances):
        yield from begin(fmu, i)
    for r in range(ROUNDS):
        for i in range(instances):
            yield from push(fmu, 0.1 * r + i, i)
            yield f"save {i}"
            if (i + r) % 5 == 0:  # once more from here, by way of a file
                yield from (f"step {i} {length} {part}", f"restore {i}", f"at {i} {r * part * length!r}")
                yield from (f"write {i} bytes", f"read {i} bytes")
            yield from (f"step {i} {length} {part}", look(fmu, i), f"slopes {i} {unknown + fmu.states} 1")
            yield from (f"along {i} {unknown} {known}", f"forget {i}")
    for i in range(instances):
        yield from (f"reset {i}", f"free {i}")
    yield from begin(fmu, 0, "me")
    yield from (f"euler 0 1e-8 10 {fmu.states}", look(fmu), "free 0")


# the functions of FMI are the same in all FMUs of a version
CASES = [(name, version) for name in NAMES for version in (2, 3) if version == 3 or name in NAMES[:2]]


@pytest.mark.parametrize(("name", "version"), CASES)
def test_valgrind_finds_nothing(machines, drivers, tmp_path, name, version):
    """A hundred instances (of the whole machine twenty), a thousand steps each: no error, no leak."""
    fmu = machines[version, name]
    drive(drivers[version], fmu, life(fmu, STEPS), tmp_path, before=VALGRIND)
