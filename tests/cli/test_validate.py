"""`harvester validate` on the machine itself."""

import io
import json
import shutil
from contextlib import redirect_stdout
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from cli.conftest import machine_in
from kit.mistakes import refused, table

from fmus.machine.build import data
from orchestrator import Trace, read_trace, write_trace
from orchestrator.__main__ import main

pytestmark = pytest.mark.usefixtures("here")
REFERENCE = data("reference/work_cycle.csv")


def own_reference(old: str = "", new: str = "") -> str:
    """A copy of the reference in the working directory, with one change in its meta file."""
    shutil.copy(REFERENCE, "own.csv")
    text = REFERENCE.with_suffix(".toml").read_text(encoding="utf-8")
    assert old in text
    Path("own.toml").write_text(text.replace(old, new, 1) if old else text, encoding="utf-8")
    return "own.csv"


def test_a_scenario_of_one_column_is_enough(capsys):
    """The operator lets go of all levers: inputs that no column drives are recorded at their start value."""
    Path("mine.csv").write_text("time,boom_command\n0,0\n0.1,0\n0.2,3\n", encoding="utf-8")
    options = ["--scenario", "mine.csv", "--reference", own_reference(), "--stop", "0.3"]
    assert main(["validate", *options]) == 1  # the reference's boom stands still up to there
    trace = read_trace("build/run.csv")
    assert not trace["swing.swing_command"].any()
    assert trace["boom_stick.boom_command"][-1] == 3.0
    page = Path("build/report.html").read_text(encoding="utf-8")
    assert "<title>mine against Work cycle, monolithic solution" in page
    printed = capsys.readouterr().out
    assert "--scenario" not in printed
    told = "replaces operator_input; inputs that are not in the scenario keep their start values: swing."
    assert f"note: the scenario {told}" in printed


@pytest.fixture(scope="module")
def plain(fmu_dir, tmp_path_factory):
    """What `harvester validate` prints of the first 2 s, and the folder in which it ran, without a rating."""
    folder, printed = tmp_path_factory.mktemp("plain"), io.StringIO()
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(printed):
        machine_in(folder, patch, fmu_dir)
        assert main(["validate", "--stop", "2"]) == 0
    return printed.getvalue(), folder


def test_an_own_reference_without_scenario_is_told_what_ran(capsys, plain):
    """In the terminal and in the report, whose title is not that of the project's own validation."""
    assert main(["validate", "--reference", own_reference(), "--stop", "0.2"]) == 0
    commands = "swing.swing_command, boom_stick.boom_command, boom_stick.stick_command"
    note = f"no --scenario given: {commands} are taken from the reference"
    assert f"note: {note}" in capsys.readouterr().out
    assert note in Path("build/report.json").read_text(encoding="utf-8")
    title = "<title>harvester against Work cycle, monolithic solution"
    assert title in Path("build/report.html").read_text(encoding="utf-8")
    printed, folder = plain
    assert "no --scenario given" not in printed
    assert "<title>Harvester, work cycle" in (folder / "build/report.html").read_text(encoding="utf-8")


def test_a_recording_without_commands_is_told_what_ran(capsys):
    """Nothing to play in it: the levers play their own program, and a note says so."""
    shutil.copy(REFERENCE, "own.csv")
    Path("own.toml").write_text('[signals."manipulator.boom_angle"]\nunit = "rad"\n', encoding="utf-8")
    assert main(["validate", "--reference", "own.csv", "--stop", "0.2"]) == 0
    assert "note: no --scenario given: the inputs are those of the system" in capsys.readouterr().out


@pytest.mark.parametrize("system", ["harvester.ssp", "harvester.fmu"])
def test_a_recording_plays_its_own_commands(system, fmu_dir, capsys):
    """In other units and moved in time: the run is that of the recording, whatever the levers would play."""
    time = np.arange(0.0, 2.0, 0.005)
    command = 1000.0 * np.interp(time, [0.5, 0.8, 1.4, 1.7], [0.0, 3.0, 3.0, 0.0])
    write_trace(Trace(time, {"BOOM": command, "ANGLE": np.full(time.size, 11.459)}), "own.csv")
    Path("own.toml").write_text(
        '[signals."boom_stick.boom_command"]\ncolumn = "BOOM"\nunit = "mV"\n'
        '[signals."manipulator.boom_angle"]\ncolumn = "ANGLE"\nunit = "deg"\n',
        encoding="utf-8",
    )
    assert main(["validate", str(fmu_dir / system), "--reference", "own.csv"]) == 0
    assert "is taken from the reference" in capsys.readouterr().out
    trace = read_trace("build/run.csv")
    own = "harvester" if system.endswith("fmu") else "boom_stick"
    at = np.interp(trace.time, time, command / 1000.0)
    # the trace is recorded on a grid of 5 ms, as the recording: exact but for rounding
    np.testing.assert_allclose(trace[f"{own}.boom_command"], at, atol=1e-9)
    assert trace.time[-1] == pytest.approx(time[-1], abs=1e-3)


