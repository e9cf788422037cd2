"""A value in the wrong unit gets one warning that proposes the right one; what is shipped gets none."""

import json
from dataclasses import replace
from functools import partial

import pytest
from kit import shards
from kit.every import MACHINES
from kit.mistakes import problem, refused, table

from fmus.identification.recordings.reading import doubtful
from fmus.machine.build import harvester_machine
from orchestrator import batch, compare, linearize, load, read_recording, read_trace, reference, run, validate
from orchestrator.__main__ import main
from orchestrator.base import files
from orchestrator.base.errors import Problem
from orchestrator.base.options import chosen
from orchestrator.base.units import doubt
from orchestrator.data.trace_writer import write_trace
from orchestrator.engine.job import Job
from orchestrator.engine.options import RunOptions
from orchestrator.results.comparison_report import report
from orchestrator.ssp.plausible import doubtful_signals
from orchestrator.ssp.system import System
from orchestrator.studies.parameter_study import prepare as prepare_study
from orchestrator.studies.study import Choice, Factor, Output, Study

# the parameters that pages, examples and studies set most often; boom_stroke is shared by two components
MOST_USED = (
    *("manipulator.head_mass", "supply.pressure_setting", "swing.motor_displacement", "swing.valve_area"),
    *(f"boom_stick.{name}" for name in ("valve_area", "boom_bore", "boom_hose_length", "bulk_modulus")),
    *("swing.valve_dead_band", "boom_stroke"),
)
COLUMNS = [
    (name, column)
    for name in ("boom_up", "line", "square", "work_cycle", "work_cycle_stems")
    for column, values in read_trace(name).signals.items()
    if values.any()  # zero is never doubtful
]


def warnings(system: System, *arguments, **options) -> tuple[str, ...]:
    """What a run would warn of before its first step."""
    return Job.of(system, *arguments, options=chosen(RunOptions, options, "run")).system.warnings


@pytest.fixture(scope="module")
def systems(built):
    """The machine without and with the controller, which follows the paths of `line` and `square`."""
    machine, control = (load(built / f"{name}.ssp") for name in ("harvester", "harvester_control"))
    return {"line": control, "square": control, "": machine}


@pytest.mark.parametrize("factor", [1000, 0.001])
@pytest.mark.parametrize("name", MOST_USED)
def test_no_parameter_is_silently_off_by_1000(systems, name, factor):
    """It is refused by the limits of the FMU, or gets one warning that names it."""
    system = systems[""]
    port = system.targets(name)[0][0]
    value = factor * system.components[port.component].value(port.variable)
    try:
        (told,) = warnings(system, set={name: value})
    except Problem as refused:
        told = f"{refused}; is the unit right?"
    assert port.variable in told
    assert told.endswith("?")


@pytest.mark.parametrize(("scenario", "column"), COLUMNS)
def test_no_column_is_silently_off_by_1000(systems, scenario, column):
    """Nor is the time of a scenario in milliseconds; one warning each."""
    system, trace = systems.get(scenario, systems[""]), read_trace(scenario)
    for factor in (1000, 0.001):
        signals = {**trace.signals, column: factor * trace.signals[column]}
        (told,) = warnings(system, replace(trace, signals=signals))
        assert f"column {column} = " in told
    (told,) = warnings(system, replace(trace, time=1000 * trace.time), yes=True)
    assert told.endswith("did you mean ms?")


OTHERS = (pytest.param(machine, marks=shards.search) for machine in MACHINES[1:])


@pytest.mark.parametrize("machine", [{}, *OTHERS], ids=str)
def test_nothing_shipped_is_doubtful(systems, machine):
    """No parameter set and no scenario, in any variant; zero in place of a parameter neither."""
    for name, system in systems.items():
        sets = [file.removesuffix(".ssv") for file in system.resources if file.endswith(".ssv")]
        used = {part: variant for part, variant in machine.items() if not (name and part == "manipulator")}
        assert warnings(system, swap=used, parameters=sets) == warnings(system, swap=used)
        for scenario in {s for s, _ in COLUMNS if systems.get(s, systems[""]) is system}:
            assert warnings(system, scenario, swap=used) == warnings(system, swap=used)
    assert warnings(systems[""], set={"swing.valve_dead_band": 0, "boom_stick.boom_hose_length": 0.5}) == ()


