"""What the user sees: order, counts, tools, the command, and the table of rules in the docs."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

import pytest

from check.faults import CS, FILE_FAULTS, STRUCTURED, XML_FAULTS, both, put, xml
from check.good import Archive
from check.test_binaries import FAULTS
from orchestrator.__main__ import main
from orchestrator.check import all_rules, check
from orchestrator.check.finding import SEVERITIES
from orchestrator.check.report import MAX_PRINTED, TOOLS, table
from orchestrator.check.rules import STATIC

DOCS = Path(__file__).parents[2] / "docs/check.md"
# told of files as a whole, or together with another rule: these have tests of their own
ELSEWHERE = {
    "archive.zip", "archive.link", "archive.method", "archive.size", "archive.suffix",
    "archive.description", "binary.documented", "contents.size", "fmpy.validate", "identity.identifier",
    "identity.keyword", "identity.same", "python.needed", "python.packages", "version.new",
}  # fmt: skip


@pytest.fixture
def bad(good: Mapping[int, Archive], tmp_path: Path) -> Path:
    """An FMU with an error, a warning and a note."""
    break_ = both(
        xml('stopTime="10"', 'stopTime="-1"'),
        xml(CS, f'{CS} canBeInstantiatedOnlyOncePerProcess="true"'),
        put("build.log", ""),
    )
    return break_(good[2]).write(tmp_path / "bad.fmu")


def test_every_rule_has_a_planted_fault() -> None:
    """A rule that no test triggers may as well be broken."""
    planted = {f.rule for f in (*FILE_FAULTS, *XML_FAULTS)} | {rule for rule, _, _ in FAULTS.values()}
    assert {r.id for r in STATIC} - planted - ELSEWHERE == set()
    assert ELSEWHERE & planted == set()


def test_rules_have_ids_of_their_own() -> None:
    """No two rules share an id, and each says what must hold."""
    everything = all_rules()
    assert len({r.id for r in everything}) == len(everything)
    assert all(r.text and "." in r.id for r in everything)


def test_verdicts_of_tools_are_about_rules() -> None:
    """A tool's verdict on a rule that does not exist would never show."""
    known = {r.id for r in all_rules()}
    assert {rule for tool in TOOLS.values() for rule in tool.verdicts} <= known


def test_the_worst_comes_first(bad: Path) -> None:
    """Errors, then warnings, then notes, and the counts at the end."""
    report = check(bad, run=False)
    assert [f.severity for f in report.findings] == list(SEVERITIES)
    text = report.text()
    assert text.index("\nerrors\n") < text.index("\nwarnings\n") < text.index("\nnotes\n")
    assert text.endswith("1 error, 1 warning, 1 note")


def test_many_findings_of_a_kind_are_cut_in_print(good: Mapping[int, Archive], tmp_path: Path) -> None:
    """A fault in each of many variables does not bury the rest; the file for programs has all."""
    more = "".join(
        f'<ScalarVariable name="v{i}" valueReference="{i}"><Real unit="Hz"/></ScalarVariable>'
        for i in range(10, 30)
    )
    archive = good[2].swap("</ModelVariables>", f"{more}</ModelVariables>")
    report = check(archive.write(tmp_path / "lag.fmu"), run=False)
    assert report.count("error") == 20
    assert f"and {20 - MAX_PRINTED} more of this rule" in report.text()
    assert len(json.loads(report.json())["findings"]) == len(report.findings)


def test_a_tool_makes_a_finding_worse(good: Mapping[int, Archive], tmp_path: Path) -> None:
    """Structured names are worth a note; in Simulink they become buses, which is worth a warning."""
    break_ = both(STRUCTURED, xml('name="rate"', 'name="rate.y"'), xml('name="u"', 'name="p.u"'))
    archive = break_(good[2]).drop("terminalsAndIcons/terminalsAndIcons.xml")
    path = archive.write(tmp_path / "lag.fmu")
    told = {tool: check(path, tool, run=False) for tool in ("any", "simulink", "dymola")}
    found = {t: [f.severity for f in r.findings if f.rule == "name.structured"] for t, r in told.items()}
    assert found == {"any": ["note"], "simulink": ["warning"], "dymola": ["note"]}
    assert "makes buses" in told["simulink"].text()
    assert "not by running the tool" in told["simulink"].text()


def test_the_command_tells_by_its_status(
    bad: Path, good: Mapping[int, Archive], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Exit status 0 without errors, 1 with errors, 2 for mistakes of the user."""
    fine = good[2].write(tmp_path / "fine.fmu")
    assert main(["check", str(fine), "--static"]) == 0
    assert "nothing found" in capsys.readouterr().out
    assert main(["check", str(bad), "--static", "--json", str(tmp_path / "found.json")]) == 1
    assert "errors" in capsys.readouterr().out
    assert json.loads((tmp_path / "found.json").read_text())["counts"] == {
        "error": 1,
        "warning": 1,
        "note": 1,
    }
    for wrong in (["check"], ["check", "gone.fmu"], ["check", str(fine), "--for", "matlab"]):
        assert main(wrong) == 2
        assert capsys.readouterr().err.startswith("harvester: ")


def test_the_docs_hold_the_table_of_rules(capsys: pytest.CaptureFixture[str]) -> None:
    """docs/check.md shows what `harvester check --rules` prints."""
    assert main(["check", "--rules"]) == 0
    printed = capsys.readouterr().out.strip()
    assert printed == table(all_rules())
    assert printed in DOCS.read_text("utf-8"), (
        "put the output of `harvester check --rules` into docs/check.md"
    )
