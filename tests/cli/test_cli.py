"""The command line on the machine itself: build, parameters, signals, run; validate: test_validate.py."""

import json
from pathlib import Path

import numpy as np
import pytest
from kit.mistakes import problem, refused, table

from fmus.contract import quantities
from fmus.machine.build import data
from fmus.machine.parts import FAMILIES, FERIC
from fmus.machine.poses import POSES
from orchestrator import read_trace
from orchestrator.__main__ import main
from orchestrator.base import files
from orchestrator.base.files import require

pytestmark = pytest.mark.usefixtures("here")


def test_build_makes_the_machine(built):
    """The FMUs, the system that connects them and all variants, for FMI 2.0 and 3.0, each with its size."""
    files = [*(f"{name}.fmu" for name in (*FERIC.components, "controller", "valve_actuation", "harvester"))]
    files += ["harvester.ssp", "harvester_actuation.ssp", "harvester_control.ssp"]
    files += [f"variants/{part}_{v}.fmu" for part, variants in FAMILIES.items() for v in variants]
    names = [*files, *(f"fmi3/{name}" for name in files)]
    printed = (built.parent / "machine.printed").read_text().splitlines()
    assert {Path(line.split()[0]) for line in printed} == {built / name for name in names}
    assert all((built / name).stat().st_size > 10_000 for name in names)


@table(__file__, "programs", "others, chosen, program")
def test_a_program_moves_the_machine_like_the_scenario_of_the_same_moves(capsys, others, chosen, program):
    """That of the system itself, or one chosen by name; what the scenario replaces is told, and what not."""
    run = ["run", "--stop", "2", "--record-step", "0.02"]
    assert main([*run, *chosen, "--out", "own.csv"]) == 0
    assert "scenario" not in capsys.readouterr().out
    assert main([*run, "--scenario", str(data(f"scenarios/{program}.csv")), "--out", "given.csv"]) == 0
    told = "replaces operator_input; inputs that are not in the scenario keep their start values: "
    kept = capsys.readouterr().out.partition(f"note: the scenario {told}")[2].partition("\n")[0].split(", ")
    assert set(kept) == {"manipulator.payload_mass", *others}
    own, given = (read_trace(name)["manipulator.boom_angle"] for name in ("own.csv", "given.csv"))
    assert np.ptp(own) > 0.1  # rad: it moves
    # the scenario has its commands to 1e-9 V, and the rounding of the clock
    np.testing.assert_allclose(own, given, rtol=0, atol=1e-9)


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


def test_signals_are_listed(capsys, fmu_dir):
    """Inputs that nothing feeds, and every variable with unit and text, in 100 columns."""
    assert main(["signals", str(fmu_dir / "harvester.fmu")]) == 0
    assert capsys.readouterr().out.startswith("harvester: inputs for --set and scenarios")
    assert main(["signals"]) == 0
    printed = capsys.readouterr().out.splitlines()
    assert max(map(len, printed)) <= 100
    # wrapped text is further in
    rows = [line.split() for line in printed if line[:2] == "  " and line[2:3].strip()]
    words = {row[0]: row[1:] for row in rows}
    assert words["supply.supply_pressure"][:5] == ["Pa", "Pressure", "of", "the", "supply"]
    assert words["manipulator.boom_angle"][:3] == ["rad", "Boom", "angle"]
    assert "from swing.swing_torque" in " ".join(" ".join(printed).split())
    assert main(["signals", "--kind", "parameter"]) == 0
    heads = [line for line in capsys.readouterr().out.splitlines() if line and not line.startswith(" ")]
    parts = ("manipulator", "supply", "boom_stick", "swing", "operator_input")
    assert heads == [f"{name}: parameters" for name in parts]


def printed_json(capsys, *command):
    """The rows of a list, which has the shape of all reports."""
    assert main([*command, "--json"]) == 0
    title, verdict, passed, rows = json.loads(capsys.readouterr().out).values()
    assert (verdict, passed) == (f"{len(rows)} {title.lower()}", None)
    return rows


