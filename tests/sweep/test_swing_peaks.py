"""The example examples/swing_peaks: its studies are valid, and the small one runs to its report."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from kit import shards

from orchestrator.studies.cases import resolve
from orchestrator.studies.parameter_study import sweep
from orchestrator.studies.report import study_page
from orchestrator.studies.study import read

EXAMPLE = Path(__file__).parents[2] / "examples" / "swing_peaks"


def _copy(name: str, fmus: Path, folder: Path, *changes: tuple[str, str]) -> Path:
    """A study of the example beside other FMUs, with some lines changed."""
    text = (EXAMPLE / name).read_text("utf-8")
    for old, new in (("../../build/harvester.ssp", str(fmus / "harvester.ssp")), *changes):
        assert old in text
        text = text.replace(old, new)
    file = folder / name
    file.write_text(text, "utf-8")
    return file


@pytest.mark.parametrize("name", ["study.toml", "small.toml"])
def test_names_and_units_of_the_studies_are_right(name: str, fmu_dir: Path, tmp_path: Path) -> None:
    """Every factor and signal is in the machine, and peaks are in Pa."""
    study = resolve(read(_copy(name, fmu_dir, tmp_path)))[0]
    assert {output.unit for output in study.outputs} == {"Pa"}
    # the levers play nothing but the strokes of the study
    played = {n for n, value in study.fixed.items() if n.endswith("_command") and value}
    assert played <= {"operator_input.swing_1_command", "operator_input.swing_2_command"}


@shards.machine
def test_the_small_study_runs_to_its_report(fmu_dir: Path, tmp_path: Path) -> None:
    """All runs end, and at a start the pressure of the driving line is between preload and supply."""
    short = (
        ("runs = 64", "runs = 1"),
        ("stop = 7.0", "stop = 2.0"),
        ("start = 0.5, stop = 2.8", "start = 0.5"),
        ("start = 2.8, stop = 6.9", "start = 1.0"),
    )
    file = _copy("small.toml", fmu_dir, tmp_path, *short)
    results = sweep(file, tmp_path / "out", workers=1)
    assert (results.table["status"] == "ok").all()
    assert results.table["output:start_left"].between(1e6, 2.07e7).all()
    assert study_page.report(tmp_path / "out").exists()
    numbers = json.loads((tmp_path / "out" / study_page.NUMBERS).read_text("utf-8"))
    assert numbers["sentences"]["start_left"][0].startswith(
        "The sensitivities of start_left cannot be estimated"
    )
