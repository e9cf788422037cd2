"""What a notebook shows of a result, and a trace as a mapping of the names of its signals."""

import re
import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from kit.mistakes import problem

import fmus
import orchestrator
from orchestrator import BatchResult, Trace, compare, linearize, read_trace, run, validate


@pytest.fixture(scope="module")
def result(built):
    move = {"time": [0, 0.1, 0.2], "boom_command": [0, 3, 3]}
    return run(built / "harvester.ssp", scenario=move, stop=0.3, isolate=False)


@pytest.fixture
def trace():
    values = {"a.angle": np.array([1.0, 2.0]), "a.speed": np.zeros(2), "b.speed": np.ones(2)}
    return Trace(np.array([0.0, 0.5]), values, {"a.angle": "rad"})


def test_what_a_cell_ends_with_is_short(result, built):
    """At most five lines and 600 characters, however many signals, runs or components there are."""
    validation = validate(result, result.trace, rate=False)
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
    assert html.count("<svg") == 1
    assert "boom_angle" in html
    assert len(html) < 100_000
    assert not re.search("<script|http", html)
    odd = Trace(np.arange(2.0), {"<b>.x": np.arange(2.0)})._repr_html_()
    assert "<b>.x" not in odd
    assert "<svg" in odd
    assert "<svg" not in Trace(np.zeros(0), {})._repr_html_()


def test_a_trace_is_a_mapping_of_names(trace, result):
    """A name without component is enough where it is unique; a list of names and patterns gives a trace."""
    assert list(trace) == list(trace.keys()) == ["a.angle", "a.speed", "b.speed"]
    assert len(trace) == 3
    assert "angle" in trace
    assert "speed" not in trace
    assert "x" not in trace
    assert trace["angle"] is trace["a.angle"] is dict(trace)["a.angle"]
    assert list(trace[["b.*", "angle"]]) == ["b.speed", "a.angle"]
    assert trace[["angle"]].units == trace.units
    assert trace.units["angle"] == trace.units["a.angle"] == result.units["boom_angle"] == "rad"
    assert trace.units["a.speed"] == ""
    problem(lambda: trace.units["speed"], r"^speed is in 2 components: a.speed, b.speed$")
    assert not trace[[]]
    problem(lambda: trace["speed"], r"^speed is in 2 components: a.speed, b.speed$")
    told = r'^no signal a\.\* in the run; a pattern goes in a list: result\[\["a\.\*"\]\]$'
    problem(lambda: trace["a.*"], told)
    for key in (0, None, 1.5, [0], slice(2)):
        told = r"^expected the name of a signal, or a list of names and patterns, got (0|None|1.5|slice\()"
        problem(lambda key=key: trace[key], told)
    assert 0 not in trace
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


def test_units_go_with_the_values(trace, result, tmp_path, monkeypatch):
    """Into pandas, xarray and each kind of file, and back; those of another trace are not taken."""
    frame, data = trace.to_pandas(), trace.to_xarray()
    assert frame.index.name == "time"
    assert frame.attrs["units"]["a.angle"] == "rad"
    assert data["a.angle"].attrs == {"units": "rad"}
    assert data["time"].attrs == {"units": "s"}
    for name in ("run.csv", "run.parquet", "run.mat"):
        assert read_trace(result.write(tmp_path / name)).units == result.units
    (tmp_path / "run.csv").write_text("time,manipulator.boom_angle\n0,1\n1,2\n")
    assert read_trace(tmp_path / "run.csv").units == {}
    monkeypatch.setitem(sys.modules, "xarray", None)
    problem(trace.to_xarray, r"^to_xarray\(\) needs the package xarray; install with: pip install xarray$")


def test_names_of_a_figure_are_texts_or_lists_and_runs_share_it(trace):
    """`plot` takes a list, a pattern, traces and results."""
    figure = trace.plot(["angle"], "b.*", others={"again": trace})
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
