"""`make matrix` on fake tools: what it writes was measured, and what goes wrong is one cell of a table."""

import os
import sys
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from kit import shards
from kit.mistakes import table as table_of
from kit.needs import lacks, needs
from kit.wait import LONG, runs, until
from lxml import etree

from benchmarks.matrix import __main__ as matrix
from benchmarks.matrix import present, single, systems, tools
from benchmarks.matrix.cells import percent, remark, table, two
from benchmarks.matrix.present import GAUSS_SEIDEL, JACOBI, OURS, PARTS, Tool
from benchmarks.matrix.running import Outcome, carried_out, ran
from benchmarks.matrix.systems import DIVERGES, OPEN, SIGNALS, WIRED, Row, by_tool, judged

SSD = "http://ssp-standard.org/SSP1/SystemStructureDescription"


@pytest.fixture
def program(tmp_path, monkeypatch):
    """Makes a program of a few lines of Python, and finds it on the search path."""
    if os.name == "nt":
        lacks("POSIX", "Windows starts no scripts by their first line")
    monkeypatch.setenv("PATH", f"{tmp_path}{os.pathsep}{os.environ['PATH']}")
    Tool.presence.cache_clear()  # of a program of the same name

    def make(text: str, name: str = "fake") -> str:
        file = tmp_path / name
        file.write_text(f"#!{sys.executable}\nimport os, sys, time, subprocess\n{text}\n")
        file.chmod(0o755)
        return name

    return make


def fake(command: str) -> Tool:
    """A tool whose own Python is a fake."""
    return Tool("fake", "Fake", command=command, module="fake", alone=((2, "CS"),), strokes=((2, "CS"),))


JOB = """
import json, pathlib
job = json.loads(pathlib.Path(sys.argv[-1]).read_text())
out = pathlib.Path(job["out"])
"""
GOOD = 'out.write_text("time,y\\n0,1\\n1,2\\n"); out.with_name("wall.txt").write_text("0.5")\n'


def test_numbers_have_two_digits():
    """Shares and speeds; from 1 on without a power of ten: 100 % is 100, not 1e+02."""
    shares, speeds = (0.0, 8.6e-5, 0.0149, 0.5, 0.994, 0.996, 1.0, 3.24), (0.0412, 2.4, 3.26, 83.6, 1234.5)
    assert [*map(percent, shares)] == ["0", "0.0086", "1.5", "50", "99", "100", "100", "324"]
    assert [*map(two, speeds)] == ["0.041", "2.4", "3.3", "84", "1200"]


@table_of(__file__, "remarks", "problem, text")
def test_a_message_fits_into_a_cell(problem, text):
    """One line, no bar, no folder of this machine, not too long."""
    assert remark(problem) == text


def test_a_table_is_written_between_its_marks(tmp_path):
    """The rest of the page stays."""
    page = tmp_path / "page.md"
    page.write_text("a\n<!-- matrix: t -->\nold\n<!-- end: t -->\nb\n")
    matrix.write(page, "t", table(("h",), [("1",)]))
    assert page.read_text() == "a\n<!-- matrix: t -->\n|h|\n|---|\n|1|\n<!-- end: t -->\nb\n"


def test_the_page_merges_versions_of_fmi_that_agree():
    """What differs only in version and time is one row; what diverges is in the table by tool alone."""
    good = {"speed": 0.1, "angle": 0.1, "pressure": 0.1}
    shown = [
        Row("X", 2, "jacobi", WIRED, "50", good),
        Row("X", 2, "jacobi", OPEN, DIVERGES),
        Row("X", 3, "jacobi", WIRED, "40", good),
        Row("Y", 2, "jacobi", WIRED, "no such file"),
        Row("Y", 3, "jacobi", WIRED, "no such tool"),
    ]
    merged = ("X", "2.0, 3.0", "jacobi", WIRED, "10", "10", "10", "50")
    assert matrix.on_page([row.cells for row in shown], 7) == [merged, shown[3].cells, shown[4].cells]
    sides = [("X", "2.0 CS", "1", "1 s"), ("X", "3.0 CS", "1", "2 s"), ("X", "3.0 ME", "1", "2 s")]
    assert matrix.on_page(sides, 3) == [("X", "2.0, 3.0 CS", "1", "1 s"), sides[2]]
    assert matrix.on_page(sides, None) == sides


def test_what_is_missing_is_told_in_one_line(tmp_path, monkeypatch):
    """A page that is not there or has no marks; a folder without FMUs, with what makes them."""
    (tmp_path / "page.md").write_text("no table")
    for name in ("page.md", "none.md"):
        with pytest.raises(SystemExit, match=rf"{name}: [^\n]*$"):
            matrix.write(tmp_path / name, "t", "")
    monkeypatch.setattr(sys, "argv", ["matrix", "--build", str(tmp_path)])
    with pytest.raises(SystemExit, match="no FMU there; `harvester build` makes them"):
        matrix.main()


