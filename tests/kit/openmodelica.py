"""Systems and FMUs in OpenModelica, as a user simulates the package that `harvester modelica` writes."""

import shutil
import subprocess
from pathlib import Path

import pandas as pd
import pytest

from orchestrator.modelica import write_package


def simulated(file: Path, folder: Path, model: str, experiment: str) -> pd.DataFrame:
    """Rows of a model of the package of a file, the last one at each time; `experiment`: its arguments."""
    omc = shutil.which("omc")
    if omc is None:
        pytest.skip("no OpenModelica found: omc is not on the search path")
    write_package([file], folder, "Told")
    (folder / "run.mos").write_text(
        'loadModel(Modelica, {"4.0.0"}); loadFile("Told/package.mo"); getErrorString();\n'
        f'simulate(Told.{model}, {experiment}, outputFormat = "csv"); getErrorString();\n'
    )
    done = subprocess.run([omc, "run.mos"], cwd=folder, capture_output=True, text=True, check=False)
    assert "The simulation finished successfully" in done.stdout, done.stdout[-2000:]
    (found,) = folder.glob("*_res.csv")
    return pd.read_csv(found).drop_duplicates("time", keep="last")
