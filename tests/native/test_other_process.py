"""A saved state is bytes: written by one process, it continues in another one."""

from __future__ import annotations

import pytest
from native.bench import begin, drive, look, moves, push

NAMES = ("swing", "boom_stick", "manipulator", "operator_input", "harvester")


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("name", NAMES)
def test_co_simulation_continues_bit_by_bit(machines, drivers, tmp_path, version, name):
    """Half of a run in one process, the state in a file, the other half in a new one: the same digits."""
    fmu = machines[version, name]
    first, second = moves(fmu, 0, 40), moves(fmu, 40, 40)
    [whole] = drive(drivers[version], fmu, [*begin(fmu), *first, "write 0 state", *second], tmp_path)
    [rest] = drive(drivers[version], fmu, ["make 0 cs", "read 0 state", "at 0 0.2", *second], tmp_path)
    assert len(set(whole.splitlines())) > 70  # it moves
    assert rest.splitlines() == whole.splitlines()[40:]


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("name", NAMES)
def test_model_exchange_continues_bit_by_bit(machines, drivers, tmp_path, version, name):
    """The same with a solver outside: states, inputs and the mode are in the bytes."""
    fmu = machines[version, name]
    euler = [f"euler 0 1e-8 20 {fmu.states}", look(fmu)] * 3
    first = [*begin(fmu, kind="me"), *push(fmu, 0.5), *euler]
    [whole] = drive(drivers[version], fmu, [*first, "write 0 state", *euler], tmp_path)
    [rest] = drive(drivers[version], fmu, ["make 0 me", "read 0 state", "at 0 6e-7", *euler], tmp_path)
    assert len(set(whole.splitlines())) == 6  # it moves
    assert rest.splitlines() == whole.splitlines()[3:]
