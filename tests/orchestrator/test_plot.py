"""Figures of a run, and values and inputs as users write them: units, mappings, data frames, MATLAB files."""

import os
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import scipy.io
from kit.mistakes import problem, table

from orchestrator import Problem, Trace, assemble, read_trace, run, validate, write_trace
from orchestrator.__main__ import main
from orchestrator.base.signals import matching
from orchestrator.engine.result import newest_trace

TIME = np.linspace(0.0, 1.0, 101)


def waves(**units: str) -> Trace:
    """Sine waves of different frequency: name with __ for a dot -> unit."""
    names = [name.replace("__", ".") for name in units]
    signals = {name: np.sin((2 + i) * TIME) for i, name in enumerate(names)}
    return Trace(TIME, signals, dict(zip(names, units.values(), strict=True)))


def legends(figure) -> list[list[str]]:
    """Texts of the legend of each panel."""
    return [[text.get_text() for text in axes.get_legend().get_texts()] for axes in figure.axes]


def test_a_figure_without_chosen_signals_fits_on_a_page():
    """Six signals of each of four quantities at most, commands first, in units that people use."""
    units = {f"a__p{i}": "Pa" for i in range(9)} | {"a__q": "m3/s", "a__x": "m", "a__w": "rad/s", "b__u": "V"}
    figure = waves(**units, a__phi="rad").plot()
    labels = [axes.get_ylabel() for axes in figure.axes]
    assert labels == ["voltage\n[V]", "angle\n[deg]", "speed\n[deg/s]", "pressure\n[bar]"]
    assert legends(figure)[3] == [f"p{i}" for i in range(6)]
    assert "9 of 14 signals" in [text.get_text() for text in figure.texts]


def test_a_signal_and_its_band_are_drawn_in_the_unit_of_the_panel():
    """A half width of up to 1 bar around one of two pressures, given on a coarser time axis."""
    trace = waves(a__p="Pa", b__p="Pa", b__x="")
    band = Trace(TIME[::50], {"a.p": np.array([0.0, 1e5, 0.0])}, {"a.p": "Pa"})
    pressures, others = trace.plot("*.p", "b.x", title="Pump", band=band).axes
    assert (pressures.get_ylabel(), others.get_ylabel()) == ("pressure\n[bar]", "[1]")
    # exact identity: rounding only
    np.testing.assert_allclose(pressures.lines[0].get_ydata(), trace["a.p"] / 1e5, rtol=1e-14)
    (area,) = pressures.collections
    edges = area.get_paths()[0].vertices
    quarter = edges[np.abs(edges[:, 0] - 0.25) < 1e-9, 1]
    assert np.sort(quarter) == pytest.approx(np.array([-0.5, 0.5]) + 1e-5 * trace["a.p"][25])  # bar


def test_what_shows_nothing_is_left_out_unless_it_is_chosen():
    """A constant, and an input that repeats the output to which it is connected."""
    trace = waves(a__y="m", b__z="m")
    more = {"a.const": np.full(101, 3.0), "b.u": trace["a.y"] + 1e-9}
    whole = Trace(TIME, {**trace.signals, **more}, {**trace.units, "a.const": "m", "b.u": "m"})
    assert whole.matching() == ["a.y", "b.z"]
    assert whole.matching(["a.*", "u"]) == ["a.y", "a.const", "b.u"]
    for refused in (lambda: whole.matching(["v"]), lambda: whole.plot("v")):
        problem(refused, r"^no signal v in the run")


@pytest.mark.parametrize(
    ("pattern", "selected"),
    [
        ("y[1]", ["a.sub.y[1]", "b.y[1]"]),  # an element, no set of letters
        ("sub.y[1]", ["a.sub.y[1]"]),  # a variable with a dot
        ("a.sub.y", ["a.sub.y[1]", "a.sub.y[2]"]),  # an array
        ("sub.y", ["a.sub.y[1]", "a.sub.y[2]"]),
        ("m[1,*]", ["b.m[1,1]", "b.m[1,2]"]),
        ("sub.*", ["a.sub.y[1]", "a.sub.y[2]"]),
        ("y[?]", ["a.sub.y[1]", "a.sub.y[2]", "b.y[1]"]),
        ("b.*", ["b.y[1]", "b.m[1,1]", "b.m[1,2]", "b.m[2,1]"]),
        ("[ab].*", []),
        ("ub.y", []),
        ("y1", []),
    ],
)
def test_one_rule_for_the_names_of_signals(pattern, selected):
    """With dots, of elements and of arrays; only * and ? are wild."""
    names = ["a.sub.y[1]", "a.sub.y[2]", "b.y[1]", "b.m[1,1]", "b.m[1,2]", "b.m[2,1]"]
    assert matching(names, pattern) == selected
    trace = Trace(TIME, {name: np.full(101, k) for k, name in enumerate(names)})
    if selected:
        assert trace.matching([pattern]) == selected
    if len(selected) == 1:
        assert trace[pattern][0] == names.index(selected[0])


