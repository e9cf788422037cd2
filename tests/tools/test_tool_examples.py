"""Examples for tools that may not be here: wires as in the machine; scripts run or say what is missing."""

from __future__ import annotations

import importlib.util
import re
import subprocess
import sys
from pathlib import Path

import pytest

from fmus.machine.parts import COMMAND_WIRES, CONNECTIONS

EXAMPLES = Path(__file__).parents[2] / "examples"
WIRES = sorted(CONNECTIONS + COMMAND_WIRES)
SCRIPTS = {"pyfmi": "pyfmi", "omsimulator": "OMSimulator"}  # folder -> module that its script needs


def test_simulink_wires_are_those_of_the_machine():
    """build_model.m connects what harvester.ssp connects."""
    text = (EXAMPLES / "simulink" / "build_model.m").read_text(encoding="utf-8")
    assert sorted(re.findall(r"^ +'([\w]+\.\w+)', +'(\w+\.\w+)'$", text, re.MULTILINE)) == WIRES


@pytest.mark.parametrize("folder", SCRIPTS)
def test_script_runs_or_says_in_one_line_what_is_missing(fmu_dir, tmp_path, folder):
    """With its tool a script prints the error of the work cycle; without, one line names the tool."""
    script = EXAMPLES / folder / "run.py"
    command = [sys.executable, str(script), str(fmu_dir / "harvester.ssp"), "--stop", "2"]
    run = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, check=False)
    if importlib.util.find_spec(SCRIPTS[folder]):
        assert "error over range after 2 s: speed 0." in run.stdout, run.stderr
    else:
        assert run.returncode == 1
        assert run.stderr.count("\n") == 1
        assert "is not here" in run.stderr
        assert "install" in run.stderr