def structure(wires) -> bytes:
    """An SSD with these wires, every other one with a child."""
    ends = [(*start.split("."), *end.split(".")) for start, end in wires]
    words = 'startElement="{}" startConnector="{}" endElement="{}" endConnector="{}"'
    child = '><ssd:ConnectionGeometry pointsX="0" pointsY="0"/></ssd:Connection>'
    text = [f"<ssd:Connection {words.format(*e)}{'/>' if n % 2 else child}" for n, e in enumerate(ends)]
    system = f'<ssd:System xmlns:ssd="{SSD}"><ssd:Connections>{"".join(text)}</ssd:Connections></ssd:System>'
    return system.encode()


def wires_of(content: bytes) -> list[tuple[str, str]]:
    """Its wires."""
    found = [c.attrib for c in etree.fromstring(content).iter("{*}Connection")]
    return [tuple(f"{c[f'{e}Element']}.{c[f'{e}Connector']}" for e in ("start", "end")) for c in found]


def test_open_rate_ports_lose_their_wires_and_no_other_does(tmp_path):
    """26 of 43 wires stay, and so do the other files."""
    system = tmp_path / "a.ssp"
    with zipfile.ZipFile(system, "w") as archive:
        archive.writestr("SystemStructure.ssd", structure(systems.WIRES))
        archive.writestr("resources/swing.fmu", "swing")
    with zipfile.ZipFile(systems.held(system, tmp_path)) as archive:
        left = wires_of(archive.read("SystemStructure.ssd"))
        assert archive.read("resources/swing.fmu") == b"swing"
    assert (len(systems.WIRES), len(left)) == (45, 28)
    assert left == list(systems.OPEN_WIRES)


def test_a_system_with_other_rate_ports_than_the_machine_is_refused():
    """Nobody would know what its row is about."""
    with pytest.raises(ValueError, match="16 connections to rate ports, expected 17"):
        systems.without_rates(structure(w for w in systems.WIRES if not w[1].endswith("boom_acceleration")))


def test_a_system_that_cannot_be_read_is_a_row(tmp_path):
    """Not the end of all rows."""
    (tmp_path / "harvester.ssp").write_text("junk")
    tool = Tool("fake", "Fake", command="no such program", module="fake", systems=(2,))
    rows = list(systems.systems([tool], tmp_path, tmp_path))
    assert [row.rates for row in rows] == [WIRED, OPEN]
    assert rows[1].remark == "harvester.ssp: File is not a zip file"


def row(rates: str, speed: float | None = None, said: str = "") -> Row:
    """One row of a tool."""
    errors = None if speed is None else dict.fromkeys(systems.KINDS, speed)
    return Row("X", 2, "jacobi", rates, said, errors)


@pytest.mark.parametrize(
    ("wired", "open_", "so"),
    [
        (row(WIRED, 1e-4), row(OPEN, 2e-3), "connect"),
        (row(WIRED, 1e-4), row(OPEN, said=DIVERGES), "connect"),
        (row(WIRED, 2e-3), row(OPEN, 1e-4), "leave open"),
        (row(WIRED, said=DIVERGES), row(OPEN, 1e-4), "leave open"),
        (row(WIRED, 1e-3), row(OPEN, 1.001e-3), "no difference"),
        (row(WIRED, said=DIVERGES), row(OPEN, said=DIVERGES), "neither works"),
        (row(WIRED, said="exit status 1"), row(OPEN, said="exit status 1"), "not measured"),
        (row(WIRED, said="not done in 900 s"), row(OPEN, said=DIVERGES), "not measured"),
        (row(WIRED, 1e-3), row(OPEN, said="2 errors in x"), "not measured"),
    ],
)
def test_advice_on_rate_ports_follows_from_two_measurements(wired, open_, so):
    """Of the same master; without both there is none."""
    assert by_tool([wired, open_]) == [("X", "jacobi", wired.speed, open_.speed, so)]
    other = by_tool([wired, replace(open_, master="gauss-seidel")])
    assert [line[-1] for line in other] == ["not measured"] * 2


def cycle(stop: float = systems.CYCLE, **change) -> Outcome:
    """The reference as the result of a tool, up to `stop`, with some columns changed."""
    truth = {n: systems.reference()[n] for n in ("time", *SIGNALS)} | change
    keep = truth["time"] <= stop
    return Outcome({n: c[keep] for n, c in truth.items()}, 2.0)