def test_a_joint_has_its_colour_in_each_panel():
    """The first word of a name gives the colour, whatever the order; line styles tell its curves apart."""
    trace = waves(a__boom_u="V", a__stick_u="V", m__stick_q="rad", m__boom_q="rad", m__boom_r="rad")
    first, second = (axes.lines for axes in trace.plot().axes)
    assert first[0].get_color() == second[1].get_color() == second[2].get_color() != first[1].get_color()
    assert first[1].get_color() == second[0].get_color()
    assert second[1].get_linestyle() != second[2].get_linestyle()


def test_names_and_windows_of_a_figure():
    """The legend shortens names that are unique; samples from start to stop, refused if there are none."""
    assert legends(waves(a__x="m", b__x="m", b__y="m").plot()) == [["a.x", "b.x", "y"]]
    (axes,) = waves(a__x="m").plot(start=0.25, stop=0.5).axes
    assert (axes.lines[0].get_xdata()[0], axes.lines[0].get_xdata()[-1]) == (0.25, 0.5)
    problem(lambda: waves(a__x="m").plot(start=2), "two or more samples, got 0; the samples cover 0 to 1 s")


def test_runs_in_one_figure_have_the_colours_of_their_signals():
    """A second run has another line style; its samples may be at other times."""
    other = waves(a__x="m", a__y="m").at(np.linspace(0, 2, 30))
    (axes,) = waves(a__x="m", a__y="m").plot(label="first", others={"second": other}).axes
    x, x_other, y, _ = axes.lines
    assert x.get_color() == x_other.get_color() != y.get_color()
    assert x.get_linestyle() != x_other.get_linestyle()
    assert legends(axes.figure) == [["x", "y"]]


