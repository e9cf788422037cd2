"""Runs against each other: numbers, cost, picture, and what is refused."""

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from kit.mistakes import problem, refused, table

from orchestrator import Trace, assemble, run, write_trace
from orchestrator.__main__ import main
from orchestrator.engine.result import read_metadata
from orchestrator.results.comparison import compare, quantity
from orchestrator.results.comparison_report import drawn_signals, report

TIME = np.linspace(0.0, 10.0, 1001)
SPEED, PRESSURE = np.sin(TIME), 1e7 + 1e6 * np.cos(TIME)
UNITS = {"arm.speed": "rad/s", "pump.pressure": "Pa", "arm.rest": "rad/s"}


def trace(speed=0.0, pressure=0.0, rest=0.0, every=1, units=UNITS):
    """A speed that moves, one that does not, and a pressure; with constant errors."""
    signals = {"arm.speed": SPEED + speed, "arm.rest": np.full_like(TIME, rest)}
    signals["pump.pressure"] = PRESSURE + pressure
    return Trace(TIME[::every], {n: v[::every] for n, v in signals.items()}, units)


@pytest.fixture(scope="module")
def runs(tmp_path_factory, fmus):
    """A folder with three runs of a gain: a.csv, b.csv with another factor, c.parquet."""
    folder = tmp_path_factory.mktemp("runs")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        shutil.copy(fmus["gain"], "gain.fmu")
        write_trace(Trace(np.array([0.0, 8.0]), {"u": np.array([0.0, 8.0])}), "u.csv")
        for options in ("a.csv", "b.csv --set gain.factor=2", "c.parquet --step 0.4"):
            assert main(f"run gain.fmu --step 0.1 --scenario u.csv --out {options}".split()) == 0
    return folder


@pytest.fixture
def folder(runs, tmp_path, monkeypatch):
    """A working directory with copies of the runs."""
    monkeypatch.chdir(tmp_path)
    return shutil.copytree(runs, tmp_path, dirs_exist_ok=True)


def test_numbers_are_those_of_the_errors():
    """NRMSE over the range of the reference, largest error, the worst signal of each quantity."""
    found = compare({"usual": trace(), "other": trace(0.02, -1e5)})
    row = found.against["other"]["arm.speed"]
    # constant errors: RMSE and largest error are the error itself, rounding only
    assert row.metrics.maximum_error == pytest.approx(0.02, rel=1e-12, abs=0)
    assert row.metrics.nrmse == pytest.approx(0.02 / np.ptp(SPEED), rel=1e-12, abs=0)
    assert found.worst("other", "pressure").signal == "pump.pressure"
    assert found.reference.label == "usual"
    assert found.quantities() == {"speed": ["arm.speed", "arm.rest"], "pressure": ["pump.pressure"]}


def test_an_unknown_run_or_quantity_is_told():
    """With those that there are; so is what is no run at all."""
    found = compare({"a": trace(), "usual": trace(0.02)})
    told = {
        ("usual", "presure"): r"^no quantity 'presure'; did you mean pressure\?$",
        ("usual", "?"): r"^no quantity '\?'; there are speed, pressure$",
        ("usul", "speed"): r"^no run 'usul'; did you mean usual\?$",
        ("c", "speed"): r"^no run 'c'; there are usual$",
        ("a", "speed"): r"^run 'a' is the reference; it is compared with usual$",
    }
    for wrong, line in told.items():
        problem(lambda wrong=wrong: found.worst(*wrong), line)
        problem(lambda wrong=wrong: found.largest(*wrong), line)
    told = r'^compare: expected a list of files, or results with names such as \{"a": one, "b": other\}, got '
    problem(lambda: compare([trace(), trace()]), told + "a list with a Trace$")
    problem(lambda: compare(trace()), told + "one Trace$")
    told = r"^compare: b: expected a file, a Trace or a Result, got int$"
    problem(lambda: compare({"a": trace(), "b": 1}), told)


