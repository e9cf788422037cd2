"""Studies in files and in Python: what they say is understood, mistakes are told in one line."""

from dataclasses import replace

import pytest
from kit.mistakes import problem, table
from sweep.studies import FACTOR, FAILS, GAIN, content, machine, refused, resolved, run, study

from orchestrator.ssp import system
from orchestrator.studies import Choice, Factor, Output, Study, design, read_results, read_study, store, sweep
from orchestrator.studies.cases import resolve
from orchestrator.studies.parameter_study import prepare

UP = "time,u\n0,0\n0.2,1\n"
BENT = '[choices]\ngain = ["gain.fmu", "bent.fmu"]\n'


@pytest.fixture
def offset(fmus, tmp_path):
    """The text of a study that varies the offset of the gain, and the file of it; bent.fmu is beside it."""
    (tmp_path / "bent.fmu").write_bytes(fmus["bent"].read_bytes())
    text = GAIN.replace("gain.factor", "gain.offset")
    return text, study(tmp_path, text, fmus["gain"])


def of_gain(system, fixed, **units: str) -> Study:
    """The study of the file in Python."""
    factors = (Factor("gain.factor", "uniform", {"minimum": 1, "maximum": 3}),)
    outputs = (Output("end", "gain.y", "final", band=True, **units),)
    space = {"factors": factors, "outputs": outputs, "fixed": fixed}
    return Study("A gain", str(system), runs=12, seed=3, stop=0.2, step=0.01, **space)


def test_a_file_is_understood(file):
    """Every key has its place; reading it again gives the same study, and so does study.json."""
    found = resolved(file)
    assert found == of_gain("gain.fmu", {"gain.u": 2.0}, unit="m", signal_unit="m")
    assert resolved(file) == found
    assert store.from_json(store.to_json(found), found.title) == found


def test_numbers_are_converted_to_the_unit_of_the_fmu(offset):
    """1 mm = 1e-3 m, exactly as 1e-3 times the number; an integral is in that unit times seconds."""
    text, file = offset
    text = text.replace("maximum = 3", 'maximum = 3\nunit = "mm"').replace('"final"', '"integral"')
    found = resolved(file, text.replace('"gain.u" = 2', '"gain.u" = { value = 2, unit = "cm" }'))
    assert found.factors[0].numbers == {"minimum": 1e-3 * 1.0, "maximum": 1e-3 * 3.0}
    assert found.factors[0].unit == "m"
    assert found.fixed == {"gain.u": 1e-2 * 2.0}
    assert found.outputs[0].unit == "m.s"


def test_shares_are_of_the_value_that_the_system_has(file):
    """Of the FMU's own start value 1, or of the one that is fixed."""
    text = GAIN.replace(FACTOR, FACTOR + "relative = true\n")
    file.write_text(text.replace("[fixed]\n", '[fixed]\n"gain.factor" = 5\n'), encoding="utf-8")
    rows = run(file)[0].table
    assert (rows["start:gain.factor"] == 5.0 * rows["factor:gain.factor"]).all()


def test_a_scenario_and_a_variant_are_choices(offset):
    """Files beside the study; each combination is run. A factor that a variant lacks leaves it as it is."""
    text, file = offset
    (file.parent / "up.csv").write_text(UP)
    (file.parent / "down.csv").write_text(UP.replace(",1", ",-1"))
    text = text.replace('"gain.u" = 2', "").replace("= 12", "= 2")
    found = resolved(file, f'{text}{BENT}scenario = ["up.csv", "down.csv"]\n')
    variants, scenarios = Choice("gain", ("gain.fmu", "bent.fmu")), Choice("scenario", ("up.csv", "down.csv"))
    assert found.choices == (variants, scenarios)
    rows = run(file)[0].table
    sign = rows["choice:scenario"].map({"up.csv": 1.0, "down.csv": -1.0})
    drawn = rows["factor:gain.offset"].where(rows["choice:gain"] == "gain.fmu")
    assert len(rows) == 8
    assert rows["start:gain.offset"].equals(drawn.rename("start:gain.offset"))
    # y = u + offset, and y = u of the bent one, in double precision: only rounding is left
    assert rows["output:end"].to_numpy() == pytest.approx((sign + drawn.fillna(0)).to_numpy(), rel=1e-14)


@table(__file__, "mistakes", "old, new, expected")
def test_mistakes_are_told_in_one_line(file, old, new, expected):
    """File, key, expected and found."""
    assert old in GAIN
    assert expected in refused(file, GAIN.replace(old, new))


def test_a_study_needs_something_to_vary_and_to_keep(file):
    """Factors or choices, but not of one option alone; outputs; nothing varied that a scenario drives."""
    expected = "expected factors, or choices of two options and more, got neither"
    for instead in ("", '[choices]\ngain = "gain.fmu"\n'):
        assert refused(file, GAIN.replace(FACTOR, instead)) == expected
    expected = "outputs: expected at least one, got none"
    assert refused(file, GAIN[: GAIN.index("[outputs")]) == expected
    (file.parent / "up.csv").write_text(UP)
    expected = "choices: up.csv: the scenario drives gain.u, so this input cannot be fixed or a factor"
    assert refused(file, GAIN + '[choices]\nscenario = "up.csv"\n') == expected


