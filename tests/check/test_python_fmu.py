"""FMUs that need Python are reported."""

import subprocess
import sys
from pathlib import Path

import pytest

from orchestrator.check.checking import check

PUMP = '''"""A pump in Python."""
import {package}
from pythonfmu import Fmi2Causality, Fmi2Slave, Real


class Pump(Fmi2Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.y = 0.0
        self.register_variable(Real("y", causality=Fmi2Causality.output))

    def do_step(self, t, h):
        return True
'''


@pytest.fixture(scope="module")
def pump(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An FMU that PythonFMU built of a script that imports numpy."""
    folder = tmp_path_factory.mktemp("pump")
    (folder / "pump.py").write_text(PUMP.format(package="numpy"))
    command = [sys.executable, "-m", "pythonfmu", "build", "-f", "pump.py", "-d", "."]
    subprocess.run(command, cwd=folder, check=True, capture_output=True)
    return folder / "Pump.fmu"


def test_it_needs_python_on_the_target(pump: Path) -> None:
    """The libraries of PythonFMU call Python and do not contain it; the finding has the evidence."""
    found = {f.rule: f for f in check(pump, run=False).findings}
    assert "needs Python on the target" in found["python.needed"].text
    assert "PythonFMU#192" in found["python.needed"].thread
    assert "Py" in found["binary.symbols"].text
    assert "numpy" in found["python.packages"].text
    assert "lacks y" in found["structure.initial"].text


@pytest.mark.parametrize("tool", ["simulink", "dymola", "amesim"])
def test_it_is_an_error_where_tools_fail_with_python(pump: Path, tool: str) -> None:
    """Needing Python is an error for tools with threads about crashes and failed starts."""
    report = check(pump, tool, run=False)
    assert report.failed
    assert "error" in {f.severity for f in report.findings if f.rule == "python.needed"}
