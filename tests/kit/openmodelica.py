"""Scripts in OpenModelica; systems and FMUs as in the package that `harvester modelica` writes."""

import shutil
import subprocess
from pathlib import Path

import pandas as pd

from kit.needs import lacks
from orchestrator.modelica import write_package


def openmodelica(script: Path) -> str:
    """What OpenModelica prints for a script, run in its folder; the test is skipped without the tool."""
    omc = shutil.which("omc")
    if omc is None:
        lacks("OpenModelica", "omc is not on the search path")
    command = {"args": [omc, script.name], "cwd": script.parent}
    run = subprocess.run(**command, capture_output=True, text=True, check=False)
    return run.stdout + run.stderr


def simulated(file: Path, folder: Path, model: str, experiment: str) -> pd.DataFrame:
    """Rows of a model of the package of a file, the last one at each time; `experiment`: its arguments."""
    write_package([file], folder, "Told")
    script = folder / "run.mos"
    script.write_text(
        'loadModel(Modelica, {"4.0.0"}); loadFile("Told/package.mo"); getErrorString();\n'
        f'simulate(Told.{model}, {experiment}, outputFormat = "csv"); getErrorString();\n'
    )
    printed = openmodelica(script)
    assert "The simulation finished successfully" in printed, printed[-2000:]
    (found,) = folder.glob("*_res.csv")
    return pd.read_csv(found).drop_duplicates("time", keep="last")
