"""Files that are not valid FMUs give findings and never stop the check."""

import re
import zipfile
from pathlib import Path

import pytest
from kit.mistakes import table

from check.good import DESCRIPTION, Archive, Good
from orchestrator.check.checking import DEFECT, check

LFS_POINTER = "version https://git-lfs.github.com/spec/v1\n"


def rules(path: Path) -> set[str]:
    """Ids of all rules with findings; a rule that raises an exception fails the test."""
    found = {f.rule for f in check(path, run=False).findings}
    assert DEFECT not in found, check(path, run=False).text()
    return found


@pytest.mark.parametrize(
    "content", ["", "hello", "<fmiModelDescription/>", f"PK\3\4{100 * chr(0)}", LFS_POINTER]
)
def test_a_file_that_is_no_archive_gives_a_finding(content: str, tmp_path: Path) -> None:
    """A file that cannot be unpacked is reported by one rule, and no probe runs."""
    path = tmp_path / "lag.fmu"
    path.write_text(content)
    assert {f.rule for f in check(path).findings} == {"archive.zip"}


@table(__file__, "descriptions", "text, rule")
def test_nonsense_in_the_description_gives_findings(text: str, rule: str, tmp_path: Path) -> None:
    """Any text as modelDescription.xml ends in findings."""
    path = Archive(2, {DESCRIPTION: text.encode()}).write(tmp_path / "lag.fmu")
    assert rule in rules(path)


@table(__file__, "no_description", "members, text")
def test_an_archive_without_description_is_told(members: list[str], text: str, tmp_path: Path) -> None:
    """The path of a description, if the FMU was zipped with its folder; the command that runs an SSP."""
    path = Archive(2, dict.fromkeys(members, b"<a/>")).write(tmp_path / "lag.fmu")
    (found,) = [f for f in check(path, run=False).findings if f.severity == "error"]
    assert found.rule == "archive.description"
    assert re.search(text, found.text)


def test_an_unknown_encoding_is_no_defect_of_the_check(good: Good, tmp_path: Path) -> None:
    """The probes are left out with a reason, as for any description that cannot be read."""
    path = good[2].swap('encoding="UTF-8"', 'encoding="abc"').write(tmp_path / "lag.fmu")
    found = {f.rule for f in check(path).findings}
    assert "xml.syntax" in found
    assert DEFECT not in found


@pytest.mark.parametrize("exponent", ["nan", "inf", "1e400", "abc", ""])
def test_an_exponent_that_is_no_number_is_wrong(good: Good, exponent: str, tmp_path: Path) -> None:
    """Any text as an exponent of a unit is a finding on the unit."""
    broken = good[2].swap('<BaseUnit s="1"/>', f'<BaseUnit s="{exponent}"/>')
    assert {"xml.schema", "unit.wrong"} <= rules(broken.write(tmp_path / "lag.fmu"))


@pytest.mark.filterwarnings("ignore:Duplicate name")
@table(__file__, "members", "name, attributes, rule")
def test_a_forbidden_member_is_reported(good: Good, name: str, attributes: int, rule: str, tmp_path: Path):
    """Symbolic links, and two members with one name."""
    path, member = good[2].write(tmp_path / "lag.fmu"), zipfile.ZipInfo(name)
    member.external_attr = attributes
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr(member, "/etc/passwd")
    assert rules(path) == {rule}


def test_a_dot_in_the_path_of_a_source_is_no_fault(good: Good, tmp_path: Path) -> None:
    """OpenModelica lists its sources so."""
    listed = good[2].members[DESCRIPTION].replace(b'<File name="lag.c"/>', b'<File name="./lag.c"/>')
    assert rules(good[2].put(DESCRIPTION, listed).write(tmp_path / "lag.fmu")) == set()


def test_an_fmu_of_fmi_1_gives_one_warning(good: Good, tmp_path: Path) -> None:
    """Rules of FMI 2.0 and 3.0 are not applied to it, and nothing is run."""
    report = check(good[2].swap('fmiVersion="2.0"', 'fmiVersion="1.0"').write(tmp_path / "lag.fmu"))
    assert [(f.rule, f.severity) for f in report.findings] == [("version.known", "warning")]
    assert report.title == "FMI 1.0"


def test_suffix_and_size_are_noted(good: Good, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Tools open .fmu files, and unpack one for each model or instance."""
    assert rules(good[2].write(tmp_path / "lag.zip")) == {"archive.suffix"}
    monkeypatch.setattr("orchestrator.check.rules.archive.MAX_SIZE", 1000)
    assert rules(good[2].write(tmp_path / "lag.fmu")) == {"contents.size"}
