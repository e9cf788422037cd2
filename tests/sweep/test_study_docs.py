"""The studies in docs/sweep.md and in examples/swing_peaks: they are valid, and small ones run."""

import json
import re
from pathlib import Path

import pytest
from kit import shards
from sweep.studies import resolved, run

from orchestrator.studies import study_page
from orchestrator.studies.cases import resolve
from orchestrator.studies.study import read

DOCS = Path(__file__).parents[2] / "docs" / "sweep.md"


def _block(language: str, place: int) -> str:
    """A code block of the page."""
    return re.findall(rf"(?s)```{language}\b[^\n]*\n(.*?)```", DOCS.read_text(encoding="utf-8"))[place]


def _placed(text: str, file: Path, fmus: Path, *changes: tuple[str, str]) -> Path:
    """The file of a study of FMUs in another folder, with some lines changed."""
    for old, new in (("build/harvester.ssp", f"{fmus.as_posix()}/harvester.ssp"), *changes):
        assert old in text
        text = text.replace(old, new)
    file.write_text(text, encoding="utf-8")
    return file


def _small(fmus: Path, folder: Path, more: str = "") -> Path:
    """The study at the top of the page, with few runs."""
    return _placed(_block("toml", 0) + more, folder / "peak.toml", fmus, ("runs = 200", "runs = 4"))


def test_the_small_study_runs_as_it_stands(fmu_dir, tmp_path):
    """All its runs end, with a report; peaks lie between the preload and the largest supply pressure."""
    results, runs = run(_small(fmu_dir, tmp_path))
    assert runs == [0, 1, 2, 3]
    assert (results.table["status"] == "ok").all()
    assert results.table["output:peak"].between(1e6, 2.07e7).all()
    assert "peak" in study_page.write(tmp_path / "out", results).text()


def test_the_short_scenario_leaves_the_machine_at_rest(fmu_dir, tmp_path):
    """It takes the place of all levers: the swing keeps its angle, the preload is not left upwards."""
    (tmp_path / "rest.csv").write_text(_block("csv", 0), encoding="utf-8")
    more = """angle = { signal = "manipulator.swing_angle", measure = "range" }
[choices]
scenario = "rest.csv"
"""
    table = run(_small(fmu_dir, tmp_path, more))[0].table
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


def test_the_ramp_of_a_lever_is_varied_as_the_page_says(fmu_dir, tmp_path):
    """Unchanged: one lever makes one stroke up to 3.6 V in all runs, with another peak in each."""
    more = """lever = { signal = "operator_input.swing_command", measure = "maximum" }
boom = { signal = "operator_input.boom_command", measure = "range" }
"""
    table = run(_placed(_block("toml", 2) + more, tmp_path / "ramp.toml", fmu_dir))[0].table
    assert table["status"].tolist() == ["ok"] * 8
    assert table["start:operator_input.swing_1_rise"].between(0.1, 0.7).all()
    assert table["output:lever"].to_numpy() == pytest.approx(3.6, rel=1e-12)  # V; rounding only
    assert (table["output:boom"] == 0).all()
    assert table["output:peak"].nunique() == 8


# ---- the example examples/swing_peaks


EXAMPLE = Path(__file__).parents[2] / "examples" / "swing_peaks"


def _example(name: str, fmus: Path, folder: Path, *changes: tuple[str, str]) -> Path:
    """A study of the example."""
    return _placed((EXAMPLE / name).read_text("utf-8").replace("../../", ""), folder / name, fmus, *changes)


@pytest.mark.parametrize("name", ["study.toml", "small.toml"])
def test_names_and_units_of_the_studies_are_right(name: str, fmu_dir: Path, tmp_path: Path) -> None:
    """Every factor and signal is in the machine, and peaks are in Pa."""
    study = resolve(read(_example(name, fmu_dir, tmp_path)))[0]
    assert {output.unit for output in study.outputs} == {"Pa"}
    # the levers play nothing but the strokes of the study
    played = {n for n, value in study.fixed.items() if n.endswith("_command") and value}
    assert played <= {"operator_input.swing_1_command", "operator_input.swing_2_command"}


@shards.machine
def test_the_small_study_runs_to_its_report(fmu_dir: Path, tmp_path: Path) -> None:
    """All runs end, and at a start the pressure of the driving line is between preload and supply."""
    short = (
        *(("runs = 64", "runs = 1"), ("stop = 7.0", "stop = 2.0")),
        *(("start = 0.5, stop = 2.8", "start = 0.5"), ("start = 2.8, stop = 6.9", "start = 1.0")),
    )
    results = run(_example("small.toml", fmu_dir, tmp_path, *short))[0]
    assert (results.table["status"] == "ok").all()
    assert results.table["output:start_left"].between(1e6, 2.07e7).all()
    study_page.write(tmp_path / "out", results)
    numbers = json.loads((tmp_path / "out" / study_page.NUMBERS).read_text("utf-8"))
    told = "The sensitivities of start_left cannot be estimated"
    assert numbers["sentences"]["start_left"][0].startswith(told)