ANGLE, PRESSURE = systems.reference()["manipulator.boom_angle"], "swing.swing_pressure_a"
HALF = {"manipulator.boom_angle": ANGLE + 0.5 * np.ptp(ANGLE)}
GROWN = np.exp(16 * systems.reference()["time"])  # to 1e291
NO_NUMBER = np.where(np.arange(ANGLE.size) < 100, systems.reference()[PRESSURE], np.nan)


@pytest.mark.parametrize(
    ("run", "remark_", "errors"),
    [
        (cycle(), "21", {"speed": 0.0, "angle": 0.0, "pressure": 0.0}),
        (cycle(**HALF), "21", {"speed": 0.0, "angle": pytest.approx(0.5), "pressure": 0.0}),
        (cycle(**{SIGNALS[0]: GROWN}), DIVERGES, None),
        (cycle(**{SIGNALS[0]: np.where(GROWN > 1e200, np.inf, GROWN)}), DIVERGES, None),
        (cycle(12.0), "ends at 12 s", None),
        (cycle(**{PRESSURE: NO_NUMBER}), f"{PRESSURE} is nan at 2 s", None),
    ],
    ids=["perfect", "half off", "lost", "infinite", "early", "no number"],
)
def test_a_run_is_judged_by_the_reference(run, remark_, errors):
    """By its worst signal of each kind, with 42 s in 2 s as 21 times real time; or there is no accuracy."""
    assert judged(run) == (remark_, errors)


def outcome(y, wall: float = 0.5, stop: float = 1.0) -> Outcome:
    """Rows of one output over `stop` seconds."""
    return Outcome({"time": np.linspace(0.0, stop, len(y)), "y": np.array(y, dtype=float)}, wall)


def test_only_fmus_that_ran_count():
    """In deviation and wall time, if any; the others say why, those with one reason together."""
    tally, truth = single.Tally(), outcome([0, 1, 2])
    tally.add("good", outcome([0, 1, 4], wall=0.2), truth, {"y": 10.0})
    tally.add("nan", outcome([0, 1, np.nan]), truth, {"y": 10.0})
    tally.add("early", outcome([0, 1], stop=0.5), truth, {"y": 10.0})
    tally.add("broken", Outcome({}, 0.0, "2 errors"), truth, {"y": 10.0})
    tally.add("also", Outcome({}, 900.0, "2 errors"), truth, {"y": 10.0})
    tally.add("lone", outcome([0, 1, 2]), Outcome({}, 0.0, "x"), {"y": 10.0})
    told = "nan: y is nan at 1 s; early: ends at 0.5 s; broken, also: 2 errors; lone: our own run: x"
    assert tally.cells(6) == ("1 of 6", "0.2 (good.y)", "0.2 s", told)
    tally = single.Tally()
    tally.fail("a", "no")
    assert tally.cells(1) == ("0 of 1", "", "", "a: no")


def described(folder: Path, name: str) -> Path:
    """An FMU of nothing but a description with one output."""
    text = (
        '<fmiModelDescription fmiVersion="2.0" modelName="m" guid="g"><CoSimulation modelIdentifier="m"/>'
        '<ModelVariables><ScalarVariable name="y" valueReference="0" causality="output"><Real nominal="10"/>'
        '</ScalarVariable></ModelVariables><ModelStructure><Outputs><Unknown index="1"/></Outputs>'
        "</ModelStructure></fmiModelDescription>"
    )
    with zipfile.ZipFile(folder / name, "w") as archive:
        archive.writestr("modelDescription.xml", text)
    return folder / name


def pressures(y, stop: float = single.STROKE, wall: float = 1.5) -> Outcome:
    """A stroke of which one pressure is known and another one hardly moves."""
    moved = {"time": np.linspace(0.0, stop, len(y)), "boom_head_pressure": np.array(y, dtype=float)}
    return Outcome(moved | {"swing_pressure_a": 1e-3 * moved["boom_head_pressure"]}, wall)


TWICE = pressures([0, 5, 10, 0])  # rows at one time: FMPy has two at an event
TWICE.rows["time"][:] = (0.0, 3.0, 3.0, 6.0)


@pytest.mark.parametrize(
    ("own", "found", "cells"),
    [
        (pressures([0, 10, 0]), pressures([0, 12, 0]), ("20", "12", "1.5 s")),  # a fifth, in one of 3
        (pressures([0, 10, 0]), pressures([0, np.nan, 0]), ("", "", "boom_head_pressure is nan at 3 s")),
        (pressures([0, 10, 0]), TWICE, ("0", "0", "1.5 s")),
    ],
    ids=["off", "no number", "of rows at one time the last counts"],
)
def test_a_stroke_is_compared_with_our_own(tmp_path, monkeypatch, own, found, cells):
    """At both intervals, if it has numbers; of rows at one time the last one counts."""
    monkeypatch.setattr(single, "carried_out", lambda tool, *_, **__: own if tool is OURS else found)
    rows = list(single.strokes([fake("fake")], tmp_path, tmp_path))
    assert rows == [("Fake", "2.0 CS", f"{ms} ms", *cells) for ms in (1, 10)]