def test_whole_numbers_stay_whole(fmus, tmp_path):
    """A variable that is an Integer takes values only, and whole ones."""
    file = study(tmp_path, FAILS, fmus["fails"])
    expected = "values: expected whole numbers, as fails.how is not a Real variable"
    assert expected in refused(file, FAILS.replace("[0, 3,", "[0.5, 3,"))


def test_a_name_that_a_variant_lacks_costs_no_search(offset, monkeypatch):
    """Similar names are searched for the message of a mistake, not for each column of each variant."""
    text, file = offset
    file.write_text(text + BENT, encoding="utf-8")
    monkeypatch.setattr(system, "suggest", lambda *_: pytest.fail("a search"))
    ready = prepare(read_study(file))
    starts, _ = design.starts(ready.study, ready.cases, ready.samples)
    assert starts["start:gain.offset"].null_count == 12


def test_a_window_may_end_with_the_runs(file):
    """At the stop of the study, also where that is no whole number of steps."""
    for end in ("0.2", "0.1999"):
        text = GAIN.replace("stop = 0.2", f"stop = {end}") + f"stop = {end}\n"
        assert resolved(file, text).outputs[0].stop == float(end)


@pytest.mark.parametrize("name", ["boom_command", "boom_stick.boom_command"])
def test_a_wired_input_is_refused_with_what_a_study_can_do(name, fmu_dir, tmp_path):
    """In one line, and without --cut, which `sweep` has not got."""
    key = f'"{name}"' if "." in name else name
    wire = "operator_input.boom_command -> boom_stick.boom_command"
    assert refused(machine(tmp_path, fmu_dir, name)) == (
        f"factors.{key}: {name}: expected an unconnected input, got the connection {wire};"
        " vary parameters of operator_input, or drive boom_stick.boom_command by a scenario under choices"
    )


def test_what_the_refusal_advises_is_accepted(fmu_dir, tmp_path):
    """A parameter of operator_input can be a factor; a scenario can drive the connected input itself."""
    assert resolved(machine(tmp_path, fmu_dir, "operator_input.boom_1_command")).factors
    file = machine(tmp_path, fmu_dir, "manipulator.head_mass")
    (tmp_path / "rest.csv").write_text("time,boom_stick.boom_command\n0,0\n", encoding="utf-8")
    found = resolved(file, file.read_text("utf-8") + '[choices]\nscenario = "rest.csv"\n')
    assert found.choices[0].options == ("rest.csv",)


# ---- in Python


@pytest.fixture
def in_python(gain) -> Study:
    """The study of the gain in Python."""
    return of_gain(gain, {"gain.u": (200, "cm")})


def test_python_and_file_give_the_same_results(in_python, gain, tmp_path):
    """Byte by byte: units and names of outputs come from the FMU in both."""
    text = GAIN.replace('"gain.fmu"', f'"{gain.as_posix()}"')
    run(study(tmp_path, text, gain), "file")
    results = sweep(in_python, tmp_path / "python", workers=1)
    assert content(tmp_path / "python") == content(tmp_path / "file")
    assert results.study == resolved(tmp_path / "study.toml")
    assert read_results(tmp_path / "python").table.equals(results.table)
    assert not (tmp_path / "python" / "study.toml").exists()


def test_a_resolved_study_is_resolved(in_python):
    """Its numbers are in the units of the FMUs already."""
    first = resolve(in_python)[0]
    assert resolve(first)[0] == first
    assert first.fixed == {"gain.u": 2.0}


# what a file is told of when it is read, and one mistake that file and Python share
@pytest.mark.parametrize(
    ("changed", "expected"),
    [
        ({"method": "latim"}, "method: expected one of latin, sobol, grid, saltelli, morris, got 'latim'"),
        ({"runs": 0}, "runs: expected a whole number of at least 1, got 0"),
        ({"outputs": (Output("end", "gain.y", "last"),)}, "outputs.end: measure: expected one of maximum"),
        ({"method": "grid", "runs": 0}, "distribution: expected values, as the method is grid"),
        ({"fixed": {"gain.w": 1.0}}, "unknown variable 'gain.w'"),
    ],
    ids=str,
)
def test_mistakes_name_the_study(in_python, changed, expected):
    """In one line, by the title of the study."""
    line = problem(lambda: resolve(replace(in_python, **changed)))
    assert line.startswith("study 'A gain': ")
    assert expected in line


def test_an_output_takes_times_with_units_and_a_choice_one_text():
    """As in a file; another unit is told when the output is made."""
    output = Output("end", "gain.y", "final", "100ms", 2)
    assert output == Output("end", "gain.y", "final", 0.1, 2.0)
    assert Choice("gain", "bent.fmu") == Choice("gain", ("bent.fmu",))
    line = problem(lambda: Output("end", "gain.y", "final", stop="1 bar"))
    expected = "expected a number of seconds or a time such as 500ms or 5min, got '1 bar'"
    assert line == f"outputs.end: stop: {expected}"


@table(__file__, "factors", "distribution, numbers, expected")
def test_a_factor_refuses_impossible_numbers(distribution, numbers, expected):
    """When it is made."""
    line = problem(lambda: Factor("gain.factor", distribution, numbers))
    assert line.startswith(f'factors."gain.factor": {expected}')
