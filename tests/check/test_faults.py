"""Planted faults in files: each is reported by the rule for it, and by no other rule."""

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from check.good import DESCRIPTION, Archive, Good
from orchestrator.check.checking import check

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
