"""A saved state is bytes: written by one process, it continues in another one."""

import pytest
from native.bench import begin, drive, look, moves, push

NAMES = ("swing", "boom_stick", "manipulator", "operator_input", "harvester")


@pytest.mark.parametrize("kind", ["cs", "me"])
@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("name", NAMES)
def test_a_run_continues_bit_by_bit(machines, drivers, tmp_path, version, name, kind):
    """Half of a run in one process, the state in a file, the other half in a new one: the same digits.

    In Co-Simulation, and with a solver outside: states, inputs and the mode are in the bytes.
    """
    fmu = machines[version, name]
    euler = [f"euler 0 1e-8 20 {fmu.states}", look(fmu)] * 3
    first, second, time, different = {
        "cs": (moves(fmu, 0, 40), moves(fmu, 40, 40), "0.2", 71),
        "me": ([*push(fmu, 0.5), *euler], euler, "6e-7", 6),
    }[kind]
    script = [*begin(fmu, kind=kind), *first, "write 0 state", *second]
    [whole] = drive(drivers[version], fmu, script, tmp_path)
    script = [f"make 0 {kind}", "read 0 state", f"at 0 {time}", *second]
    [rest] = drive(drivers[version], fmu, script, tmp_path)
    assert len(set(whole.splitlines())) >= different  # it moves
    assert rest.splitlines() == whole.splitlines()[-len(rest.splitlines()) :]
    assert len(whole.splitlines()) == 2 * len(rest.splitlines())
