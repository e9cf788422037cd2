"""The notebooks in examples/notebook run in a Jupyter kernel, and are stored without outputs."""

import re
from pathlib import Path

import nbclient
import nbformat
import numpy as np
import pytest
from kit import shards

from orchestrator import run

pytestmark = shards.documents

ROOT = Path(__file__).parents[2]
NOTEBOOKS = sorted((ROOT / "examples/notebook").glob("*.ipynb"))
assert NOTEBOOKS, "no notebook is tested"


@pytest.mark.filterwarnings("ignore")  # of Jupyter's own packages
@pytest.mark.parametrize("file", NOTEBOOKS, ids=lambda f: f.stem)
def test_a_notebook_runs_and_shows_its_figures(file, built, tmp_path):
    """Every cell, without a message on stderr; figures are shown, and a result with its charts."""
    (tmp_path / "build").symlink_to(built)
    notebook = nbformat.read(file, as_version=4)
    assert not any(cell.get("outputs") or cell.get("execution_count") for cell in notebook.cells)
    nbclient.NotebookClient(notebook, timeout=600, resources={"metadata": {"path": str(tmp_path)}}).execute()
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", ())]
    data = [output["data"] for output in outputs if "data" in output]
    assert sum("image/png" in shown for shown in data) == 3
    assert any("<img" in shown.get("text/html", "") for shown in data)
    assert all(len(shown.get("text/plain", "")) < 600 for shown in data)
    printed = "".join(output["text"] for output in outputs if output.get("name") == "stdout")
    assert "manipulator.head_mass is 500 kg" in printed
    assert "internal_leakage_resistance: " in printed
    assert (tmp_path / "heavy.mat").is_file()


def test_the_master_of_the_page_agrees_with_run(built, tmp_path, monkeypatch):
    """docs/python.md: thirty lines with FMPy are the master "jacobi"."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "build").symlink_to(built)
    page = (ROOT / "docs/python.md").read_text(encoding="utf-8")
    code = next(c for c in re.findall(r"```python\n(.*?)```", page, re.DOTALL) if "FMU2Slave" in c)
    names: dict = {}
    exec(code, names)
    result = run(built / "harvester.ssp", master="jacobi", step=1e-3, stop=2.0)
    # same method; inputs differ by rounding, with which the FMUs may choose other inner steps at a tolerance
    # of 1e-6 of the range
    tolerance = 1e-6 * np.ptp(result["boom_angle"])
    assert names["boom_angle"] == pytest.approx(result["boom_angle"][-1], abs=tolerance)