def test_a_run_that_begins_elsewhere_than_the_recording_is_told(capsys):
    """A recording from another pose: a note says which joint stands elsewhere, and how far."""
    own = Path(own_reference())
    table = pd.read_csv(own)
    table["manipulator.boom_angle"] += 0.3
    table.to_csv(own, index=False)
    assert main(["validate", "--reference", str(own), "--stop", "0.2"]) == 1  # 0.3 rad is beyond the limit
    told = " ".join(capsys.readouterr().out.split())
    start = "the start of the run differs from the reference: manipulator.boom_angle by -0.3 rad;"
    assert f"note: {start}" in told


@pytest.mark.parametrize("system", ["harvester.ssp", "harvester.fmu"])
def test_a_recorded_supply_is_played_where_it_is_asked_for(system, fmu_dir, capsys):
    """One sensor for both drives: it goes in by --play, else it is compared with the ideal source."""
    time = np.arange(0.0, 0.5, 0.005)
    sagging = 200.0 - 20.0 * time
    write_trace(Trace(time, {"BOOM": np.zeros(time.size), "PS": sagging}), "own.csv")
    line = '[signals."{}.supply_pressure"]\ncolumn = "PS"\nunit = "bar"\n'
    both = "".join(map(line.format, ("swing", "boom_stick")))
    command = '[signals."boom_stick.boom_command"]\ncolumn = "BOOM"\nunit = "V"\n'
    Path("own.toml").write_text(command + both, encoding="utf-8")
    play = ["--play", "*.supply_pressure"]
    assert main(["validate", str(fmu_dir / system), "--reference", "own.csv", *play]) == 0
    trace = read_trace("build/run.csv")
    parts = ("harvester",) if system.endswith("fmu") else ("swing", "boom_stick")
    for part in parts:
        # recorded on the grid of the recording: exact but for rounding of 2e7 Pa
        np.testing.assert_allclose(trace[f"{part}.supply_pressure"], 1e5 * sagging, atol=1e-3)
    if len(parts) > 1:
        assert main(["validate", str(fmu_dir / system), "--reference", "own.csv"]) == 0
        assert np.ptp(read_trace("build/run.csv")["swing.supply_pressure"]) == 0
    capsys.readouterr()
    assert main(["validate", str(fmu_dir / system), "--reference", "own.csv", "--play", "*.presure"]) == 2
    assert "--play *.presure: expected a signal of own.csv" in capsys.readouterr().err


def test_wires_can_be_cut(capsys):
    """Without the rate ports the run is another one, and says so."""
    options = ["--stop", "0.1", "--cut", "*_rate", "--cut", "*_acceleration"]
    assert main(["validate", *options]) == 0  # the machine stands still
    kept = "these inputs keep their start values: manipulator.swing_torque_rate, "
    assert f"note: connections removed by --cut; {kept}" in capsys.readouterr().out
    assert '"cut": "*_rate, *_acceleration"' in Path("build/report.json").read_text(encoding="utf-8")


def test_validation_tells_the_sets_and_what_they_change(plain):
    """Among the facts; bound sets that repeat the FMUs' own values count as no change."""
    unchanged = json.loads((plain[1] / "build/report.json").read_text())["parameters"]
    assert not any(p["changed"] for p in unchanged)
    assert main(["validate", "--stop", "0.1", "--parameters", "still"]) == 0
    report = json.loads(Path("build/report.json").read_text())
    assert "still" in str(report["facts"])
    changed = {p["name"] for p in report["parameters"] if p["changed"]}
    assert "boom_1_command" in changed
    assert "boom_10_command" not in changed


