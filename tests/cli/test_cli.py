"""The command line on the machine itself: build, parameters, run, validate."""

from __future__ import annotations

import json
import shutil
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from kit.mistakes import refused, table

from fmus.machine.build import data
from fmus.machine.parts import ALL, FAMILIES
from fmus.machine.poses import POSES
from orchestrator import Trace, read_trace, write_trace
from orchestrator.__main__ import main
from orchestrator.results import validate_system

REFERENCE = data("reference/work_cycle.csv")


@pytest.fixture
def here(tmp_path, monkeypatch, fmu_dir):
    """A working directory with build/harvester.ssp; no ISO rating, whose library takes seconds to start."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(
        validate_system, "validate_system", partial(validate_system.validate_system, rate=False)
    )
    (tmp_path / "build").mkdir()
    shutil.copy(fmu_dir / "harvester.ssp", "build")
    return tmp_path


def own_reference(old: str = "", new: str = "") -> str:
    """A copy of the reference in the working directory, with one change in its meta file."""
    shutil.copy(REFERENCE, "own.csv")
    text = REFERENCE.with_suffix(".toml").read_text(encoding="utf-8")
    assert old in text
    Path("own.toml").write_text(text.replace(old, new, 1) if old else text, encoding="utf-8")
    return "own.csv"


def test_build_makes_the_machine(built):
    """The FMUs, the system that connects them and all variants, for FMI 2.0 and 3.0, each with its size."""
    files = [*(f"{name}.fmu" for name in (*ALL, "controller", "harvester"))]
    files += ["harvester.ssp", "harvester_control.ssp"]
    files += [f"variants/{part}_{v}.fmu" for part, variants in FAMILIES.items() for v in variants]
    names = [*files, *(f"fmi3/{name}" for name in files)]
    printed = (built.parent / "machine.printed").read_text().splitlines()
    assert {Path(line.split()[0]) for line in printed} == {built / name for name in names}
    assert all((built / name).stat().st_size > 10_000 for name in names)


@pytest.mark.usefixtures("here")
def test_the_built_system_plays_the_work_cycle_by_itself(capsys):
    """Without scenario the levers move the machine, as the scenario of the same moves does."""
    assert main(["run", "--stop", "2", "--record-step", "0.02", "--out", "own.csv"]) == 0
    assert "scenario" not in capsys.readouterr().out
    scenario = ["--scenario", str(data("scenarios/work_cycle.csv"))]
    assert main(["run", "--stop", "2", "--record-step", "0.02", "--out", "given.csv", *scenario]) == 0
    note = (
        "operator_input; inputs that are not in the scenario keep their start values: "
        "manipulator.payload_mass\n"
    )
    assert f"note: the scenario replaces {note}" in capsys.readouterr().out
    own, given = (read_trace(name)["manipulator.boom_angle"] for name in ("own.csv", "given.csv"))
    assert np.ptp(own) > 0.1  # rad: it moves
    np.testing.assert_allclose(own, given, rtol=0, atol=1e-9)  # the scenario has its commands to 1e-9 V


def test_parameters_of_one_source(capsys):
    """Only those, and how many of all they are."""
    assert main(["parameters", "--source", "paper"]) == 0
    printed = capsys.readouterr().out
    assert "the only data of the FERIC machine" in printed
    table = printed[: printed.index("paper       printed")]
    rows = [line.split()[-1] for line in table.splitlines() if line and not line.startswith(" ")]
    assert set(rows) - {"paper"} <= {"gear", "cylinders"}  # ends of the headlines
    assert main(["parameters"]) == 0
    whole = capsys.readouterr().out.splitlines()[-1]
    total = whole.split()[0]
    assert printed.splitlines()[-1] == f"{rows.count('paper')} of {total} numbers: paper"
    assert f"{total} numbers: {rows.count('paper')} paper, " in whole


@pytest.mark.usefixtures("here")
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
    assert (
        "note: the scenario replaces operator_input; inputs that are not in the scenario keep their "
        "start values: swing."
    ) in printed


@pytest.mark.usefixtures("here")
def test_an_own_reference_without_scenario_is_told_what_ran(capsys):
    """In the terminal and in the report, whose title is not that of the project's own validation."""
    assert main(["validate", "--reference", own_reference(), "--stop", "0.2"]) == 0
    commands = "swing.swing_command, boom_stick.boom_command, boom_stick.stick_command"
    note = f"no --scenario given: {commands} is taken from the reference"
    assert f"note: {note}" in capsys.readouterr().out
    assert note in Path("build/report.json").read_text(encoding="utf-8")
    title = "<title>harvester against Work cycle, monolithic solution"
    assert title in Path("build/report.html").read_text(encoding="utf-8")
    assert main(["validate", "--stop", "0.2"]) == 0
    assert note not in capsys.readouterr().out
    assert "<title>Harvester, work cycle" in Path("build/report.html").read_text(encoding="utf-8")


