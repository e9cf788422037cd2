"""STUDY.toml: what it says is understood, mistakes are told in one line."""

from __future__ import annotations

from pathlib import Path

import pytest
from sweep.studies import FAILS, GAIN, run, study

from orchestrator import Problem
from orchestrator.ssp import system
from orchestrator.studies import store
from orchestrator.studies.cases import resolve
from orchestrator.studies.parameter_study import prepare
from orchestrator.studies.study import Choice, Factor, Output, Study, read

FACTOR = '[factors."gain.factor"]\ndistribution = "uniform"\nminimum = 1\nmaximum = 3\n'


@pytest.fixture
def file(gain, tmp_path):
    """The study of the gain."""
    return study(tmp_path, GAIN, gain)


def told(file: Path, text: str) -> str:
    """What is wrong with a study of this text."""
    file.write_text(text, encoding="utf-8")
    with pytest.raises(Problem) as wrong:
        resolve(read(file))[0]
    return str(wrong.value)


def test_a_file_is_understood(file):
    """Every key has its place; reading it again gives the same study."""
    found = resolve(read(file))[0]
    assert found == Study(
        title="A gain",
        system="gain.fmu",
        method="latin",
        runs=12,
        seed=3,
        stop=0.2,
        step=0.01,
        master=None,
        factors=(Factor("gain.factor", "uniform", {"minimum": 1.0, "maximum": 3.0}),),
        choices=(),
        outputs=(Output("end", "gain.y", "final", band=True, unit="m", signal_unit="m"),),
        fixed={"gain.u": 2.0},
    )
    assert resolve(read(file))[0] == found


def test_a_study_survives_its_file(file):
    """study.json contains the study except for its folder, which is ignored."""
    found = resolve(read(file))[0]
    assert store.from_json(store.to_json(found), found.title) == found


def test_numbers_are_converted_to_the_unit_of_the_fmu(file):
    """1 mm = 1e-3 m, exactly as 1e-3 times the number; shares have no unit."""
    text = GAIN.replace(FACTOR, FACTOR.replace("gain.factor", "gain.offset") + 'unit = "mm"\n')
    text = text.replace('"gain.u" = 2', '"gain.u" = { value = 2, unit = "cm" }')
    file.write_text(text, encoding="utf-8")
    found = resolve(read(file))[0]
    assert found.factors[0].numbers == {"minimum": 1e-3 * 1.0, "maximum": 1e-3 * 3.0}
    assert found.factors[0].unit == "m"
    assert found.fixed == {"gain.u": 1e-2 * 2.0}


def test_an_integral_has_the_unit_of_its_signal_times_seconds(file):
    """As the report shows it."""
    file.write_text(GAIN.replace('"final"', '"integral"'), encoding="utf-8")
    assert resolve(read(file))[0].outputs[0].unit == "m.s"


def test_shares_are_of_the_value_that_the_system_has(file, one):
    """Of the FMU's own start value 1, or of the one that is fixed."""
    text = GAIN.replace(FACTOR, FACTOR + "relative = true\n")
    file.write_text(text.replace("[fixed]\n", '[fixed]\n"gain.factor" = 5\n'), encoding="utf-8")
    table = run(file, one)[0].table
    assert (table["start:gain.factor"] == 5.0 * table["factor:gain.factor"]).all()