def test_studies_batches_and_linear_models_warn_as_well(systems, built):
    """Once, whatever the number of runs; the study in its analysis, too."""
    factor = Factor("supply.pressure_setting", "uniform", {"minimum": 180.0, "maximum": 210.0})
    output = Output("end", "manipulator.boom_angle", "final")
    system = str(built / "harvester.ssp")
    study = Study("Bar", system, "latin", 3, stop=0.01, factors=(factor,), outputs=(output,))
    (told,) = prepare_study(replace(study, fixed={"manipulator.head_mass": 350})).warnings
    assert "supply.pressure_setting = 180 Pa" in told
    assert told.endswith("did you mean 180 bar?")
    head = {"manipulator.head_mass": [0.3, 0.35]}
    notes = batch(systems[""], head, stop=0.002, record=["manipulator.boom_angle"], lanes=False).notes
    assert sum("did you mean 0.3 t?" in note for note in notes) == 1
    notes = linearize(systems[""], set={"manipulator.head_mass": 0.35}).notes
    assert sum("did you mean 0.35 t?" in note for note in notes) == 1


@pytest.mark.parametrize("name", ["initial_boom_angle=90", "initial_stick_angle=-60"])
def test_an_fmu_that_refuses_a_value_does_not_hide_the_doubt(systems, name):
    """In a run, in one process or two, in a reference and in a linear model: in the line of the error."""
    name, value = name.split("=")
    values = {f"manipulator.{name}": float(value)}
    told = rf"is violated at t = 0 s: .*, expected > 0; .*{name} = .* rad, .*did you mean {value} deg\?$"
    for call in (run, partial(run, isolate=False), reference, linearize):
        problem(lambda call=call: call(systems[""], set=values), told)


def test_a_recording_in_another_unit_is_doubtful(systems):
    """Each too large signal; a small one only if all of its unit are, as one of them may hardly move."""
    recording = read_recording("work_cycle")  # whose outputs without label are of no measurement
    recording = recording.select([name for name in recording.signals if name not in recording.unlisted])
    assert doubtful([recording]) == []
    assert list(filter(None, doubtful_signals(systems[""], recording, "work_cycle"))) == []
    pressures = [name for name, unit in recording.units.items() if unit == "Pa"]
    for names, factor, count in ((pressures[:1], 1e5, 1), (pressures[:1], 1e-5, 0), (pressures, 1e-5, 8)):
        signals = dict(recording.signals) | {name: factor * recording[name] for name in names}
        changed = replace(recording, signals=signals)
        told = list(filter(None, doubtful_signals(systems[""], changed, "a.csv")))
        assert len(told) == min(count, len(names)), told
        # `identify` has no system: usual magnitudes are those of hydraulic machines
        assert len(doubtful([changed])) == len(told)
    # kPa under a header in bar: a factor of 100 is doubtful where the other unit is usual
    in_kpa = {n: (100 if n in pressures else 1) * v for n, v in recording.signals.items()}
    header = {n: "bar" if n in pressures else u for n, u in recording.units.items()}
    changed = replace(recording, signals=in_kpa, file_units=header)
    for told in (doubtful([changed]), list(filter(None, doubtful_signals(systems[""], changed, "a.csv")))):
        assert len(told) == len(pressures)
        assert all(text.endswith("kPa?") for text in told)
    *rates, length = doubtful([replace(recording, time=1e3 * recording.time)])
    assert length.endswith("42000 s; did you mean ms?")
    assert all(line.endswith(" changes: thousandths read as whole units, or ms as s?") for line in rates)


def test_a_parameter_file_in_another_unit_is_doubtful(tmp_path, capsys, monkeypatch):
    """Of `build --parameters`, against the shipped values; the file of a set, too."""
    monkeypatch.setattr(files, "_told", set())
    file = tmp_path / "my.toml"
    entry = 'value = {}\nunit = "kg"\nsource = "assumed"\nnote = "a scale"\n'
    light = "my.toml: head_mass = 0.4 kg, usually about 0.35 t; did you mean 0.4 t?"
    for mass, told in ((400, ""), (0.4, light)):
        file.write_text(f'[parameters."manipulator.head_mass"]\n{entry.format(mass)}', encoding="utf-8")
        harvester_machine(file)
        assert told in capsys.readouterr().err


def test_the_warning_is_in_the_result_and_its_file(built, tmp_path, capsys):
    """Once, and the run goes on: the exit status is 0."""
    out = tmp_path / "run.csv"
    arguments = ["--set", "manipulator.head_mass=0.6", "--stop", "0.01", "--out", str(out)]
    assert main(["run", str(built / "harvester.ssp"), *arguments]) == 0
    told = "manipulator.head_mass = 0.6 kg, usually about 0.35 t; did you mean 0.6 t?"
    assert capsys.readouterr().out.count(told) == 1
    assert json.loads(out.with_suffix(".run.json").read_text())["warnings"] == [told]


