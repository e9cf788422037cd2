"""Planted faults in files: each is reported by the rule for it, and by no other rule."""

import subprocess
import sys
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
from kit import shards
from kit.any_fmu.models import MODELS, Workshop

from check.good import DESCRIPTION, Archive, Good
from orchestrator.check.checking import check
from orchestrator.check.report import ANY, TOOLS

Fault = Mapping[str, Any]
FAULTS: list[Fault] = [  # the comment in the file explains the keys
    fault for faults in tomllib.loads(Path(__file__).with_suffix(".toml").read_text("utf-8")).values()
    for fault in faults
]  # fmt: skip
MEMBERS = {
    "xml": DESCRIPTION,
    "terminals": "terminalsAndIcons/terminalsAndIcons.xml",
    "build": "sources/buildDescription.xml",
}
EXPECTED = {2: set(), 3: {"version.new"}}  # findings of the valid FMU


def planted(fault: Fault, archive: Archive) -> Archive:
    """The FMU with the fault."""
    archive = archive.drop(*fault.get("drop", []))
    for name, content in fault.get("put", {}).items():
        archive = archive.put(name, content)
    if "add" in fault:
        archive = archive.swap("</ModelVariables>", f"{fault['add']}</ModelVariables>")
    for key, member in MEMBERS.items():
        for old, new in fault.get(key, []):
            archive = archive.swap(old, new, member)
    return archive


def new_findings(archive: Archive, path: Path) -> list[tuple[str, str, str]]:
    """Rule, severity and text of the findings that the valid FMU does not have."""
    report = check(archive.write(path / "lag.fmu"), run=False)
    return [(f.rule, f.severity, f.text) for f in report.findings if f.rule not in EXPECTED[archive.major]]


@pytest.mark.parametrize("fault", FAULTS, ids=[f"{f['name']}-{f.get('fmi', 2)}" for f in FAULTS])
def test_a_planted_fault_is_reported_by_its_rule_alone(good: Good, fault: Fault, tmp_path: Path) -> None:
    """One change of the valid FMU gives findings of one rule, with the right severity."""
    found = new_findings(planted(fault, good[fault.get("fmi", 2)]), tmp_path)
    assert {rule for rule, _, _ in found} == {fault["rule"], *fault.get("also", ())}, found
    assert fault.get("severity", "error") in {s for rule, s, _ in found if rule == fault["rule"]}
    assert any(fault["text"] in text for _, _, text in found), found


# ---- FMUs without faults have no findings


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


# ---- FMUs that need Python are reported


@pytest.fixture(scope="module")
def pump(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An FMU that PythonFMU built of a script that imports numpy."""
    folder = tmp_path_factory.mktemp("pump")
    (folder / "pump.py").write_text(Path(__file__).with_name("pump.txt").read_text("utf-8"))
    command = [sys.executable, "-m", "pythonfmu", "build", "-f", "pump.py", "-d", "."]
    subprocess.run(command, cwd=folder, check=True, capture_output=True)
    return folder / "Pump.fmu"


def test_it_needs_python_on_the_target(pump: Path) -> None:
    """The libraries of PythonFMU call Python and do not contain it; the finding has the evidence."""
    found = {f.rule: f for f in check(pump, run=False).findings}
    assert "needs Python on the target" in found["python.needed"].text
    assert "PythonFMU#192" in found["python.needed"].thread
    assert "Py" in found["binary.symbols"].text
    assert "numpy" in found["python.packages"].text
    assert "lacks y" in found["structure.initial"].text


@pytest.mark.parametrize("tool", ["simulink", "dymola", "amesim"])
def test_it_is_an_error_where_tools_fail_with_python(pump: Path, tool: str) -> None:
    """Needing Python is an error for tools with threads about crashes and failed starts."""
    report = check(pump, tool, run=False)
    assert report.failed
    assert "error" in {f.severity for f in report.findings if f.rule == "python.needed"}
