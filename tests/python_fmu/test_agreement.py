"""The same equations three times: as C, in Python, and in Python inside an FMU."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from fmpy import read_model_description
from fmpy.validation import validate_fmu
from kit import shards
from kit.every import EVERY, native, row
from kit.fmu import driving

from fmus.contract import Subsystem, quantities
from fmus.controller import CONTROLLER
from fmus.export.model_description import COMMUNICATION_STEP
from fmus.export.python.build import build_python
from fmus.export.python.instance import Refused, of_subsystem
from fmus.parameters import values
from orchestrator import run

# parts that differ in kind in every run: the code around the equations is the same for all
FEW = ("swing_lumped", "manipulator_rigid", "operator_input", "controller")
EACH = [
    *((name, False) for name in FEW),
    # the cycle begins with these seconds; the controller is no part of the machine that plays it
    *(pytest.param(name, True, marks=shards.machine) for name in EVERY if name != CONTROLLER.name),
]
STOP = 3.0  # s: boom and swing are moved in this part of the work cycle
Run = dict[str, np.ndarray]
Rows = list[dict[str, float]]


def first_seconds(sub: Subsystem) -> tuple[Rows, float]:
    """The inputs of the part at the begin of the work cycle, one row for each step, and the step [s]."""
    return [row(sub, k) for k in range(round(STOP / COMMUNICATION_STEP))], COMMUNICATION_STEP


def whole_cycle(sub: Subsystem, folder: Path) -> tuple[Rows, float]:
    """The same over 42 s, from the machine with this variant."""
    swap, step = {sub.component: sub.variant} if sub.variant else {}, 5e-3
    trace = run(folder / "harvester.ssp", swap=swap, step=step).trace
    known = {n: f"{sub.component}.{n}" for n in quantities(sub.inputs)}
    samples = {n: trace[name].tolist() for n, name in known.items() if name in trace.signals}
    return [{n: v[k] for n, v in samples.items()} for k in range(trace.time.size - 1)], step


def of_fmu(path: Path, sub: Subsystem, rows: Rows, step: float) -> Run:
    """All variables over time, of an FMU."""
    names = shown(sub)
    with driving(path, **rows[0]) as fmu:
        found = [fmu.get(*names)]
        for u in rows:
            fmu.set(**u)
            found.append(fmu.step(step).get(*names))
    return dict(zip(names, np.array(found).T, strict=True))


def in_python(sub: Subsystem, rows: Rows, step: float) -> Run:
    """All variables over time, of an instance in Python."""
    names = shown(sub)
    instance = of_subsystem(sub).initialise(**rows[0])
    found, time = [[instance[n] for n in names]], 0.0
    for u in rows:
        instance.assign(**u)
        instance.step(time, step)  # the master's time, as above
        time += step
        found.append([instance[n] for n in names])
    return dict(zip(names, np.array(found).T, strict=True))


def shown(sub: Subsystem) -> list[str]:
    """States and outputs."""
    return list(dict.fromkeys([*quantities(sub.states), *quantities(sub.outputs)]))


@pytest.mark.parametrize(("name", "whole"), EACH)
def test_native_python_and_pythonfmu_agree(fmu_dir, tmp_path, name, whole):
    """C and Python agree to 1e-9 over the work cycle, Python inside and outside an FMU to the last bit.

    FMPy's validation finds no problem in the FMU.
    """
    sub = EVERY[name]
    work = whole_cycle(sub, fmu_dir) if whole else first_seconds(sub)
    compiled, python = of_fmu(native(name, fmu_dir), sub, *work), in_python(sub, *work)
    path = build_python(sub, tmp_path)
    fmu = of_fmu(path, sub, *work)
    assert any(np.ptp(samples) > 0 for samples in compiled.values())  # it worked
    magnitude = {n: q.nominal for n, q in {**quantities(sub.states), **quantities(sub.outputs)}.items()}
    for n, samples in compiled.items():
        assert python[n].tobytes() == fmu[n].tobytes(), n
        # the bar of the issue; below 1e-12 of its magnitude a signal is rounding
        room = 1e-9 * np.abs(samples).max() + 1e-12 * magnitude[n]
        assert np.abs(python[n] - samples).max() <= room, n
    assert validate_fmu(str(path)) == []


def test_two_builds_are_equal(tmp_path):
    """Equal subsystems give equal bytes; other values give another GUID."""
    sub = EVERY["swing_lumped"]
    one, two = (build_python(sub, tmp_path / part) for part in ("one", "two"))
    assert one.read_bytes() == two.read_bytes()
    numbers = values(sub)
    first = next(iter(numbers.p))
    other = replace(numbers, p={**numbers.p, first: 1.01 * numbers.p[first]})
    three = build_python(sub, tmp_path / "three", values=other)
    assert read_model_description(str(one)).guid != read_model_description(str(three)).guid


def test_a_violated_requirement_is_told_rather_than_the_nan_that_it_causes():
    """A governor without a range of speeds divides by zero; the message contains the violated requirement."""
    run = of_subsystem(EVERY["supply_engine_pump"])
    run.setup(0.0, None, None)
    run.assign(engine_no_load_speed=260.0, engine_rated_speed=260.0)
    run.enter()
    violated = '"engine_no_load_speed exceeds engine_rated_speed" is violated at t = 0 s'
    with pytest.raises(Refused, match=violated):
        run["engine_power"]


def test_refused_derivatives_name_what_is_possible():
    """The messages of the native FMU: all kinds of variables that are accepted, in each phase."""
    run = of_subsystem(EVERY["swing_lumped"])
    torque, pressure, command, bore = (
        run.references[n] for n in ("swing_torque", "swing_pressure_a", "swing_command", "line_bore")
    )
    run.setup()
    run.enter()
    known = "swing_pressure_a is not a known, expected an input, a parameter or a state with a start value"
    with pytest.raises(Refused, match=known):
        run.directional_derivative([torque], [pressure], [1.0])
    run.exit()
    with pytest.raises(Refused, match="line_bore is not a known, expected an input or a state"):
        run.directional_derivative([torque], [bore], [1.0])
    unknown = "swing_command is not an unknown, expected an output, a derivative or a state"
    with pytest.raises(Refused, match=unknown):
        run.directional_derivative([command], [pressure], [1.0])
    with pytest.raises(Refused, match="swing_command is not an output or a state"):
        run.output_derivatives([command], [1])