def test_a_scenario_and_a_variant_are_choices(workshop, tmp_path, one):
    """Files beside the study; each combination is run. A factor that a variant lacks leaves it as it is."""
    file = study(tmp_path, GAIN, workshop["gain"])
    (tmp_path / "bent.fmu").write_bytes(workshop["bent"].read_bytes())
    (tmp_path / "up.csv").write_text("time,u\n0,0\n0.2,1\n")
    (tmp_path / "down.csv").write_text("time,u\n0,0\n0.2,-1\n")
    text = GAIN.replace("gain.factor", "gain.offset").replace('"gain.u" = 2', "").replace("= 12", "= 2")
    choices = '[choices]\nscenario = ["up.csv", "down.csv"]\ngain = ["gain.fmu", "bent.fmu"]\n'
    file.write_text(text + choices, encoding="utf-8")
    found = resolve(read(file))[0]
    assert found.choices == (
        Choice("scenario", ("up.csv", "down.csv")),
        Choice("gain", ("gain.fmu", "bent.fmu")),
    )
    table = run(file, one)[0].table
    sign = table["choice:scenario"].map({"up.csv": 1.0, "down.csv": -1.0})
    offset = table["factor:gain.offset"].where(table["choice:gain"] == "gain.fmu")
    assert len(table) == 8
    assert table["start:gain.offset"].equals(offset.rename("start:gain.offset"))
    # y = u + offset, and y = u of the bent one, in double precision: only rounding is left
    assert table["output:end"].to_numpy() == pytest.approx((sign + offset.fillna(0)).to_numpy(), rel=1e-14)


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ('title = "A gain"', "title = 1", "title: expected a text, got 1"),
        ('title = "A gain"', "titel = 1", "unknown key 'titel'; did you mean title"),
        ('system = "gain.fmu"', "", "system: expected an .ssp, .ssd or .fmu file, got nothing"),
        ('system = "gain.fmu"', 'system = "none.fmu"', "none.fmu: no such file"),
        ('"latin"', '"latim"', "method: expected one of latin, sobol, grid, saltelli, morris, got 'latim'"),
        ("runs = 12", "", "runs: expected a whole number, got nothing"),
        ("runs = 12", "runs = 0", "runs: expected a whole number of at least 1, got 0"),
        ("runs = 12", "runs = 1.5", "runs: expected a whole number of at least 1, got 1.5"),
        ("runs = 12", "runs = true", "runs: expected a whole number of at least 1, got True"),
        ("seed = 3", "seed = -1", "seed: expected a whole number of at least 0, got -1"),
        ("stop = 0.2", "stop = inf", "stop: expected a number, got inf"),
        ("stop = 0.2", 'stop = "1 s"', "stop: expected a number, got '1 s'"),
        ("step = 0.01", "step = 0", "step: expected a positive number, got 0"),
        ("step = 0.01", 'master = "gauss"', "gauss"),
        (
            '"latin"',
            '"sobol"',
            "runs: expected a power of two, such as 8 or 16, as the method is sobol, got 12",
        ),
        ('"latin"', '"grid"', "runs: expected none, as those of a grid follow from its values, got 12"),
        ("minimum = 1", "", 'factors."gain.factor": minimum: expected a number, got nothing'),
        ("minimum = 1", "minimum = 3", "maximum: expected more than the minimum 3, got 3"),
        ("minimum = 1", "least = 1", "unknown key 'least'; there are distribution, relative, unit, minimum"),
        ('"uniform"', '"normal"', "unknown key 'minimum'"),
        ('"uniform"', '"even"', "distribution: expected one of uniform, normal"),
        ("minimum = 1", 'minimum = 1\nunit = "bar"', "factors.\"gain.factor\": unit: unit 'bar' cannot"),
        ("minimum = 1", 'minimum = 1\nunit = "smoots"', "unit 'smoots' is unknown"),
        (
            "minimum = 1",
            'minimum = 1\nrelative = true\nunit = "m"',
            "unit: expected none, as the numbers are",
        ),
        ("minimum = 1", "minimum = 1\nrelative = 1", "relative: expected true or false, got 1"),
        ('"gain.factor"', '"gain.facto"', "unknown variable 'gain.facto'; did you mean gain.factor"),
        ('"gain.factor"', '"gain.y"', "gain.y cannot be set"),
        ('"gain.u" = 2', '"gain.u" = "2"', "fixed: gain.u: expected a number, a text such as"),
        ('"gain.u" = 2', '"gain.w" = 2', "unknown variable 'gain.w'"),
        ('signal = "gain.y"', 'signal = "gain.z"', "outputs.end: signal: unknown variable 'gain.z'"),
        ('signal = "gain.y"', 'signal = "gain.factor"', "expected a signal, got a Real parameter"),
        ('signal = "gain.y"', "", "outputs.end: signal: expected the name of a signal, got nothing"),
        ('"final"', '"last"', "outputs.end: measure: expected one of maximum, minimum"),
        ("band = true", "band = 1", "outputs.end: band: expected true or false, got 1"),
        ("band = true", "start = 2\nstop = 1", "outputs.end: stop: expected at least the start 2 s, got 1"),
        ("[outputs.end]", "[output.end]", "unknown key 'output'; did you mean outputs"),
        ("band = true", "[choices]\nleg = ['a']", "no component 'leg'"),
        ("band = true", "[choices]\ngain = []", "choices: gain: expected a text or a list of texts, got []"),
        ("band = true", "[choices]\ngain = ['a', 'a']", "choices: gain: expected different texts"),
        ("band = true", "[choices]\nscenario = 'no.csv'", "no.csv: no such file"),
        ("band = true", "[choices]\nparameters = 'low'", "parameter set 'low' is unknown"),
        ("[fixed]", "[fixed", "expected TOML, got"),
        ("stop = 0.2", "stop = -1", "stop time: expected more than the start time 0 s, got -1 s"),
        ("step = 0.01", "step = 0.01\nrecord_step = 0.015", "record step: expected a multiple of the step"),
        ("band = true", "start = 5", "outputs.end: start: expected at most 0.2 s, got 5 s"),
        ("band = true", "stop = -1", "outputs.end: stop: expected at least 0 s, got -1 s"),
        ("runs = 12", "runs = 1000000000000", "expected at most 1,000,000 runs, got 1,000,000,000,000"),
        (
            '"gain.u" = 2',
            '"gain.factor" = 2',
            "fixed: gain.factor: expected another variable than the factors",
        ),
        (
            FACTOR,
            FACTOR.replace("gain.factor", "gain.u") + FACTOR.replace("gain.factor", "u"),
            "factors: expected one that sets gain.u, got gain.u and u",
        ),
        (
            FACTOR,
            FACTOR.replace("gain.factor", "gain.offset") + "relative = true\n",
            "factors.gain.offset: relative: expected a start value other than 0, got 0",
        ),
    ],
)
def test_mistakes_are_told_in_one_line(file, old, new, expected):
    """File, key, expected and found."""
    assert old in GAIN
    line = told(file, GAIN.replace(old, new))
    assert line.startswith(f"{file}: ")
    assert expected in line
    assert "\n" not in line