def test_a_signal_at_rest_is_not_the_worst():
    """Its error over its range has no meaning; the error itself is printed."""
    noise = 1e-6 * np.sin(50 * TIME)
    calm = trace()
    calm = Trace(TIME, {**calm.signals, "arm.rest": noise}, UNITS)
    found = compare({"usual": calm, "other": trace(0.01, rest=1e-3)})
    assert found.against["other"]["arm.rest"].metrics.nrmse > 100
    assert found.worst("other", "speed").signal == "arm.speed"
    still = compare({"usual": trace(), "other": trace(0.01, rest=np.deg2rad(3.0))})
    assert re.search(r"arm.rest +-, 3 deg/s$", report(still).text(), re.MULTILINE)


def test_a_constant_reference_counts_where_the_other_run_moves():
    """NRMSE is then over the range of both runs, and marked; only what moves in neither is left out."""
    found = compare({"usual": trace(rest=1.0), "other": trace(rest=1.0 + 0.5 * SPEED)})
    worst = found.worst("other", "speed")
    span = np.ptp(0.5 * SPEED)
    assert worst.signal == "arm.rest"
    assert worst.metrics.nrmse == pytest.approx(np.sqrt(np.mean((0.5 * SPEED) ** 2)) / span, rel=1e-12)
    told = report(found).text()
    assert found.text() == told
    assert "arm.rest (constant reference)" in told
    assert "note: constant reference: its NRMSE is over the range of both runs" in told
    alone = {"usual": trace(rest=1.0).select(["arm.rest"]), "other": trace(rest=SPEED).select(["arm.rest"])}
    assert "all are constant" not in report(compare(alone)).text()
    assert compare({**alone, "other": alone["usual"]}).worst("other", "speed") is None


@pytest.mark.parametrize("still", [0.0, 0.01])  # at rest, and moving by a hundredth of the other speed
@pytest.mark.parametrize("swapped", [False, True])
def test_what_moves_and_differs_comes_before_what_stands_still(still, swapped):
    """Although the NRMSE of the latter is ten times that of the former; with the runs in either order."""
    runs = [trace(rest=still * SPEED), trace(0.04, rest=still * SPEED + 0.005)]
    runs[not swapped] = replace(
        runs[not swapped], signals={**runs[not swapped].signals, "arm.rest": 0.5 * SPEED}
    )
    found = compare(dict(zip(("one", "other"), runs, strict=True)))
    assert (found.against["other"]["arm.rest"].metrics.nrmse or 1.0) > 0.3
    assert found.worst("other", "speed").signal == "arm.speed"
    # an offset of 0.04 over the range of the sine, 2
    assert report(found).verdict == "largest NRMSE: arm.speed of other, 2 %; at most 2.29 deg/s"


def test_the_first_sentence_is_about_what_is_shown():
    """A power that differs by its whole range is in the table; the sentence is about speeds and pressures."""
    units = UNITS | {"engine.power": "W"}
    one, other = (trace(0.04 * k, units=units) for k in (0, 1))
    runs = {
        n: replace(t, signals={**t.signals, "engine.power": p})
        for n, t, p in (("one", one, 1e4 * SPEED), ("other", other, -1e4 * SPEED))
    }
    found = compare(runs)
    assert found.worst("other", "power").metrics.nrmse > 0.5
    told = "largest NRMSE of speed and pressure: arm.speed of other, 2 %; at most 2.29 deg/s"
    assert report(found).verdict == told
    alike = compare(
        {"one": runs["one"], "other": replace(one, signals={**one.signals, "engine.power": -1e4 * SPEED})}
    )
    assert report(alike).verdict.startswith("largest NRMSE: engine.power of other")


def test_the_largest_difference_is_that_of_all_signals():
    """Not of the one with the largest NRMSE; also in the table and where units differ."""
    units = {"a": "Pa", "b": "Pa", "c": "bar"}

    def shifted(k):
        values = {"a": 1e5 + 1e5 * (SPEED + k), "b": PRESSURE + k * 5e4, "c": PRESSURE / 1e5 + 2 * k}
        return Trace(TIME, values, units)

    found = compare({"usual": shifted(0), "other": shifted(1)})
    assert found.worst("other", "pressure").signal == "a"
    assert found.largest("other", "pressure").signal == "c"
    assert re.search(r"^pressure +3  a +\S+ % +1 bar\n +c +\S+ % +2 bar$", report(found).text(), re.MULTILINE)