@pytest.fixture
def here(tmp_path, monkeypatch):
    """An empty working directory."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_plot_draws_the_newest_trace_to_a_file(here, fmus, capsys):
    """On a page, or as a picture in the format of its name."""
    assert main(["plot"]) == 2
    assert "build: expected the trace of a run, got none" in capsys.readouterr().err
    assert main(["run", str(fmus["mass_b"]), "--stop", "0.1", "--out", "build/new.mat"]) == 0
    for suffix in (".mat", ".run.json"):
        shutil.copy(f"build/new{suffix}", f"build/old{suffix}")
        os.utime(f"build/old{suffix}", (0.0, 0.0))
    assert newest_trace(Path("build")) == Path("build/new.mat")
    capsys.readouterr()
    assert main(["plot"]) == 0
    told = capsys.readouterr().out
    assert "signals of build/new.mat; choose others with --signals PATTERN" in told
    assert "page: build/plot.html" in told
    assert 'aria-label="new"' in (here / "build/plot.html").read_text(encoding="utf-8")
    assert main(["plot", "--out", "a.png"]) == 0
    assert (here / "a.png").read_bytes().startswith(b"\x89PNG")
    assert main(["plot", "build/new.mat", "build/old.mat", "--out", "a/b.svg"]) == 0
    picture = Path("a/b.svg").read_text(encoding="utf-8")
    assert picture.startswith("<?xml")
    assert all(word in picture for word in ("new", "old", "time [s]"))
    assert main(["plot", "build/new.mat", "--out", "b.pdf"]) == 0
    assert Path("b.pdf").read_bytes().startswith(b"%PDF")
    assert main(["plot", "--out", "a.jpg"]) == 2
    assert "a.jpg: expected a file name ending in .png, .svg or .pdf" in capsys.readouterr().err


def test_a_matlab_file_has_structs_of_components_and_units(tmp_path):
    """Names that MATLAB does not know are replaced, long and reserved ones too; our reader restores them."""
    names = ["time_2", "arm.x", "arm.der(v)", "arm", "end.1st", "units.a", "a.b.c", "z" * 70]
    trace = Trace(TIME, {n: TIME + i for i, n in enumerate(names)}, {"arm.x": "m", "arm.der(v)": "m/s"})
    path = write_trace(trace, tmp_path / "t.mat")
    loaded = scipy.io.loadmat(path, simplify_cells=True)
    np.testing.assert_array_equal(loaded["arm"]["x"], trace["arm.x"])
    assert loaded["units"]["arm"] == {"x": "m", "der_v_": "m/s"}
    assert {"xend", "units_", "arm_2", "a", "time"} <= set(loaded)
    back = read_trace(path)
    assert list(back.signals) == names
    assert back.units == trace.units
    assert not list(tmp_path.glob("*.partial*"))


def test_a_matlab_file_of_another_tool_is_a_scenario(tmp_path):
    """Vectors beside a vector `time`, in any order and form."""
    scipy.io.savemat(tmp_path / "s.mat", {"command": np.arange(3.0), "time": np.arange(3.0)[:, None]})
    assert list(read_trace(tmp_path / "s.mat")["command"]) == [0, 1, 2]
    scipy.io.savemat(tmp_path / "t.mat", {"command": np.arange(3.0)})
    with pytest.raises(Problem, match=r"t.mat: expected the first column to be named 'time', got 'command'"):
        read_trace(tmp_path / "t.mat")


@pytest.fixture
def body(fmus):
    """A system of one FMU: parameter mass [kg], input force [N], output x [m]."""
    return assemble({"body": fmus["mass_b"]})


@table(__file__, "values", "kilograms, text")
def test_values_have_units(body, kilograms, text):
    """A text may end with any unit of the same dimension; without one the unit is that of the FMU."""
    start = body.with_start({"body.mass": text}).components["body"].start
    assert start["mass"] == pytest.approx(kilograms, rel=1e-15)  # one rounding of a product


@table(__file__, "units", "text, message")
def test_a_wrong_unit_is_told_with_the_expected_one(body, text, message):
    """In one line with the name, what was given and what the variable has."""
    problem(lambda: body.with_start({"body.mass": text}), message)


# ---- data in memory

RAMP = {"time": [0.0, 0.5, 1.0], "force": [0.0, 0.0, 5.0]}


def test_a_scenario_can_be_a_mapping_or_a_data_frame(body, tmp_path):
    """The same run as with the file; the time may be the index of a data frame."""
    frame = pd.DataFrame(RAMP)
    frame.to_csv(tmp_path / "s.csv", index=False)
    runs = [run(body, s, stop=1.0) for s in (RAMP, frame, frame.set_index("time"), tmp_path / "s.csv")]
    for other in runs[1:]:
        np.testing.assert_array_equal(other["body.x"], runs[0]["body.x"])
    assert np.ptp(runs[0]["body.x"]) > 0


def test_a_scenario_may_jump(body, tmp_path):
    """Of two rows at one time the first is 1 us earlier, or half a shorter interval; at the start none."""
    jumps = {"time": [0.0, 0.0, 0.5, 0.5, 0.5000002, 0.5000002, 1.0], "force": [9.0, 0, 1, 3, 3, 5, 5]}
    (tmp_path / "s.csv").write_text(pd.DataFrame(jumps).to_csv(index=False), encoding="utf-8")
    ramps = {"time": [0.0, 0.499999, 0.5, 0.5000001, 0.5000002, 1.0], "force": jumps["force"][1:]}
    by_hand, *others = (run(body, s, stop=1.0) for s in (ramps, jumps, tmp_path / "s.csv"))
    for other in others:
        # rounding of 0.499999
        np.testing.assert_allclose(other["body.x"], by_hand["body.x"], rtol=0, atol=1e-9)
    np.testing.assert_allclose(read_trace(tmp_path / "s.csv").time, ramps["time"], rtol=1e-15)


@table(__file__, "mappings", "data, message")
def test_mistakes_in_a_mapping_are_told_in_one_line(body, data, message):
    """With column and row, before anything runs."""
    problem(lambda: run(body, data), message)


def test_validate_takes_data_frames(body):
    """Reference and run, in the units of the run."""
    result = run(body, RAMP, stop=1.0)
    frame = result.to_pandas()[["body.x"]]
    (row,) = validate(result, frame).rows
    assert (row.unit, row.metrics.rmse) == (result.trace.units["body.x"], 0.0)
    (row,) = validate(frame, frame + 2).rows
    # 1e-12: rounding of a mean of 1001 equal numbers
    assert row.metrics.rmse == pytest.approx(2.0, rel=1e-12)
