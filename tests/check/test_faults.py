"""Planted faults in files: each is reported by the rule for it, and by no other rule."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import pytest

from check.faults import FILE_FAULTS, XML_FAULTS, Fault
from check.good import Archive
from orchestrator.check import check

EXPECTED = {2: set(), 3: {"version.new"}}  # findings of the valid FMU


def new_findings(archive: Archive, path: Path) -> list[tuple[str, str, str]]:
    """Rule, severity and text of the findings that the valid FMU does not have."""
    report = check(archive.write(path / "lag.fmu"), run=False)
    return [(f.rule, f.severity, f.text) for f in report.findings if f.rule not in EXPECTED[archive.major]]


@pytest.mark.parametrize("fault", [*FILE_FAULTS, *XML_FAULTS], ids=str)
def test_a_planted_fault_is_reported_by_its_rule_alone(
    good: Mapping[int, Archive], fault: Fault, tmp_path: Path
) -> None:
    """One change of the valid FMU gives findings of one rule, with the right severity."""
    found = new_findings(fault.break_(good[fault.major]), tmp_path)
    assert {rule for rule, _, _ in found} == {fault.rule}, found
    assert fault.severity in {severity for _, severity, _ in found}
    assert any(fault.text in text for _, _, text in found), found