def test_rows_of_what_did_not_run(tmp_path, monkeypatch):
    """Without our own stroke one row says why; of a folder the other FMUs run."""
    monkeypatch.setattr(single, "carried_out", lambda *_, **__: Outcome({}, 0.0, "no such file"))
    rows = list(single.strokes([fake("fake")], tmp_path, tmp_path))
    assert rows == [("harvester-cosim", "2.0 CS", "1 ms", "", "", "no such file")]
    described(tmp_path, "good.fmu")
    (tmp_path / "junk.fmu").write_text("junk")
    monkeypatch.setattr(single, "carried_out", lambda *_, **__: outcome([0, 1, 2]))
    rows = list(single.alone([fake("fake")], tmp_path, tmp_path))
    assert rows == [("Fake", "2.0 CS", "1 of 2", "0", "0.5 s", "junk: File is not a zip file")]


def test_a_job_gives_rows_and_wall_time_whatever_the_program_prints(program, tmp_path):
    """The time comes by a file."""
    found = carried_out(fake(program(f'{JOB}{GOOD}print("0.5\\nbye")')), tmp_path)
    assert (found.problem, found.wall) == ("", 0.5)
    np.testing.assert_array_equal(found.rows["y"], [1, 2])


@table_of(__file__, "failing_jobs", "text, problem")
def test_a_job_that_fails_says_why(program, tmp_path, text, problem):
    """And has no rows."""
    text = text.replace("{JOB}", JOB).replace("{GOOD}", GOOD)
    found = carried_out(fake(program(text)), tmp_path)
    assert (dict(found.rows), found.problem) == ({}, problem)


def test_a_program_that_cannot_be_started_fails(tmp_path):
    """With the words of the system."""
    ended = ran([str(tmp_path / "none")], 1.0)
    assert ended.status == 127
    assert ended.reason == ended.err != ""


@needs("Linux", "looks into /proc")
@pytest.mark.parametrize("end", shards.few([""], ["time.sleep(600)", ""], shards.faults))
def test_a_job_leaves_no_process_behind(program, tmp_path, end):
    """What it has started ends with it, and would else disturb the times of the next job."""
    child = 'subprocess.Popen(["sleep", "600"])'
    note = f"pathlib.Path({str(tmp_path / 'child')!r}).write_text(str({child}.pid))"
    found = carried_out(fake(program(f"import pathlib\n{note}\n{end}")), tmp_path, limit=5.0 if end else LONG)
    assert found.problem == ("not done in 5 s" if end else "ends without rows")
    number = int((tmp_path / "child").read_text())
    assert until(lambda: not runs(number))


@table_of(__file__, "versions", "text, version")
def test_a_program_tells_its_version(program, text, version):
    """By one of three options."""
    assert Tool("fake", "Fake", command=program(text)).presence().version == version


@table_of(__file__, "no_start", "text, module, problem")
def test_a_tool_that_does_not_start_is_not_run(program, monkeypatch, text, module, problem):
    """It says what it or Python says; nobody waits for it for ever."""
    monkeypatch.setattr(present, "ANSWER", 0.5 if "sleep" in text else LONG)
    found = Tool("fake", "Fake", command=program(text), module=module).presence()
    assert (found.version, found.problem) == ("", problem)


def test_what_is_not_here_is_not_run():
    """A program and a package."""
    for tool in (Tool("a", "A", command="no-such-program"), Tool("b", "B", package="no-such-package")):
        assert tool.presence().problem == "not found here"


def test_every_tool_has_a_runner_and_names_every_part_once():
    """By its key; in the orders of the masters whose result depends on it."""
    assert {t.key for t in present.TOOLS} == set(tools.RUNNERS)
    assert {JACOBI, GAUSS_SEIDEL} == set(OURS.masters)
    for master in (master for tool in present.TOOLS for master in tool.masters):
        assert sorted(master.order or PARTS) == sorted(PARTS)


def test_a_command_of_a_runner_gives_the_reason(program):
    """The first error in its log, also when it ends well; else what it said last."""
    for text, reason in (
        ('print("hello"); print("error: bad"); print("bye")', "error: bad"),
        ('print("hello"); sys.exit("out of memory")', "out of memory"),
        ("sys.exit(4)", "exit status 4"),
    ):
        with pytest.raises(RuntimeError, match=f"^{reason}$"):
            tools._command(program(text))
    tools._command(program('print("hello")'))