def test_a_scenario_in_ms_is_refused(systems, built, tmp_path, capsys):
    """By every command in one line; a stop time or --yes runs it, with a warning on the card."""
    file, system = tmp_path / "ms.csv", str(built / "harvester.ssp")
    file.write_text("time,boom_stick.boom_command\n0,0\n8000,1\n", encoding="utf-8")
    doubt = f"{file}: time = 8000 s, usually about 42 s; did you mean ms?"
    for command in ("run", "validate", "reference", "convergence"):
        assert doubt in refused(capsys, [command, system, "--scenario", file])
    assert doubt in refused(capsys, ["validate", system, "--reference", file, "--out", tmp_path])
    for call in (lambda: batch(systems[""], {}, file), lambda: run(systems[""], file)):
        assert doubt in problem(call)
    factor = Factor("manipulator.head_mass", "uniform", {"minimum": 300.0, "maximum": 400.0})
    output = Output("end", "manipulator.boom_angle", "final")
    choice = Choice("scenario", (str(file),))
    study = Study("ms", system, "latin", 3, factors=(factor,), outputs=(output,), choices=(choice,))
    assert doubt in problem(lambda: prepare_study(study))
    line = read_trace("line")
    path = write_trace(replace(line, time=1000 * line.time), tmp_path / "line_in_ms.csv")
    told = refused(capsys, ["track", built / "harvester_control.ssp", "--path", path, "--out", tmp_path])
    assert "path line_in_ms: scenario: time = 21800 s" in told
    job = Job.of(systems[""], file, RunOptions(yes=True))
    assert (job.times.stop, doubt in job.system.warnings) == (8000.0, True)
    arguments = ["--scenario", str(file), "--stop", "0.01", "--out", str(tmp_path / "run.csv")]
    assert main(["run", system, *arguments]) == 0
    assert capsys.readouterr().out.count(doubt) == 1


@pytest.fixture(scope="module")
def experiments(systems):
    """A stroke of the boom twice, with another head; and another experiment: the work cycle, longer."""
    runs = {"boom": ("boom_up", 350, 2.2), "heavy": ("boom_up", 400, 2.2), "cycle": (None, 350, 2.7)}
    head = "manipulator.head_mass"
    return {n: run(systems[""], s, set={head: m}, stop=t, isolate=False) for n, (s, m, t) in runs.items()}


def test_another_experiment_is_told_before_the_tables(systems, experiments):
    """Other commands and another end; another mass alone is no other experiment."""
    lines = report(compare(experiments)).text().splitlines()
    commands = "boom_stick.boom_command, boom_stick.stick_command, swing.swing_command"
    told = f"another experiment than boom: cycle has other commands ({commands}), its end at 2.7 s, not 2.2 s"
    assert lines[0] == f"warning: {told}"
    assert lines[1] == ""
    moved = run(systems[""], "boom_up", set={"manipulator.initial_swing_angle": 0.1}, stop=2.2, isolate=False)
    (told,) = compare({"boom": experiments["boom"], "moved": moved}).experiments
    assert "another start (manipulator.swing_angle" in told
    assert compare({"boom": experiments["boom"], "heavy": experiments["heavy"]}).experiments == ()
    cut = run(systems[""], cut=["*_command_rate"], stop=2.7, isolate=False)
    assert experiments["cycle"].trace["boom_stick.boom_command_rate"].any()
    assert not cut.trace["boom_stick.boom_command_rate"].any()
    assert compare({"cycle": experiments["cycle"], "cut": cut}).experiments == ()


def test_a_signal_that_hardly_moves_is_not_ranked_by_noise(experiments):
    """Its error is over 0.1 % of its nominal value, which the tables say; the swing is at rest there."""
    comparison = compare({name: experiments[name] for name in ("boom", "heavy")})
    row = comparison.against["heavy"]["manipulator.swing_speed"]
    # nominal 1 rad/s, that of FMI; the speed is 0 but for rounding
    assert row.metrics.normalised_by == 1e-3
    assert row.metrics.nrmse < 1e-9
    assert "* the reference hardly moves: NRMSE over 0.1 % of the nominal value" in report(comparison).text()
    again = compare(dict.fromkeys(("boom", "again"), experiments["boom"]))
    assert "*" not in report(again).text()  # all rows: equal
    row = validate(experiments["heavy"], experiments["boom"])["manipulator.swing_speed"]
    assert row.metrics.nrmse < 1e-9
    assert row.notes[0].startswith("the reference hardly moves")


def test_a_command_that_is_replaced_is_not_recorded(experiments):
    """The levers' program does not run when a scenario replaces it; the inputs have what was applied."""
    signals = experiments["boom"].trace.signals
    assert not [name for name in signals if name.startswith("operator_input.")]
    assert not signals["swing.swing_command"].any()
    assert experiments["cycle"].trace["operator_input.boom_command"].any()


@table(__file__, "meant", "value, unit, usual, told")
def test_the_unit_that_is_meant(value, unit, usual, told):
    """The common unit in which the value is the nearest to usual; none if it is near in none."""
    assert doubt("x", value, unit, usual) == told
