"""Examples for tools that may not be here: wires as in the machine; scripts run or say what is missing."""

from __future__ import annotations

import importlib.util
import re
import subprocess
import sys
from pathlib import Path

import pytest

from fmus.machine import ALL, COMMAND_WIRES, CONNECTIONS

EXAMPLES = Path(__file__).parents[1] / "examples"
WIRES = sorted(CONNECTIONS + COMMAND_WIRES)
SCRIPTS = {"pyfmi": "pyfmi", "omsimulator": "OMSimulator"}  # folder -> module that its script needs


def model(name: str) -> str:
    """The text of one Modelica model of the example."""
    text = (EXAMPLES / "modelica" / "Harvester.mo").read_text(encoding="utf-8")
    return text.partition(f"model {name} ")[2].partition(f"end {name};")[0]


def test_modelica_wires_are_those_of_the_machine():
    """FourBlocks connects what harvester.ssp connects."""
    found = re.findall(r"connect\(([\w.]+), ([\w.]+)\);", model("FourBlocks"))
    assert sorted(found) == WIRES


def test_modelica_feeds_every_input_of_the_one_block():
    """OneBlock wires each command with its rate, and holds the supply line."""
    found = dict(re.findall(r"connect\(levers.(\w+), machine.(\w+)\);", model("OneBlock")))
    assert found == {name.split(".")[1]: name.split(".")[1] for name, _ in COMMAND_WIRES}
    assert set(re.findall(r"machine.(\w+) = ", model("OneBlock"))) == {"supply_pressure", "tank_pressure"}


def test_modelica_names_all_fmus():
    """Each FMU but the supply, whose place constants take, has its class, named as OpenModelica does."""
    imported = set(re.findall(r"= (\w+)_me_FMU", (EXAMPLES / "modelica" / "Harvester.mo").read_text()))
    assert imported == {*ALL, "harvester"} - {"supply"}
    loaded = set(re.findall(r"build/(\w+)\.fmu", (EXAMPLES / "modelica" / "run.mos").read_text()))
    assert loaded == imported


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
