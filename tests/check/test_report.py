"""Report of the check: order, counts, tools, the command, and the counts in the docs."""

import json
import re
from dataclasses import replace
from pathlib import Path

import pytest
from kit.mistakes import refused

from check.good import Good
from check.test_binaries import FAULTS as BINARY_FAULTS
from check.test_faults import FAULTS
from check.test_probes import PLANTED
from orchestrator.__main__ import main
from orchestrator.check.checking import RULES, check
from orchestrator.check.finding import SEVERITIES, Finding, error
from orchestrator.check.report import MAX_PRINTED, TOOLS, CheckReport, table
from orchestrator.check.rules import STATIC
from orchestrator.check.subject import open_subject

DOCS = Path(__file__).parents[2] / "docs/check.md"
# rules on whole files, or with findings of another rule at the same time; separate tests cover them
ELSEWHERE = {
    "archive.zip", "archive.link", "archive.method", "archive.size", "archive.suffix",
    "archive.description", "binary.documented", "contents.size", "identity.identifier",
    "identity.keyword", "identity.same", "python.needed", "python.packages", "version.new",
}  # fmt: skip


@pytest.fixture
def bad(good: Good, tmp_path: Path) -> Path:
    """An FMU with an error, a warning and a note."""
    simulation = '<CoSimulation modelIdentifier="lag"'
    broken = good[2].swap('<Real unit="1/s"', '<Real unit="Hz"').put("build.log", "")
    broken = broken.swap(simulation, f'{simulation} canBeInstantiatedOnlyOncePerProcess="true"')
    return broken.write(tmp_path / "bad.fmu")


def test_every_rule_has_a_planted_fault_and_an_id_of_its_own() -> None:
    """And a text; all verdicts of tools refer to existing rules."""
    planted = {f["rule"] for f in FAULTS} | {rule for rule, _, _ in BINARY_FAULTS.values()}
    assert {r.id for r in STATIC} - planted - ELSEWHERE == set()
    assert ELSEWHERE & planted == set()
    known = {r.id for r in RULES}
    assert len(known) == len(RULES)
    assert all(r.text and "." in r.id for r in RULES)
    assert {rule for tool in TOOLS.values() for rule in tool.verdicts} <= known


def test_an_error_has_a_clause(good: Good, tmp_path: Path) -> None:
    """Planted faults that are errors break a clause; without one, an error becomes a warning."""
    rules = {rule.id: rule for rule in RULES}
    errors = {f["rule"] for f in FAULTS if f.get("severity", "error") == "error"}
    errors |= {f"run.{probe}" for probe, _, more in PLANTED if more.get("severity", "error") == "error"}
    assert [rule for rule in errors if not rules[rule].clause] == []
    with open_subject(good[2].write(tmp_path / "lag.fmu")) as subject:
        for name, severity in (("name.mangled", "warning"), ("xml.schema", "error")):
            (found,) = replace(rules[name], check=lambda _: [error("x")])(subject)
            assert found.severity == severity


def test_the_worst_comes_first(bad: Path) -> None:
    """Errors, then warnings, then notes, and the counts at the end."""
    report = check(bad, run=False)
    assert [f.severity for f in report.findings] == list(SEVERITIES)
    text = report.text()
    assert text.index("\nerrors\n") < text.index("\nwarnings\n") < text.index("\nnotes\n")
    assert text.endswith("1 error, 1 warning, 1 note")


def test_a_finding_with_many_places_is_one_line(good: Good, tmp_path: Path) -> None:
    """The line has their number and the first names; the JSON file has all places, and rules are counted."""
    more = "".join(
        f'<ScalarVariable name="v{i}" valueReference="{i}"><Real unit="Hz{i}"/></ScalarVariable>'
        for i in range(10, 30)
    )
    archive = good[2].swap("</ModelVariables>", f"{more}</ModelVariables>")
    report = check(archive.write(tmp_path / "lag.fmu"), run=False)
    assert report.count("error") == 1
    (line,) = [line for line in report.text().splitlines() if "unit.undefined" in line]
    assert "v10: unit 'Hz10' is not in UnitDefinitions" in line
    assert "(and 19 more: v11, v12, v13, v14, v15 and 14 more)" in line
    (found,) = [f for f in json.loads(report.report().json())["findings"] if f["rule"] == "unit.undefined"]
    assert len(found["places"]) == 20
    assert "v29: unit 'Hz29'" in found["places"][-1]


def test_different_findings_of_a_rule_are_cut_in_the_text_report(bad: Path) -> None:
    """The text report has five messages of a rule, the JSON file all; they count once."""
    faults = tuple(Finding("xml.schema", "error", f"fault {i}") for i in range(20))
    report = CheckReport(bad, "", faults)
    assert report.count("error") == 1
    assert f"and {20 - MAX_PRINTED} more of this rule" in report.text()
    assert len(json.loads(report.report().json())["findings"]) == 20


def test_a_tool_raises_the_severity_of_a_finding(good: Good, tmp_path: Path) -> None:
    """Structured names give a note; for Simulink, which turns them into buses, a warning."""
    archive = good[2].drop("terminalsAndIcons/terminalsAndIcons.xml")
    for names in (("flat", "structured"), ('name="rate"', 'name="rate.y"'), ('name="u"', 'name="p.u"')):
        archive = archive.swap(*names)
    path = archive.write(tmp_path / "lag.fmu")
    reports = {tool: check(path, tool, run=False) for tool in ("any", "simulink", "dymola")}
    found = {t: [f.severity for f in r.findings if f.rule == "name.structured"] for t, r in reports.items()}
    assert found == {"any": ["note"], "simulink": ["warning"], "dymola": ["note"]}
    assert "makes buses" in reports["simulink"].text()
    assert "not by running the tool" in reports["simulink"].text()


def test_the_exit_status_depends_on_the_findings(bad: Path, good: Good, tmp_path: Path, capsys) -> None:
    """Exit status 0 without errors, 1 with errors, 2 for mistakes of the user."""
    fine = good[2].write(tmp_path / "fine.fmu")
    assert main(["check", str(fine), "--static"]) == 0
    assert "nothing found" in capsys.readouterr().out
    assert main(["check", str(bad), "--static", "--json", str(tmp_path / "found.json")]) == 1
    assert "errors" in capsys.readouterr().out
    assert json.loads((tmp_path / "found.json").read_text())["counts"] == dict.fromkeys(SEVERITIES, 1)
    mistakes = {(): "", ("gone.fmu",): "no such file", (".",): "got a folder", (fine, "--for", "matlab"): ""}
    for wrong, told in mistakes.items():
        message = refused(capsys, ["check", *wrong])
        assert message.startswith("harvester: ")
        assert told in message


def test_the_docs_count_the_rules_and_verdicts(capsys: pytest.CaptureFixture[str]) -> None:
    """docs/check.md states how many rules `--rules` prints, and each tool with its verdicts."""
    assert main(["check", "--rules"]) == 0
    printed = capsys.readouterr().out.strip()
    assert printed == table(RULES)
    running = sum(rule.id.startswith(("run.", "reference.")) for rule in RULES)
    text, total = DOCS.read_text("utf-8"), len(RULES)
    assert f"[{total} rules](reference/check-rules.md) {total - running} only read the FMU" in text
    assert f"{sum(bool(rule.threads) for rule in RULES)} rules name such threads" in text
    for id_, tool in TOOLS.items():
        assert f"|`{id_}`|{tool.name}|{tool.basis}|{len(tool.verdicts)}|" in text
    for name in re.findall(r"`(run\.\w+)`", text):
        assert name in printed, name