def test_a_study_needs_something_to_vary_and_to_keep(file):
    """Without factors and choices, or without outputs, there is no study; one option alone varies nothing."""
    for text in (GAIN.replace(FACTOR, ""), GAIN.replace(FACTOR, '[choices]\ngain = "gain.fmu"\n')):
        expected = "expected factors, or choices of two options and more, got neither"
        assert expected in told(file, text)
    assert "outputs: expected at least one, got none" in told(file, GAIN[: GAIN.index("[outputs")])


def test_whole_numbers_stay_whole(fails, tmp_path):
    """A variable that is an Integer takes values only, and whole ones."""
    file = study(tmp_path, FAILS, fails)
    expected = "values: expected whole numbers, as fails.how is not a Real variable"
    assert expected in told(file, FAILS.replace("[0, 3,", "[0.5, 3,"))


def test_what_a_scenario_drives_cannot_be_varied(file):
    """It would have no effect."""
    (file.parent / "up.csv").write_text("time,u\n0,0\n0.2,1\n")
    line = told(file, GAIN + '[choices]\nscenario = "up.csv"\n')
    assert (
        line
        == f"{file}: choices: up.csv: the scenario drives gain.u, so this input cannot be fixed or a factor"
    )


def test_a_name_that_a_variant_lacks_costs_no_search(workshop, tmp_path, monkeypatch):
    """Similar names are searched for the message of a mistake, not for each column of each variant."""
    file = study(tmp_path, GAIN.replace("gain.factor", "gain.offset"), workshop["gain"])
    (tmp_path / "bent.fmu").write_bytes(workshop["bent"].read_bytes())
    file.write_text(file.read_text() + '[choices]\ngain = ["gain.fmu", "bent.fmu"]\n', encoding="utf-8")
    monkeypatch.setattr(system, "suggest", lambda *_: pytest.fail("a search"))
    table, _ = prepare(read(file)).inputs()
    assert table["start:gain.offset"].null_count == 12
