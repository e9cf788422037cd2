"""The studies in docs/sweep.md."""

from __future__ import annotations

from pathlib import Path

import pytest
from sweep.studies import resolved, run

from orchestrator.studies.report import study_page

DOCS = Path(__file__).parents[2] / "docs" / "sweep.md"


def _block(language: str, place: int) -> str:
    """A code block of the page."""
    return DOCS.read_text(encoding="utf-8").split(f"```{language}\n")[1 + place].split("```")[0]


def _small(fmus: Path, folder: Path, more: str = "") -> Path:
    """The study at the top of the page, with few runs."""
    text = _block("toml", 0)
    for old, new in (("build/harvester.ssp", f"{fmus.as_posix()}/harvester.ssp"), ("runs = 200", "runs = 4")):
        assert old in text
        text = text.replace(old, new)
    file = folder / "peak.toml"
    file.write_text(text + more, encoding="utf-8")
    return file


def test_the_small_study_runs_as_it_stands(fmu_dir, tmp_path, one):
    """All its runs end, with a report; peaks lie between the preload and the largest supply pressure."""
    results, runs = run(_small(fmu_dir, tmp_path), one)
    assert runs == [0, 1, 2, 3]
    assert (results.table["status"] == "ok").all()
    assert results.table["output:peak"].between(1e6, 2.07e7).all()
    assert study_page.report(tmp_path / "out").exists()


def test_the_short_scenario_leaves_the_machine_at_rest(fmu_dir, tmp_path, one):
    """It takes the place of all levers: the swing keeps its angle, the preload is not left upwards."""
    (tmp_path / "rest.csv").write_text(_block("csv", 0), encoding="utf-8")
    more = """angle = { signal = "manipulator.swing_angle", measure = "range" }
[choices]
scenario = "rest.csv"
"""
    table = run(_small(fmu_dir, tmp_path, more), one)[0].table
    assert (table["status"] == "ok").all()
    assert table["output:angle"].max() < 1e-6  # rad; in the work cycle it is more than one
    assert table["output:peak"].max() < 1.1e6  # Pa; it begins at 1e6


def test_the_example_of_the_documentation_is_a_study(fmu_dir, tmp_path):
    """docs/sweep.md shows a complete file; it can be read as it is, next to a build."""
    (tmp_path / "commands.csv").write_text("time,swing_command\n0,0\n1,3\n")
    found = resolved(tmp_path / "study.toml", _block("toml", 1).replace("../build", fmu_dir.as_posix()))
    assert [f.distribution for f in found.factors] == ["uniform", "normal", "values"]
    # t in kg, but for rounding
    assert found.fixed["manipulator.head_mass"] == pytest.approx(340.0, rel=1e-15)
    assert [c.name for c in found.choices] == ["boom_stick", "parameters", "scenario"]
    assert [o.name for o in found.outputs] == ["peak_pressure", "angle"]


def test_the_ramp_of_a_lever_is_varied_as_the_page_says(fmu_dir, tmp_path, one):
    """Unchanged: one lever makes one stroke up to 3.6 V in all runs, with another peak in each."""
    text = _block("toml", 2)
    assert "build/harvester.ssp" in text
    more = """lever = { signal = "operator_input.swing_command", measure = "maximum" }
boom = { signal = "operator_input.boom_command", measure = "range" }
"""
    file = tmp_path / "ramp.toml"
    file.write_text(text.replace("build", fmu_dir.as_posix()) + more, encoding="utf-8")
    table = run(file, one)[0].table
    assert table["status"].tolist() == ["ok"] * 8
    assert table["start:operator_input.swing_1_rise"].between(0.1, 0.7).all()
    assert table["output:lever"].to_numpy() == pytest.approx(3.6, rel=1e-12)  # V; rounding only
    assert (table["output:boom"] == 0).all()
    assert table["output:peak"].nunique() == 8