@pytest.mark.usefixtures("here")
def test_a_recording_without_commands_is_told_what_ran(capsys):
    """Nothing to play in it: the levers play their own program, and a note says so."""
    shutil.copy(REFERENCE, "own.csv")
    Path("own.toml").write_text('[signals."manipulator.boom_angle"]\nunit = "rad"\n', encoding="utf-8")
    assert main(["validate", "--reference", "own.csv", "--stop", "0.2"]) == 0
    assert "note: no --scenario given: the inputs are those of the system" in capsys.readouterr().out


@pytest.mark.usefixtures("here")
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
    shutil.copy(fmu_dir / "harvester.fmu", "build/harvester.fmu")
    assert main(["validate", f"build/{system}", "--reference", "own.csv"]) == 0
    assert "is taken from the reference" in capsys.readouterr().out
    trace = read_trace("build/run.csv")
    own = "harvester" if system.endswith("fmu") else "boom_stick"
    at = np.interp(trace.time, time, command / 1000.0)
    # the trace is recorded on a grid of 5 ms, as the recording: exact but for rounding
    np.testing.assert_allclose(trace[f"{own}.boom_command"], at, atol=1e-9)
    assert trace.time[-1] == pytest.approx(time[-1], abs=1e-3)


@pytest.mark.usefixtures("here")
def test_a_run_that_begins_elsewhere_than_the_recording_is_told(capsys):
    """A recording from another pose: a note says which joint stands elsewhere, and how far."""
    own = Path(own_reference())
    table = pd.read_csv(own)
    table["manipulator.boom_angle"] += 0.3
    table.to_csv(own, index=False)
    assert main(["validate", "--reference", str(own), "--stop", "0.2"]) == 1  # 0.3 rad is beyond the limit
    told = " ".join(capsys.readouterr().out.split())
    assert (
        "note: the start of the run differs from the reference: manipulator.boom_angle by -0.3 rad;" in told
    )


@pytest.mark.usefixtures("here")
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
    shutil.copy(fmu_dir / "harvester.fmu", "build/harvester.fmu")
    play = ["--play", "*.supply_pressure"]
    assert main(["validate", f"build/{system}", "--reference", "own.csv", *play]) == 0
    trace = read_trace("build/run.csv")
    parts = ("harvester",) if system.endswith("fmu") else ("swing", "boom_stick")
    for part in parts:
        # recorded on the grid of the recording: exact but for rounding of 2e7 Pa
        np.testing.assert_allclose(trace[f"{part}.supply_pressure"], 1e5 * sagging, atol=1e-3)
    if len(parts) > 1:
        assert main(["validate", f"build/{system}", "--reference", "own.csv"]) == 0
        assert np.ptp(read_trace("build/run.csv")["swing.supply_pressure"]) == 0
    capsys.readouterr()
    assert main(["validate", f"build/{system}", "--reference", "own.csv", "--play", "*.presure"]) == 2
    assert "--play *.presure: expected a signal of own.csv" in capsys.readouterr().err


@pytest.mark.usefixtures("here")
def test_signals_are_listed(capsys, fmu_dir):
    """Inputs that nothing feeds, and every variable with unit and text, in 100 columns."""
    assert main(["signals", str(fmu_dir / "harvester.fmu")]) == 0
    assert capsys.readouterr().out.startswith("harvester: inputs for --set and scenarios")
    assert main(["signals"]) == 0
    printed = capsys.readouterr().out.splitlines()
    assert max(map(len, printed)) <= 100
    rows = [
        line.split() for line in printed if line[:2] == "  " and line[2:3].strip()
    ]  # wrapped text is further in
    words = {row[0]: row[1:] for row in rows}
    assert words["supply.supply_pressure"][:5] == ["Pa", "Pressure", "of", "the", "supply"]
    assert words["manipulator.boom_angle"][:3] == ["rad", "Boom", "angle"]
    assert "from swing.swing_torque" in " ".join(" ".join(printed).split())
    assert main(["signals", "--kind", "parameter"]) == 0
    heads = [line for line in capsys.readouterr().out.splitlines() if line and not line.startswith(" ")]
    assert heads == [
        f"{name}: parameters" for name in ("manipulator", "supply", "boom_stick", "swing", "operator_input")
    ]