def test_costs_tell_what_was_swapped_and_the_ratio(fmus):
    """The name of the FMU beside that of the run; the reference costs once itself."""
    swaps = {"usual": {}, "other": {"gain": fmus["gain"]}}
    results = {name: run(str(fmus["gain"]), step=0.1, stop=1.0, swap=swap) for name, swap in swaps.items()}
    told = report(compare(results)).text()
    assert re.search(r"^usual +gauss-seidel +0.1 s +\S+ +\S+ +\S+ +1$", told, re.MULTILINE)
    assert re.search(r"^other +gauss-seidel +0.1 s", told, re.MULTILINE)
    assert "other: swapped gain for gain" in told
    assert re.search(r"^in each FMU \[us/ms\] +gain$", told, re.MULTILINE)


def test_against_names_the_reference():
    """By its name, or by its file; the default is the first."""
    runs = {"one": trace(), "two": trace(0.1), "three": trace(0.3)}
    assert compare(runs).reference.label == "one"
    found = compare(runs, against="three")
    assert list(found.against) == ["one", "two"]
    error = found.against["two"]["arm.speed"]
    assert error.simulation[0] - error.reference[0] == pytest.approx(-0.2, rel=1e-12, abs=0)  # rounding only
    problem(lambda: compare(runs, against="four"), "compare: against four: expected one of one, two, three")


def test_grids_may_differ():
    """Compared on the coarser one, as `validate` does; a window cuts both."""
    found = compare({"fine": trace(), "coarse": trace(0.1, every=10)}, start=2.0, stop=4.0)
    row = found.against["coarse"]["arm.speed"]
    np.testing.assert_allclose(row.time, TIME[200:401:10], rtol=0, atol=1e-12)  # rounding only
    assert row.metrics.rmse == pytest.approx(0.1, rel=1e-12)
    assert found.window == pytest.approx((2.0, 4.0))


def test_units_are_completed_and_converted():
    """A trace without units has those of another; different units of one quantity are converted."""
    bar = Trace(TIME, {"pump.pressure": PRESSURE / 1e5 + 1.0}, {"pump.pressure": "bar"})
    bare = Trace(TIME, {"pump.pressure": PRESSURE}, {})
    found = compare({"usual": trace(), "bar": bar, "bare": bare})
    assert found.against["bar"]["pump.pressure"].metrics.maximum_error == pytest.approx(1.0, rel=1e-9)
    assert found.against["bare"]["pump.pressure"].metrics.maximum_error == 0
    wrong = {"usual": trace(), "wrong": Trace(TIME, bare.signals, {"pump.pressure": "K"})}
    problem(lambda: compare(wrong), r"usual: pump.pressure: unit 'Pa' cannot be converted")


def test_signals_are_chosen_by_patterns():
    """Only common signals are shown; a pattern without match is reported."""
    runs = {"one": trace(), "two": trace().select(["arm.speed", "pump.pressure"])}
    assert compare(runs).signals == ("arm.speed", "pump.pressure")
    assert compare(runs, signals=["*.pressure"]).signals == ("pump.pressure",)
    assert compare(runs).notes == ("not in all traces, so left out: arm.rest",)
    told = problem(lambda: compare(runs, signals=["arm.sped"]))
    assert re.match(r"compare: signals arm.sped: no common signal .* did you mean arm.speed\?", told)


@table(__file__, "quantities", "unit, word")
def test_quantities_have_words(unit, word):
    """Also where two quantities share their base units."""
    assert quantity(unit) == word


def test_inputs_are_not_shown_unless_named(fmus):
    """A connected input repeats an output."""
    system = assemble({"s": fmus["source"], "g": fmus["gain"]}, ["s.y -> g.u"])
    runs = {str(f): run(system, step=0.1, stop=1.0, set={"g.factor": f}) for f in (1.0, 2.0)}
    assert compare(runs).signals == ("s.y", "g.y")
    assert compare(runs, signals=["*"]).signals == ("s.y", "g.y", "g.u")


