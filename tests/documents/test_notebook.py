"""The notebooks in examples/notebook run from top to bottom, and are stored without outputs."""

from __future__ import annotations

import ast
import json
from pathlib import Path

import pytest
from kit import shards

pytestmark = shards.documents

NOTEBOOKS = sorted((Path(__file__).parents[2] / "examples/notebook").glob("*.ipynb"))


def test_there_are_notebooks():
    """Else the other tests would be empty."""
    assert NOTEBOOKS


@pytest.mark.parametrize("file", NOTEBOOKS, ids=lambda f: f.stem)
def test_a_notebook_runs_and_shows_its_figures(file, built, tmp_path, monkeypatch, capsys):
    """Every cell; what a cell ends with can be shown; its outputs are not in the repository."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "build").mkdir()
    for name in ("harvester.ssp", "variants"):
        (tmp_path / "build" / name).symlink_to(built / name)
    cells = [c for c in json.loads(file.read_text(encoding="utf-8"))["cells"] if c["cell_type"] == "code"]
    assert not any(cell["outputs"] or cell["execution_count"] for cell in cells)
    names: dict[str, object] = {}
    figures = 0
    for cell in cells:
        tree = ast.parse("".join(cell["source"]))
        last = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else None
        exec(compile(tree, file.name, "exec"), names)
        shown = eval(compile(ast.Expression(last.value), file.name, "eval"), names) if last else None
        if hasattr(shown, "_repr_png_"):
            assert shown._repr_png_().startswith(b"\x89PNG")
            figures += 1
    assert figures == 3
    assert "manipulator.head_mass is 500 kg" in capsys.readouterr().out
    assert (tmp_path / "build/heavy.mat").is_file()
