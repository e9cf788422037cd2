"""What every FMU of the machine must do: declared derivatives, clear errors."""

import zipfile

import pytest
from fmpy.fmi1 import FMICallException
from kit import mistakes
from kit.fmu import driving
from lxml import etree

from fmus.contract import quantities
from fmus.machine.parts import FERIC
from fmus.machine.tables import variant_names
from orchestrator import load


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


@mistakes.table(__file__, "impossible", "name, start, message")
def test_impossible_values_are_refused_by_name(fmu_dir, name, start, message, capsys):
    """A negative volume, a linkage that does not close or a NaN is an error with a message."""
    with pytest.raises(FMICallException), driving(fmu_dir / f"{name}.fmu", **start):
        pass
    logged = capsys.readouterr()
    assert message in logged.out + logged.err


def test_command_beyond_the_range_is_warned_of(fmu_dir, capsys):
    """70 V, meant as percent, opens the valve like 10 V and is told once; 10 V with rounding is legal."""
    with driving(fmu_dir / "swing.fmu") as fmu:
        fmu.set(swing_command=10.0 * (1 + 1e-6), swing_command_rate=0.0)  # printed as 10 V
        assert fmu.step(1e-3, 2).get("swing_flow_a")[0] > 0  # the line rings with a period of 6 ms
        assert "swing_command" not in capsys.readouterr().out
        fmu.set(swing_command=70.0)
        fmu.step(1e-3, 5)
    told = "more than the full command of the swing valve at t = 0.003 s: swing_command = 70 V (limit 10 V)"
    assert capsys.readouterr().out.count(told) == 1
