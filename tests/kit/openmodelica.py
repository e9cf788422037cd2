"""OpenModelica runs a script."""

import shutil
import subprocess
from pathlib import Path

import pytest


def openmodelica(script: Path) -> str:
    """What OpenModelica prints for a script, run in its folder; the test is skipped without the tool."""
    omc = shutil.which("omc")
    if omc is None:
        pytest.skip("no OpenModelica found: omc is not on the search path")
    command = {"args": [omc, script.name], "cwd": script.parent}
    run = subprocess.run(**command, capture_output=True, text=True, check=False)
    return run.stdout + run.stderr
