"""What every FMU of the machine must do: equations, derivatives, clear errors."""

import zipfile

import numpy as np
import pytest
from fmpy.fmi1 import FMICallException
from kit import mistakes
from kit.equations import Part
from kit.fmu import driving
from lxml import etree

from benchmarks.reference import work_cycle
from fmus.contract import quantities
from fmus.machine.build import data
from fmus.machine.parts import FERIC
from fmus.machine.tables import variant_names
from orchestrator import load

NAMES = tuple(FERIC.subsystems)


def test_only_derivatives_of_states_say_so_in_fmi_2(fmu_dir):
    """Of every FMU: OMSimulator counts the variables with the attribute `derivative` as states.

    Rate inputs are marked by an annotation; the orchestrator knows them all the same.
    """
    paths = [*fmu_dir.glob("*.fmu"), *fmu_dir.glob("variants/*.fmu")]
    assert len(paths) == len(variant_names()) + 8  # usual parts, operator, controller, the whole machine
    for path in paths:
        with zipfile.ZipFile(path) as archive:
            root = etree.fromstring(archive.read("modelDescription.xml"))
        said = root.findall("ModelVariables/ScalarVariable/Real[@derivative]")
        assert len(said) == len(root.findall("ModelStructure/Derivatives/Unknown")), path.name
        sub = next((s for s in FERIC.components.values() if s.name == path.stem), None)
        declared = {n: q.rate for n, q in quantities(sub.inputs).items() if q.rate} if sub else {}
        if declared:
            (component,) = load(path).components.values()
            assert component.interface.rate_inputs == declared


@pytest.mark.parametrize("name", NAMES)
def test_compiled_equations_equal_the_python_equations(fmu_dir, name):
    """Derivatives and outputs through the ME interface are those of dynamics() and observe()."""
    part, rng = Part(FERIC.subsystems[name]), np.random.default_rng(3)
    # every input but the positions, anywhere within a third of its nominal value
    free = {n: q.nominal for n, q in quantities(part.sub.inputs).items() if not n.endswith("position")}
    start = part.u | {n: 200.0 for n in part.u if n == "payload_mass"}
    with driving(fmu_dir / f"{name}.fmu", "me") as fmu:
        x0 = fmu.get(*part.states)
        for _ in range(20):
            x = x0 * (1 + 0.05 * rng.standard_normal(x0.size)) + 1e-4 * rng.standard_normal(x0.size)
            u = start | {n: start[n] + 0.3 * size * rng.uniform(-1, 1) for n, size in free.items()}
            fmu.set(**u)
            fmu.set_continuous_states(*x)
            dx, y = part(x, **u)
            # the same operations in another order; differences of pressures lose up to six digits
            atol = 1e-9 * np.abs(dx).max()
            assert np.allclose(fmu.get(*(f"der_{n}" for n in part.states)), dx, rtol=1e-9, atol=atol)
            assert np.allclose(fmu.get(*part.outputs), [*y.values()], rtol=1e-9, atol=1e-9)


@mistakes.table(__file__, "impossible", "name, start, message")
def test_impossible_values_are_refused_by_name(fmu_dir, name, start, message, capsys):
    """A negative volume, a linkage that does not close or a NaN is an error with a message."""
    with pytest.raises(FMICallException), driving(fmu_dir / f"{name}.fmu", **start):
        pass
    logged = capsys.readouterr()
    assert message in logged.out + logged.err


def test_shipped_work_cycle_is_what_its_moves_give():
    """data/scenarios/work_cycle.csv is the list of moves in `fmus.operator_input`, nothing else."""
    stored = np.loadtxt(data("scenarios/work_cycle.csv"), delimiter=",", skiprows=1)
    time, commands = work_cycle()
    # ten digits
    assert np.allclose(stored, np.column_stack([time, commands]), rtol=1e-9, atol=1e-9)


def test_command_beyond_the_range_is_warned_of(fmu_dir, capsys):
    """70 V, meant as percent, opens the valve like 10 V and is told once; 10 V with rounding is legal."""
    with driving(fmu_dir / "swing.fmu") as fmu:
        fmu.set(swing_command=10.0 * (1 + 1e-6), swing_command_rate=0.0)  # printed as 10 V
        assert fmu.step(1e-3, 2).get("swing_flow_a")[0] > 0  # the line rings with a period of 6 ms
        assert "swing_command" not in capsys.readouterr().out
        fmu.set(swing_command=70.0)
        fmu.step(1e-3, 5)
    assert capsys.readouterr().out.count("swing_command = 70 V at t = 0.003 s is above 10 V") == 1
