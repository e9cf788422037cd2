"""Over the whole work cycle: `make test-long`. The default suite does the same over its first seconds."""

from __future__ import annotations

import numpy as np
import pytest
from kit import shards
from kit.every import EVERY, native, outputs, python
from kit.fmu import driving

from fmus.contract import quantities
from fmus.export.python.instance import of_subsystem
from orchestrator import run

pytestmark = shards.machine
STEP = 1e-3  # s


@pytest.fixture(scope="session")
def folders(fmu_dir, tmp_path_factory):
    """Of the native FMUs and of those in Python."""
    return fmu_dir, tmp_path_factory.mktemp("python")


def signals(sub, folder):
    """Inputs of a part at every millisecond of the work cycle, with this variant in the machine."""
    swap = {sub.component: sub.variant} if sub.variant else {}
    trace = run(folder / "harvester.ssp", swap=swap, step=STEP).trace
    names = [n for n in quantities(sub.inputs) if f"{sub.component}.{n}" in trace.signals]
    return names, np.column_stack([trace[f"{sub.component}.{n}"] for n in names]) if names else np.zeros(
        (42001, 0)
    )


def of_fmu(path, names, rows, shown):
    """Outputs over the cycle, of an FMU."""
    with driving(path, **dict(zip(names, rows[0], strict=True))) as fmu:
        found = [fmu.get(*shown)]
        for row in rows[:-1]:
            fmu.set(**dict(zip(names, row, strict=True)))
            found.append(fmu.step(STEP).get(*shown))
    return np.array(found)


def in_python(sub, names, rows, shown):
    """The same, of the functions in Python."""
    instance = of_subsystem(sub).initialise(**dict(zip(names, map(float, rows[0]), strict=True)))
    found, time = [[instance[n] for n in shown]], 0.0
    for row in rows[:-1]:
        instance.assign(**dict(zip(names, map(float, row), strict=True)))
        instance.step(time, STEP)
        time += STEP
        found.append([instance[n] for n in shown])
    return np.array(found)


@pytest.mark.parametrize("name", EVERY)
def test_native_python_and_pythonfmu_agree(folders, name):
    """C and Python agree to 1e-9 relative over 42 s, Python inside and outside an FMU to the last bit."""
    sub, (compiled, interpreted) = EVERY[name], folders
    names, rows = signals(sub, compiled)
    shown = outputs(sub)
    c = of_fmu(native(name, compiled), names, rows, shown)
    functions = in_python(sub, names, rows, shown)
    slave = of_fmu(python(name, interpreted), names, rows, shown)
    assert np.ptp(c, axis=0).max() > 0  # it worked
    assert slave.tobytes() == functions.tobytes()
    nominal = np.array([quantities(sub.outputs)[n].nominal for n in shown])
    # the bar, relative to the largest value of each signal; below 1e-12 of its magnitude a signal is rounding
    deviation = np.abs(functions - c).max(axis=0) / (np.abs(c).max(axis=0) + 1e-3 * nominal)
    print(f"{name}: {deviation.max():.1e} ({shown[int(deviation.argmax())]})")
    assert deviation.max() < 1e-9
