"""What a person at a Python prompt or in a notebook types, and what comes back."""

import inspect
import re
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from kit.mistakes import problem
from matplotlib.text import Text

import fmus
import orchestrator
from fmus import package_files
from orchestrator import BatchResult, Trace, batch, compare, linearize, read_trace, run, validate
from orchestrator.__main__ import main
from orchestrator.base import files
from orchestrator.base.options import declarations
from orchestrator.data.trace import as_trace
from orchestrator.engine.options import DEFAULT_ACCURACY, AccuracyOptions, RunOptions

TIME = np.linspace(0.0, 2.0, 201)
SIGNALS = {"arm.boom_speed": np.sin(TIME), "arm.boom_angle": 1 - np.cos(TIME), "oil.boom_speed": TIME}


def trace(**changed):
    """Three signals; two differ only in their component."""
    return Trace(TIME, SIGNALS | changed, {"arm.boom_angle": "rad", "arm.boom_speed": "rad/s"})


def test_names_complete_without_their_component_where_it_may_be_left_out():
    """Each that is offered is a key."""
    offered = trace()._ipython_key_completions_()
    assert offered == [*SIGNALS, "boom_angle"]
    assert all(len(trace()[name]) == len(TIME) for name in offered)


def test_traces_are_equal_if_all_their_values_are():
    """Times, values, missing ones too, units and names; any other object is not equal."""
    gap = np.where(TIME > 1, np.nan, TIME)
    assert trace() == trace()
    assert trace(**{"oil.boom_speed": gap}) == trace(**{"oil.boom_speed": gap.copy()})
    assert trace() != trace(**{"oil.boom_speed": gap})
    assert trace() != Trace(TIME, SIGNALS)
    assert trace() != Trace(TIME + 1.0, SIGNALS, trace().units)
    assert trace() != trace(more=TIME)
    assert trace() != dict(trace())


def test_the_signature_of_run_has_every_option():
    """A prompt completes them, and they are what `run` accepts."""
    names = set(inspect.signature(run).parameters)
    assert names == {"system", "scenario", *declarations(RunOptions)}
    assert inspect.signature(run).parameters["stop"].default is None
    # one place in the code has the default accuracies; the text of the option names both
    told = " ".join(AccuracyOptions.__doc__.split())
    for before, name in (("all FMUs have directional derivatives", "run"), ("validate", "validate")):
        assert f"{before}: {DEFAULT_ACCURACY[name]:.0e}".replace("e-0", "e-") in told


def test_a_scenario_may_be_a_structured_array_or_have_functions():
    """As FMPy takes inputs; a function is evaluated at the times of the mapping."""
    rows = np.array([(0.0, 0.0), (1.0, 3.0)], dtype=[("time", float), ("boom_command", float)])
    assert as_trace(rows) == as_trace({"time": [0.0, 1.0], "boom_command": [0.0, 3.0]})
    assert as_trace({"time": [0.0, 1.0], "boom_command": lambda t: 3 * t}) == as_trace(rows)


def test_record_takes_patterns_and_names_without_component(built):
    """As `plot` does."""
    found = run(built / "harvester.ssp", stop=0.01, record=["boom_angle", "swing.swing_pressure_?"])
    assert list(found) == ["manipulator.boom_angle", "swing.swing_pressure_a", "swing.swing_pressure_b"]


def test_a_batch_is_a_mapping(built):
    """Length, iteration and values are those of its signals; xarray has machines and times."""
    masses = {"manipulator.head_mass": [300.0, 400.0]}
    found = batch(built / "harvester.ssp", masses, stop=0.02, record="boom_angle", lanes=False)
    assert (len(found), list(found)) == (1, ["manipulator.boom_angle"])
    assert np.array_equal(next(iter(found.values())), found["boom_angle"])
    dataset = found.to_xarray()
    assert dict(dataset.sizes) == {"machine": 2, "time": 21}
    assert dataset["manipulator.boom_angle"].attrs["units"] == "rad"
    assert list(dataset["status"].values) == ["ok", "ok"]