@pytest.mark.usefixtures("here")
def test_wires_can_be_cut(capsys):
    """Without the rate ports the run is another one, and says so."""
    options = ["--stop", "0.1", "--cut", "*_rate", "--cut", "*_acceleration"]
    assert main(["validate", *options]) == 0  # the machine stands still
    assert (
        "note: connections removed by --cut; these inputs keep their start values: "
        "manipulator.swing_torque_rate, "
    ) in (capsys.readouterr().out)
    assert '"cut": "*_rate, *_acceleration"' in Path("build/report.json").read_text(encoding="utf-8")


@pytest.mark.parametrize("only", [None, "swing", "boom_stick", "manipulator", "operator_input"])
def test_parameters_are_printed_with_their_sources(capsys, only):
    """One subsystem, or those of the machine; the words for the sources are explained."""
    assert main(["parameters", *([only] if only else [])]) == 0
    printed = capsys.readouterr().out
    for name in ("swing", "boom_stick", "manipulator", "operator_input"):
        shown = name == only or (only is None and name != "operator_input")
        assert (f"\n{name}: " in f"\n{printed}") is shown
    assert "printed in the paper" in printed


@pytest.mark.usefixtures("here")
def test_poses_and_programs_are_chosen_by_name():
    """Later sets win over earlier ones and over those that the system binds, --set over all."""
    options = ["--parameters", "raised", "--parameters", "still"]
    options += ["--set", "manipulator.initial_swing_angle=0.5"]
    assert main(["run", *options, "--stop", "1.5"]) == 0
    trace = read_trace("build/trace.csv")
    for name, angle in (("swing", 0.5), ("boom", POSES["raised"].boom), ("stick", POSES["raised"].stick)):
        # closed valves leak: below 0.3 mm of piston in 5 s, tests/whole_machine/test_machine.py
        np.testing.assert_allclose(trace[f"manipulator.{name}_angle"], angle, rtol=0, atol=5e-4)
    assert not trace["operator_input.boom_command"].any()


@pytest.mark.usefixtures("here")
def test_an_angle_is_set_by_its_parameter(capsys):
    """The start of an angle is calculated: one line says from which parameter."""
    assert main(["run", "--set", "manipulator.boom_angle=0.5"]) == 2
    told = capsys.readouterr().err.strip()
    assert told.endswith("that the FMU computes itself, at the start from initial_boom_angle")
    assert "\n" not in told


@pytest.mark.usefixtures("here")
def test_a_program_moves_the_machine_like_the_scenario_of_the_same_moves():
    """boom_up by name and as data/scenarios/boom_up.csv."""
    chosen = ["--parameters", "boom_up"], ["--scenario", str(data("scenarios/boom_up.csv"))]
    for name, options in zip(("a.csv", "b.csv"), chosen, strict=True):
        assert main(["run", *options, "--stop", "2", "--out", name]) == 0
    a, b = (read_trace(name)["manipulator.boom_angle"] for name in ("a.csv", "b.csv"))
    assert np.ptp(a) > 0.1  # rad: it moves
    np.testing.assert_allclose(a, b, rtol=0, atol=1e-9)  # the same numbers but for the clock's rounding


@pytest.mark.usefixtures("here")
def test_validation_tells_the_sets_and_what_they_change():
    """Among the facts; bound sets that repeat the FMUs' own values count as no change."""
    assert main(["validate", "--stop", "0.1"]) == 0
    assert not any(p["changed"] for p in json.loads(Path("build/report.json").read_text())["parameters"])
    assert main(["validate", "--stop", "0.1", "--parameters", "still"]) == 0
    report = json.loads(Path("build/report.json").read_text())
    assert "still" in str(report["facts"])
    changed = {p["name"] for p in report["parameters"] if p["changed"]}
    assert "boom_1_command" in changed
    assert "boom_10_command" not in changed


