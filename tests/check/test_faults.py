"""Planted faults: each is told by the rule that is meant for it, and by no other."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import pytest

from check.faults import FILE_FAULTS, XML_FAULTS, Fault
from check.good import Archive
from orchestrator.check import check

KNOWN = {2: set(), 3: {"version.new"}}  # what the good FMU gives


def told(archive: Archive, path: Path) -> list[tuple[str, str, str]]:
    """Rule, severity and text of what is found beyond the good FMU's."""
    report = check(archive.write(path / "lag.fmu"), run=False)
    return [(f.rule, f.severity, f.text) for f in report.findings if f.rule not in KNOWN[archive.major]]


@pytest.mark.parametrize("fault", [*FILE_FAULTS, *XML_FAULTS], ids=str)
def test_a_planted_fault_is_told_by_its_rule_alone(
    good: Mapping[int, Archive], fault: Fault, tmp_path: Path
) -> None:
    """One change to the good FMU gives findings of the one rule that is about it, as bad as it is."""
    found = told(fault.break_(good[fault.major]), tmp_path)
    assert {rule for rule, _, _ in found} == {fault.rule}, found
    assert fault.severity in {severity for _, severity, _ in found}
    assert any(fault.says in text for _, _, text in found), found