def test_the_picture_shows_what_differs_most():
    """At most six signals, three of each quantity, the worst first; a run in each panel, an error below."""
    units, signals = {}, {}
    for i in range(5):
        signals |= {f"s{i}": (1 + i) * SPEED, f"p{i}": (1 + i) * PRESSURE}
        units |= {f"s{i}": "rad/s", f"p{i}": "Pa"}
    worse = {name: 1.01 * values for name, values in signals.items()}
    found = compare({"one": Trace(TIME, signals, units), "two": Trace(TIME, worse, units)})
    assert sorted(drawn_signals(found)) == ["p2", "p3", "p4", "s2", "s3", "s4"]
    figure = found.plot()
    assert len(figure.axes) == 12
    curves, errors = figure.axes[2:4]  # below the worst signal
    assert [len(axes.lines) for axes in (curves, errors)] == [2, 2]  # reference and run; zero and error
    assert curves.get_ylabel() == "[deg/s]"
    drawn = errors.lines[1].get_ydata()
    assert np.max(np.abs(drawn)) == pytest.approx(np.rad2deg(0.03), rel=1e-4)  # the peak between samples
    assert [t.get_text() for t in figure.legends[0].get_texts()] == ["one (reference)", "two"]


def test_a_run_leaves_its_metadata(folder):
    """Beside the trace: system, settings, cost, units; only for the trace that it made."""
    known = read_metadata(Path("b.csv"))
    assert (known.system, known.step, known.simulated) == ("gain.fmu", 0.1, pytest.approx(8.0))
    assert known.given["set"] == {"gain.factor": "2"}
    assert known.units == {"gain.y": "m", "gain.u": "m"}
    assert known.inputs == ("gain.u",)
    assert 0 < known.inside["gain"] < known.wall
    for suffix in (".csv", ".run.json"):
        Path(f"b{suffix}").rename(f"renamed{suffix}")
    assert read_metadata(Path("renamed.csv")) == known
    other = Path("renamed.csv").read_text(encoding="utf-8").replace("8", "9")  # as many rows
    Path("renamed.csv").write_text(other, encoding="utf-8")
    assert read_metadata(Path("renamed.csv")) is None
    (folder / "b.run.json").write_text('{"sha256": "", "walls": 3}', encoding="utf-8")
    problem(lambda: read_metadata(Path("b.csv")), "b.run.json: expected what harvester run writes next to")


@pytest.mark.usefixtures("folder")
def test_the_command_prints_and_writes(capsys):
    """Tables, a page, and all numbers as JSON."""
    capsys.readouterr()
    assert main(["compare", "a.csv", "b.csv", "c.parquet", "--out", "new/place"]) == 0
    printed = capsys.readouterr().out
    assert "b against a" in printed
    assert re.search(r"^a +gauss-seidel +0.1 s .* 1$", printed, re.MULTILINE)
    assert "page: new/place/comparison.html" in printed
    assert "Differences from <b>a</b>" in Path("new/place/comparison.html").read_text(encoding="utf-8")
    data = json.loads(Path("new/place/comparison.json").read_text(encoding="utf-8"))
    assert data["reference"] == "a"
    numbers = data["runs"]["b"]["signals"]["gain.y"]
    assert (numbers["maximum"], numbers["time of maximum [s]"], numbers["unit"]) == (8.0, 8.0, "m")
    assert data["runs"]["c"]["step [s]"] == 0.4
    assert main(["compare", "a.csv", "--against", "b.csv", "--out", "new"]) == 0
    assert "a against b" in capsys.readouterr().out


@pytest.mark.usefixtures("folder")
def test_a_reference_with_its_own_units_is_compared_too():
    """A CSV with a TOML beside it, as `validate` reads it."""
    Path("m.csv").write_text("time,y\n0,0\n4,4000\n8,8100\n", encoding="utf-8")
    Path("m.toml").write_text('[signals."gain.y"]\ncolumn = "y"\nunit = "mm"\n', encoding="utf-8")
    found = compare(["a.csv", "m.csv"], against="m.csv")
    # the ramp of 1 m/s against a measured end of 8.1 m; the time axis of the run is rounded
    assert found.against["a"]["gain.y"].metrics.maximum_error == pytest.approx(0.1, rel=1e-9)


@pytest.mark.usefixtures("folder")
@table(__file__, "mistakes", "arguments, message")
def test_mistakes_of_a_comparison_are_one_line(capsys, arguments, message):
    """No traceback, exit status 2."""
    assert message in refused(capsys, ["compare", *arguments.split()])