@pytest.mark.usefixtures("here")
def test_validate_passes_and_writes_its_files(capsys):
    """Exit status 0; trace and report in build/, the trace at 200 Hz, compared where the samples coincide."""
    assert main(["validate", "--stop", "2"]) == 0
    printed = capsys.readouterr().out
    assert printed.startswith("Compared with: Work cycle, monolithic solution\n")
    assert "pass: 27 of 27 signals within their limits" in printed
    assert "compared at the 101 samples of the reference, 0 to 2 s" in printed
    assert "interpolated" not in printed
    assert "build/run.csv: 130 signals, 401 rows, every 0.005 s" in Path(printed).as_posix()
    assert all(Path("build", name).is_file() for name in ("report.html", "report.json"))
    time = read_trace("build/run.csv").time
    # point n is n times the step: rounding only
    np.testing.assert_allclose(time, np.arange(401) * 5e-3, rtol=0, atol=1e-15)


@pytest.mark.usefixtures("here")
def test_the_reference_meets_the_record_over_the_whole_cycle():
    """Each of its samples at 50 Hz is one of the points that the default run records at 200 Hz."""
    time = np.loadtxt(REFERENCE, delimiter=",", skiprows=1, usecols=0)
    # both are decimal numbers to the nearest binary one, or a product of such: a few ulp of 42 s
    np.testing.assert_allclose(np.arange(0, 42001, 5)[::4] * 1e-3, time, rtol=0, atol=3e-14)


@pytest.mark.usefixtures("here")
def test_a_changed_machine_misses_its_limits(capsys):
    """Exit status 1; the first lines say which signals missed what; the report is written."""
    options = ["--stop", "2", "--set", "manipulator.boom_piston_damping=1e5", "--out", "new"]
    assert main(["validate", *options]) == 1
    printed = capsys.readouterr().out.splitlines()
    assert printed[0] == "manipulator.boom_piston_damping is 100000 N.s/m"
    assert any(line.startswith("FAIL: ") for line in printed)
    assert any(line.startswith("! manipulator.boom_angle: NRMSE ") for line in printed)
    assert Path("new/report.html").is_file()
    assert "set manipulator.boom_piston_damping" in Path("new/report.json").read_text(encoding="utf-8")


@pytest.mark.usefixtures("here")
def test_a_tighter_limit_is_missed(capsys):
    """The limits are those of the reference's meta file: exit status 1 if one is missed."""
    reference = own_reference("limit = 0.005", "limit = 1e-12")
    assert main(["validate", "--stop", "2", "--reference", reference]) == 1
    missed = [line for line in capsys.readouterr().out.splitlines() if line.startswith("! manipulator")]
    assert [line.split()[1] for line in missed if "limit 1e-10 %" in line] != []


@pytest.mark.usefixtures("here")
def test_all_options_reach_the_validation(capsys):
    """Master, step, record step, start, scenario, layout."""
    Path("flat.csv").write_text(
        "time,swing_command,boom_command,stick_command\n0,0,0,0\n9,0,0,0\n", encoding="utf-8"
    )
    Path("l.toml").write_text('title = "Mine"', encoding="utf-8")
    options = ["--master", "jacobi", "--step", "2e-3", "--record-step", "0.02", "--stop", "0.5"]
    options += ["--scenario", "flat.csv", "--layout", "l.toml", "--reference", own_reference()]
    assert main(["validate", "build/harvester.ssp", *options]) == 0
    printed = capsys.readouterr().out
    assert "master jacobi, step 0.002 s, 250 steps, 0.5 s simulated" in printed
    assert "26 rows, every 0.02 s" in printed
    assert "<title>Mine" in Path("build/report.html").read_text(encoding="utf-8")


@pytest.mark.usefixtures("here")
def test_validate_needs_no_trace(capsys):
    """Against the monolithic solution of the FMUs: the same report, exit status 1 if a limit is missed."""
    options = ["validate", "--monolithic", "--stop", "1.2", "--set", "manipulator.head_mass=400"]
    assert main(options) == 0
    printed = capsys.readouterr().out
    assert "Compared with: Monolithic solution of the FMUs\n" in printed
    assert "pass: 27 of 27 signals within their limits" in printed
    assert "note: reference: monolithic solution: " in printed
    assert "computed with the shipped parameter values" not in printed
    report = json.loads(Path("build/report.json").read_text(encoding="utf-8"))
    assert report["facts"]["reference"] == "Monolithic solution of the FMUs"
    assert main([*options, "--limit", "1e-12"]) == 1
    assert "! manipulator.boom_speed: NRMSE " in capsys.readouterr().out


@pytest.mark.usefixtures("here")
@table(__file__, "mistakes_are_one_line_and_status_2", "arguments, told")
def test_mistakes_are_one_line_and_status_2(capsys, arguments, told):
    """Named with what was expected and found, without a traceback."""
    Path("file.txt").write_text("", encoding="utf-8")
    printed = refused(capsys, arguments)
    assert printed.startswith("harvester: ")
    assert told in printed