def test_lists_as_data(capsys):
    """The rows of signals, parameters and variants, with units."""
    pressure = {"name": "supply.supply_pressure", "kind": "output", "unit": "Pa"}
    outputs = printed_json(capsys, "signals", "--kind", "output")
    assert [row for row in outputs if row.items() >= pressure.items()]
    assert {row["kind"] for row in printed_json(capsys, "signals")} == {"input", "output", "parameter"}
    (mass,) = (r for r in printed_json(capsys, "parameters", "manipulator") if r["name"] == "head_mass")
    assert (mass["value"], mass["unit"], mass["part"]) == (350.0, "kg", "manipulator")
    assert {r["source"] for r in printed_json(capsys, "parameters", "--source", "paper")} == {"paper"}
    found = {(r["part"], r["variant"]): r for r in printed_json(capsys, "variants")}
    assert found["swing", "lumped"]["states"] == len(quantities(FERIC.subsystems["swing"].states))


@pytest.mark.parametrize("only", [None, "swing", "boom_stick", "manipulator", "operator_input"])
def test_parameters_are_printed_with_their_sources(capsys, only):
    """One subsystem, or those of the machine; the words for the sources are explained."""
    assert main(["parameters", *([only] if only else [])]) == 0
    printed = capsys.readouterr().out
    for name in ("swing", "boom_stick", "manipulator", "operator_input"):
        shown = name == only or (only is None and name != "operator_input")
        assert (f"\n{name}: " in f"\n{printed}") is shown
    assert "printed in the paper" in printed


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


@table(__file__, "mistakes_are_one_line_and_status_2", "arguments, told")
def test_mistakes_are_one_line_and_status_2(capsys, arguments, told):
    """Named with what was expected and found, without a traceback."""
    Path("file.txt").write_text("", encoding="utf-8")
    printed = refused(capsys, arguments)
    assert printed.startswith("harvester: ")
    assert told in printed


def test_only_a_similar_file_is_proposed():
    """Of the same kind with most letters in common, or of another kind with the same name."""
    for name in ("other.csv", "open.csv"):
        Path("build", name).touch()
    meant = f"; did you mean {Path('build/other.csv')}?"
    unlike, like = ("nowhere.csv", "nope.parquet", "othr.parquet"), ("othr.csv", "othr", "other.parquet")
    for names, proposed in ((unlike, ""), (like, meant)):
        for name in names:
            told = problem(lambda name=name: require(name, (".csv", ".parquet")))
            assert told == f"{name}: no such file{proposed}"


@pytest.mark.parametrize("command", ["run", "validate"])
def test_a_machine_that_is_not_built_yet(capsys, command, monkeypatch):
    """The command that makes it is told."""
    monkeypatch.setattr(files, "CHECKOUT", Path("none"))
    missing = Path("build/harvester.ssp")
    missing.unlink()
    assert main([command]) == 2
    assert capsys.readouterr().err == f"harvester: {missing}: no such file; build it with: harvester build\n"


@table(__file__, "failing", "command, option")
def test_a_failure_in_mid_run_keeps_the_record(capsys, command, option):
    """A supply pressure beyond reason breaks the linkage: the record stays, the FMU's own words are told."""
    rows = "time,supply_pressure\n0,21e6\n0.1,21e6\n0.11,1e15\n0.5,1e15\n"
    Path("burst.csv").write_text(rows, encoding="utf-8")
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


def test_a_coupling_that_kills_the_run_is_named(capsys):
    """Jacobi at 10 ms, rate ports connected: the FMU that fails is not the cause, and the message says so."""
    assert main(["run", "--master", "jacobi", "--step", "0.01", "--out", "coarse.csv"]) == 2
    error = capsys.readouterr().err
    assert error.startswith("harvester: boom_stick: the step failed at t = ")
    assert "; likely cause: the coupling, jacobi with a step of 0.01 s (energy error " in error
    assert error.endswith("; use a shorter step or the master hermite\n")


def test_a_build_of_some_fmus(tmp_path, capsys):
    """Those whose names match, and no system, because a part of it is not built; a mistake names all FMUs."""
    out = tmp_path / "some"
    assert main(["build", "--fmi", "2", "--only", "supply", "--out", str(out)]) == 0
    files = {p.relative_to(out).as_posix() for p in out.rglob("*") if p.is_file()}
    assert files == {"supply.fmu", "variants/supply_ideal.fmu"}
    capsys.readouterr()
    assert main(["build", "--only", "pump", "--out", str(out)]) == 2
    assert "--only pump: expected the name of an FMU; there are " in capsys.readouterr().err