def test_a_comparison_has_a_picture_and_a_table():
    """The table names the worst signal; rounding is no difference, and has no panel."""
    noise = trace(**{"arm.boom_angle": SIGNALS["arm.boom_angle"] * (1 + 1e-14)})
    other = {"arm.boom_angle": 1.1 * SIGNALS["arm.boom_angle"], "arm.boom_speed": np.sin(TIME) + 1e-15}
    found = compare({"a": trace(), "b": trace(**other)})
    assert "arm.boom_angle" in found._repr_html_()
    axes = found.plot().axes
    titles = [text.get_text() for a in axes for text in a.findobj(Text)]
    assert any("boom_angle" in title for title in titles)
    assert not any("boom_speed" in title for title in titles)
    assert found.equal("b", found.against["b"]["arm.boom_speed"])
    # 1e-9 of the largest value, 1.42, is the limit
    same = compare({"a": trace(), "b": noise})
    assert same.equal("b", same.against["b"].rows[1])
    assert not found.equal("b", found.against["b"]["arm.boom_angle"])


def test_a_name_is_found_from_any_folder_of_a_checkout(built, tmp_path, monkeypatch, capsys):
    """A notebook runs in its own folder; without FMUs the message says where it looked and how to build."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(files, "CHECKOUT", built)
    assert files.find("harvester", (".ssp",)) == built / "harvester.ssp"
    assert files.find("swing_detailed", (".fmu",)) == built / "variants" / "swing_detailed.fmu"
    assert files.find("build/harvester.ssp", (".ssp",)) == Path("build/harvester.ssp")  # a path is one
    monkeypatch.setattr(package_files, "CHECKOUT", built)
    assert main(["run", "--stop", "0.01"]) == 0  # and so is what a command takes without a name
    assert capsys.readouterr().err == f"build/harvester.ssp does not exist; using {built / 'harvester.ssp'}\n"
    assert main(["--version"]) == 0
    assert f"FMUs: built, in {built.resolve()}\n" in capsys.readouterr().out
    monkeypatch.setattr(files, "CHECKOUT", tmp_path / "none")
    looked = f"in {tmp_path / 'build'}, {tmp_path / 'none'}"
    problem(lambda: run("harvester"), re.escape(f"no such file {looked}; build it with: harvester build"))


# ---- What a notebook shows of a result, and a trace as a mapping of the names of its signals


@pytest.fixture(scope="module")
def result(built):
    move = {"time": [0, 0.1, 0.2], "boom_command": [0, 3, 3]}
    return run(built / "harvester.ssp", scenario=move, stop=0.3, isolate=False)


@pytest.fixture
def short():
    values = {"a.angle": np.array([1.0, 2.0]), "a.speed": np.zeros(2), "b.speed": np.ones(2)}
    return Trace(np.array([0.0, 0.5]), values, {"a.angle": "rad"})


def test_what_a_cell_ends_with_is_short(result, built):
    """At most five lines and 600 characters, however many signals, runs or components there are."""
    validation = validate(result, result.trace)
    shown = [
        *(result, result.trace, result.card, result.system, validation, validation.rows[0]),
        *(fmus.PARTS, fmus.HARVESTER, fmus.values(fmus.HARVESTER), linearize(built / "harvester.ssp")),
        compare({"one": result, "two": result}),
        BatchResult(result.time, {n: v[None] for n, v in result.items()}, np.array(["ok"]), [""]),
        *result.system.components.values(),
    ]
    for thing in shown:
        assert len(repr(thing)) < 600, type(thing)
        assert len(repr(thing).splitlines()) <= 5, type(thing)
    assert repr(result).startswith(f"Result of harvester: {len(result)} signals at 301 times from 0 to 0.3 s")


def test_a_result_in_html_has_its_card_and_small_charts(result):
    """Without scripts or requests; an empty trace has no charts; names are escaped."""
    html = result._repr_html_()
    assert "power bond" in html
    assert html.count("<img") == 1
    assert len(html) < 200_000
    assert not re.search("<script|http", html)
    odd = Trace(np.arange(2.0), {"<b>.x": np.arange(2.0)})._repr_html_()
    assert "<b>.x" not in odd
    assert "<img" in odd
    assert "<img" not in Trace(np.zeros(0), {})._repr_html_()


def test_a_trace_is_a_mapping_of_names(short, result):
    """A name without component is enough where it is unique; a list of names and patterns gives a trace."""
    assert list(short) == list(short.keys()) == ["a.angle", "a.speed", "b.speed"]
    assert len(short) == 3
    assert "angle" in short
    assert "speed" not in short
    assert "x" not in short
    assert short["angle"] is short["a.angle"] is dict(short)["a.angle"]
    assert list(short[["b.*", "angle"]]) == ["b.speed", "a.angle"]
    assert short[["angle"]].units == short.units
    assert short.units["angle"] == short.units["a.angle"] == result.units["boom_angle"] == "rad"
    assert short.units["a.speed"] == ""
    problem(lambda: short.units["speed"], r"^speed is in 2 components: a.speed, b.speed$")
    assert not short[[]]
    problem(lambda: short["speed"], r"^speed is in 2 components: a.speed, b.speed$")
    told = r'^no signal a\.\* in the run; a pattern goes in a list: result\[\["a\.\*"\]\]$'
    problem(lambda: short["a.*"], told)
    for key in (0, None, 1.5, [0], slice(2)):
        told = r"^expected the name of a signal, or a list of names and patterns, got (0|None|1.5|slice\()"
        problem(lambda key=key: short[key], told)
    assert 0 not in short
    assert result["boom_angle"] is result.trace["manipulator.boom_angle"]
    assert len(result) == len(result.trace)
    assert "boom_angle" in result


def test_a_pattern_without_a_dot_does_not_see_the_component(result):
    """So `boom_*` selects no signal of the stick, whose component is boom_stick; one with a dot sees it."""
    boom = list(result[["boom_*"]])
    assert {"manipulator.boom_angle", "boom_stick.boom_force"} <= {*boom}
    assert all(name.rpartition(".")[2].startswith("boom_") for name in boom)
    assert "boom_stick.stick_force" in result[["boom_stick.*"]]
    assert list(result[["*"]]) == list(result)
    bare = Trace(np.arange(2.0), {"boom_u": np.zeros(2), "boom.v": np.zeros(2), "x[1]": np.ones(2)})
    assert list(bare[["boom*", "x[1]"]]) == ["boom_u", "x[1]"]
    for chosen in (compare({"a": bare, "b": bare}, signals="boom*").signals, bare.matching(["boom*"])):
        assert list(chosen) == ["boom_u"]


def test_units_go_with_the_values(short, result, tmp_path, monkeypatch):
    """Into pandas, xarray and each kind of file, and back; those of another trace are not taken."""
    frame, data = short.to_pandas(), short.to_xarray()
    assert frame.index.name == "time"
    assert frame.attrs["units"]["a.angle"] == "rad"
    assert data["a.angle"].attrs == {"units": "rad"}
    assert data["time"].attrs == {"units": "s"}
    for name in ("run.csv", "run.parquet", "run.mat"):
        assert read_trace(result.write(tmp_path / name)).units == result.units
    (tmp_path / "run.csv").write_text("time,manipulator.boom_angle\n0,1\n1,2\n")
    assert read_trace(tmp_path / "run.csv").units == {}
    monkeypatch.setitem(sys.modules, "xarray", None)
    problem(short.to_xarray, r"^to_xarray\(\) needs the package xarray; install with: pip install xarray$")


def test_names_of_a_figure_are_texts_or_lists_and_runs_share_it(short):
    """`plot` takes a list, a pattern, traces and results."""
    figure = short.plot(["angle"], "b.*", others={"again": short})
    assert [len(axes.lines) for axes in figure.axes] == [2, 2]


def test_runs_may_be_in_threads(result):
    """Each in a process of its own, which the threads take from the same stock; no signal handlers there."""
    with ThreadPoolExecutor(2) as threads:
        runs = [threads.submit(run, result.system, stop=0.01) for _ in range(2)]
    assert len({run.result()["boom_angle"].tobytes() for run in runs}) == 1


def test_public_names_and_the_version_are_shown():
    """In `dir`, and lazily from the metadata of the package."""
    for package in (orchestrator, fmus):
        assert set(package.__all__) < set(dir(package))
        assert re.match(r"\d+\.\d+", package.__version__)
