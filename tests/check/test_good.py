"""FMUs without faults have no findings."""

from pathlib import Path

import pytest
from kit import shards
from kit.any_fmu.models import MODELS, Workshop

from check.good import Good
from orchestrator.check.checking import check
from orchestrator.check.report import ANY, TOOLS


@pytest.mark.parametrize("major", [2, 3])
def test_the_complete_fmu_gives_no_finding(good: Good, major: int, tmp_path: Path) -> None:
    """An FMU that fulfils all rules has no findings; only FMI 3 gives a note, because some tools lack it."""
    path = good[major].write(tmp_path / "lag.fmu")
    report = check(path, run=False)
    assert [f.rule for f in report.findings] == (["version.new"] if major == 3 else [])
    assert report.summary() == ("nothing found" if major == 2 else "0 errors, 0 warnings, 1 note")
    for tool in TOOLS if major == 2 else ():  # FMI 2 suits every tool
        assert check(path, tool, run=False).findings == (), tool


ALL = ["*.fmu", "variants/*.fmu", "fmi3/*.fmu", "fmi3/variants/*.fmu"]


@pytest.mark.parametrize("files", shards.few(ALL[:3], ALL, shards.machine))
def test_the_machine_gives_neither_error_nor_warning(fmu_dir: Path, files: str) -> None:
    """The project's own FMUs, of both versions, are clean."""
    fmus = sorted(fmu_dir.glob(files))
    assert fmus
    for fmu in fmus:
        report = check(fmu, ANY, run=False)
        assert [f for f in report.findings if f.severity != "note"] == [], report.text()


def test_the_small_fmus_of_other_tests_lack_one_function(fmus: Workshop) -> None:
    """The orchestrator's test FMUs leave out fmi2CancelStep, and two call a parameter 'when'."""
    for model in (m for m in MODELS if m not in ("wide", "single")):  # FMI 3 only
        report = check(fmus[model], run=False)
        found = {f.rule for f in report.findings if f.severity != "note"}
        keyword = {"name.keyword"} if model in ("fails", "quirk") else set()
        assert found == {"binary.functions"} | keyword, report.text()
