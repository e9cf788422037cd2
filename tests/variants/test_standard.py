"""The standard suite: what every variant of every part must do, as FMU."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from fmpy.validation import validate_fmu
from kit.every import EVERY, at_work, native, outputs, row, work
from kit.fmu import Fmu

from fmus.contract import Subsystem, quantities
from fmus.export.model_description import COMMUNICATION_STEP
from orchestrator.base.units import parse_unit

WORKING = 2.4  # s: boom, swing and stick have started


class Case(NamedTuple):
    """A subsystem, its FMU, and an instance at work."""

    sub: Subsystem
    path: Path
    fmu: Fmu


@pytest.fixture(scope="module", params=EVERY)
def case(request, fmu_dir):
    """Each variant as FMU."""
    sub, path = EVERY[request.param], native(request.param, fmu_dir)
    with at_work(path, sub, WORKING) as fmu:
        yield Case(sub, path, fmu)


@pytest.mark.parametrize("name", EVERY)
def test_every_unit_is_known(name):
    """The unit of every variable parses into SI base units with factor one: SI inside."""
    sub = EVERY[name]
    for group in (sub.parameters, sub.states, sub.inputs, sub.outputs):
        for variable, quantity in quantities(group).items():
            assert parse_unit(quantity.unit).factor == 1.0, variable


@pytest.mark.parametrize("name", [*EVERY, "harvester"])
def test_fmpy_finds_no_problem(fmu_dir, fmi3_dir, name):
    """Schema, model structure, units and names pass FMPy's validation, in both versions of FMI."""
    for folder in (fmu_dir, fmi3_dir):
        path = native(name, folder) if name in EVERY else folder / f"{name}.fmu"
        assert validate_fmu(str(path)) == []


def test_variables_say_their_units(case):
    """Every variable of the model description has the unit of its declaration, and the file defines it."""
    sub, described = case.sub, case.fmu.description
    known = {unit.name for unit in described.unitDefinitions}
    declared = {n: q for g in (sub.parameters, sub.inputs, sub.outputs) for n, q in quantities(g).items()}
    shown = {v.name: v.declaredType.unit if v.declaredType else v.unit for v in described.modelVariables}
    assert {n: shown[n] for n in declared} == {n: q.unit for n, q in declared.items()}
    assert {u for u in shown.values() if u is not None} <= known


def test_a_restored_state_repeats_the_steps_bit_for_bit(case):
    """Save, work on, restore, work on: the same bits; also through serialised bytes in a second instance."""
    sub, path, fmu = case
    names, begin = outputs(sub), round(WORKING / COMMUNICATION_STEP)

    def work_on(fmu: Fmu) -> bytes:
        rows = (fmu.set(**row(sub, begin + k)).step(COMMUNICATION_STEP).get(*names) for k in range(5))
        return np.array([*rows]).tobytes()

    with at_work(path, sub, 0.05) as other:
        state, data, time = fmu.fmu.getFMUState(), fmu.state(), fmu.time
        first = work_on(fmu)
        fmu.fmu.setFMUState(state)
        fmu.time = time
        again = work_on(fmu)
        fmu.fmu.freeFMUState(state)
        assert first == again == work_on(other.restore(data, time))


def declared(fmu: Fmu) -> dict[str, set[str]]:
    """Output -> the variables on which it depends as the description says."""
    return {u.variable.name: {d.name for d in u.dependencies or []} for u in fmu.description.outputs}


def test_dependencies_are_true(case):
    """An output moves at once with an input that it declares to depend on, and with no other one."""
    sub, _, fmu = case
    names, may = outputs(sub), declared(fmu)
    before, values = fmu.get(*names), dict(zip(work(sub), fmu.get(*work(sub)), strict=True))
    for name, value in values.items():
        fmu.set(**{name: value + 0.01 * quantities(sub.inputs)[name].nominal})
        moved = {n for n, a, b in zip(names, before, fmu.get(*names), strict=True) if a != b}
        fmu.set(**{name: value})
        assert not {n for n in moved if name not in may[n]}, f"these follow {name} and do not declare it"


def test_forces_and_motion_depend_on_states_only(case):
    """The cut: no force follows a velocity at once and no motion a force, or every coupling were a loop."""
    inputs, found = set(quantities(case.sub.inputs)), declared(case.fmu)
    # the lumped swing's line resistance and motor leakage: docs/design.md, "The cut between the FMUs"
    allowed = {"swing_torque": {"swing_speed", "tank_pressure", "oil_temperature"}}
    efforts = ("boom_force", "stick_force", "swing_torque", "supply_pressure")
    for output in (*efforts, "boom_velocity", "boom_position", "swing_speed"):
        assert found.get(output, set()) & inputs <= allowed.get(output, set()), output