def test_validate_passes_and_writes_its_files(plain):
    """Exit status 0; trace and report in build/, the trace at 200 Hz, compared where the samples coincide."""
    printed, folder = plain
    assert printed.startswith("Compared with: Work cycle, monolithic solution\n")
    assert "pass: 146 of 146 signals within their limits" in printed
    assert "compared at the 101 samples of the reference, 0 to 2 s" in printed
    assert "interpolated" not in printed
    assert "build/run.csv: 157 signals, 401 rows, every 0.005 s" in Path(printed).as_posix()
    assert all((folder / "build" / name).is_file() for name in ("report.html", "report.json"))
    time = read_trace(folder / "build/run.csv").time
    # point n is n times the step: rounding only
    np.testing.assert_allclose(time, np.arange(401) * 5e-3, rtol=0, atol=1e-15)


def test_a_changed_machine_misses_its_limits(capsys):
    """Exit status 1; the first lines say which signals missed what; the report is written."""
    options = ["--stop", "2", "--set", "manipulator.boom_piston_damping=1e5", "--out", "new"]
    assert main(["validate", *options]) == 1
    printed = capsys.readouterr().out.splitlines()
    assert printed[0] == "manipulator.boom_piston_damping is 100000 N.s/m"
    assert any(line.startswith("FAIL: ") for line in printed)
    assert any(line.startswith("! manipulator.dissipated_power: NRMSE ") for line in printed)
    assert Path("new/report.html").is_file()
    assert "set manipulator.boom_piston_damping" in Path("new/report.json").read_text(encoding="utf-8")


def test_all_options_reach_the_validation(capsys):
    """Master, step, record step, start, scenario, layout."""
    rows = "time,swing_command,boom_command,stick_command\n0,0,0,0\n9,0,0,0\n"
    Path("flat.csv").write_text(rows, encoding="utf-8")
    Path("l.toml").write_text('title = "Mine"', encoding="utf-8")
    options = ["--master", "jacobi", "--step", "2e-3", "--record-step", "0.02", "--stop", "0.5"]
    options += ["--scenario", "flat.csv", "--layout", "l.toml", "--reference", own_reference()]
    assert main(["validate", "build/harvester.ssp", *options]) == 0
    printed = capsys.readouterr().out
    assert "master jacobi, step 0.002 s, 250 steps, 0.5 s simulated" in printed
    assert "26 rows, every 0.02 s" in printed
    assert "<title>Mine" in Path("build/report.html").read_text(encoding="utf-8")


def test_validate_needs_no_trace(capsys):
    """Against the monolithic solution of the FMUs: the same report, exit status 1 if a limit is missed."""
    options = ["validate", "--monolithic", "--set", "manipulator.head_mass=400", "--stop"]
    assert main([*options, "1.2"]) == 0
    printed = capsys.readouterr().out
    assert "Compared with: Monolithic solution of the FMUs\n" in printed
    assert "pass: 153 of 153 signals within their limits" in printed
    assert "note: reference: monolithic solution: " in printed
    assert "computed with the shipped parameter values" not in printed
    report = json.loads(Path("build/report.json").read_text(encoding="utf-8"))
    assert report["facts"]["reference"] == "Monolithic solution of the FMUs"
    assert main([*options, "0.2", "--limit", "1e-12"]) == 1
    assert "! manipulator.stick_acceleration: NRMSE " in capsys.readouterr().out


@table(__file__, "a_bad_reference_is_told", "old, new, told")
def test_a_bad_reference_is_told(capsys, old, new, told):
    """File, signal, expected and found, before anything is simulated."""
    assert told in refused(capsys, ["validate", "--stop", "0.1", "--reference", own_reference(old, new)])
    assert not list(Path("build").glob("run*"))


def test_what_cannot_be_compared_is_told_before_the_run(capsys):
    """A signal that the machine lacks, times that the run does not reach, a figure of an unknown signal."""
    own_reference()
    for file, count in ((Path("own.csv"), 1), (Path("own.toml"), -1)):
        text = file.read_text("utf-8")
        file.write_text(text.replace("manipulator.boom_speed", "manipulator.speed", count), "utf-8")
    layout = '[[figure]]\ntitle = "A"\npanels = [{ label = "B", signals = ["swing.nothing"] }]\n'
    Path("own.layout.toml").write_text(layout, "utf-8")
    for options, told in (
        (["--reference", "own.csv"], "own.csv: no signal manipulator.speed in the run"),
        (["--start", "50", "--stop", "50.1"], "expected two or more samples in a common window"),
        (["--layout", "own.layout.toml"], "own.layout.toml: figure 'A': no signal swing.nothing in the run"),
    ):
        assert told in refused(capsys, ["validate", "--stop", "0.1", *options])
        assert not list(Path("build").glob("run*"))