@pytest.mark.usefixtures("here")
@table(__file__, "a_bad_reference_is_told", "old, new, told")
def test_a_bad_reference_is_told(capsys, old, new, told):
    """File, signal, expected and found, before anything is simulated."""
    assert told in refused(capsys, ["validate", "--stop", "0.1", "--reference", own_reference(old, new)])
    assert not list(Path("build").glob("run*"))


@pytest.mark.usefixtures("here")
def test_what_cannot_be_compared_is_told_before_the_run(capsys):
    """A signal that the machine lacks, times that the run does not reach, a figure of an unknown signal."""
    own_reference()
    Path("own.csv").write_text(
        Path("own.csv").read_text("utf-8").replace("manipulator.boom_speed", "manipulator.speed", 1), "utf-8"
    )
    text = Path("own.toml").read_text("utf-8")
    Path("own.toml").write_text(text.replace("manipulator.boom_speed", "manipulator.speed"), "utf-8")
    Path("own.layout.toml").write_text(
        '[[figure]]\ntitle = "A"\npanels = [{ label = "B", signals = ["swing.nothing"] }]\n', "utf-8"
    )
    for options, told in (
        (["--reference", "own.csv"], "own.csv: no signal manipulator.speed in the run"),
        (["--start", "50", "--stop", "50.1"], "expected two or more samples in a common window"),
        (["--layout", "own.layout.toml"], "own.layout.toml: figure 'A': no signal swing.nothing in the run"),
    ):
        assert told in refused(capsys, ["validate", "--stop", "0.1", *options])
        assert not list(Path("build").glob("run*"))


@pytest.mark.parametrize("command", ["run", "validate"])
def test_a_machine_that_is_not_built_yet(tmp_path, monkeypatch, capsys, command):
    """The command that makes it is told."""
    monkeypatch.chdir(tmp_path)
    assert main([command]) == 2
    missing = Path("build/harvester.ssp")
    assert capsys.readouterr().err == f"harvester: {missing}: no such file; build it with: harvester build\n"


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize(
    ("command", "option"), [("run", ["--out", "new/run.csv"]), ("validate", ["--out", "new"])]
)
def test_a_failure_in_mid_run_keeps_the_record(capsys, command, option):
    """A supply pressure beyond reason breaks the linkage: the record stays, the FMU's own words are told."""
    Path("burst.csv").write_text(
        "time,supply_pressure\n0,21e6\n0.1,21e6\n0.11,1e15\n0.5,1e15\n", encoding="utf-8"
    )
    assert main([command, "--scenario", "burst.csv", *option]) == 2
    printed = capsys.readouterr()
    assert not Path("new/run.csv").exists()
    trace = read_trace("new/run.partial.csv")
    assert 0.1 < trace.time[-1] < 0.5
    assert "the run ended early; the trace up to t = " in printed.out
    assert printed.err.startswith("harvester: manipulator: the step failed at t = ")
    assert "is violated" in printed.err
    assert printed.err.count("it says") == 1
    assert "likely cause" not in printed.err  # the coupling is not to blame


@pytest.mark.usefixtures("here")
def test_a_coupling_that_kills_the_run_is_named(capsys):
    """Jacobi at 10 ms, rate ports connected: the FMU that fails is not the cause, and the message says so."""
    assert main(["run", "--master", "jacobi", "--step", "0.01", "--out", "coarse.csv"]) == 2
    error = capsys.readouterr().err
    assert error.startswith("harvester: boom_stick: the step failed at t = ")
    assert "; likely cause: the coupling, jacobi with a step of 0.01 s (energy error " in error
    assert error.endswith("; use a shorter step or the master hermite\n")


def test_a_build_of_some_fmus(tmp_path, capsys):
    """Those whose names match, and no system, because a part of it is not built; a mistake names all FMUs."""
    assert main(["build", "--fmi", "2", "--only", "supply", "--out", str(tmp_path)]) == 0
    files = {p.relative_to(tmp_path).as_posix() for p in tmp_path.rglob("*") if p.is_file()}
    assert files == {"supply.fmu", "variants/supply_ideal.fmu"}
    capsys.readouterr()
    assert main(["build", "--only", "pump", "--out", str(tmp_path)]) == 2
    assert "--only pump: expected the name of an FMU; there are " in capsys.readouterr().err
