"""Layouts: what a report shows, read from a file."""

from pathlib import Path

from kit.mistakes import problem, table

from fmus.machine.build import data
from orchestrator.data.trace import Trace
from orchestrator.results.layout import FigureSpec, Layout, PanelSpec, read_layout

LAYOUT = Path(__file__).with_name("layout.toml").read_text(encoding="utf-8")


def written(folder: Path, text: str) -> Path:
    path = folder / "l.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_all_that_a_layout_holds(tmp_path: Path, trace: Trace) -> None:
    """Title and figures with their panels come out as they were written."""
    layout = read_layout(written(tmp_path, LAYOUT))
    panels = (
        PanelSpec("Angle", ("shaft.angle",)),
        PanelSpec("Pressures", ("pump.pressure", "pump.command"), ("p", "u")),
    )
    assert (layout.title, layout.figures) == ("Shaft", (FigureSpec("Turning", panels, "of the shaft"),))
    layout.check(trace)


def test_an_empty_file_and_the_projects_own_are_layouts(tmp_path: Path, trace: Trace) -> None:
    """Nothing is needed; the project has one figure per actuator with five rows."""
    layout = read_layout(written(tmp_path, ""))
    assert layout == Layout(source=layout.source)
    layout.check(trace)
    layout = read_layout(data("reference/work_cycle.layout.toml"))
    assert [len(figure.panels) for figure in layout.figures] == [5, 5, 5]


def test_what_a_run_lacks_can_be_left_out(tmp_path: Path, trace: Trace) -> None:
    """Signals with their names, rows and figures without signals."""
    layout = read_layout(written(tmp_path, LAYOUT))
    assert layout.within(trace) == layout
    kept = layout.within(trace.select(["pump.command"]))
    assert [f.panels for f in kept.figures] == [(PanelSpec("Pressures", ("pump.command",), ("u",)),)]
    assert layout.within(trace.select([])).figures == ()


@table(__file__, "lacking", "old, new, expected")
def test_a_signal_that_the_run_lacks_is_named(tmp_path, trace, old: str, new: str, expected: str) -> None:
    """With the file, the place and what it could be."""
    path = written(tmp_path, LAYOUT.replace(old, new, 1))
    assert f"l.toml: {expected}" in problem(lambda: read_layout(path).check(trace))


@table(__file__, "mistakes", "text, expected")
def test_mistakes_name_file_place_and_what_was_expected(tmp_path: Path, text: str, expected: str) -> None:
    """A wrong layout is refused when it is read, before anything runs."""
    path = written(tmp_path, text)
    line = problem(lambda: read_layout(path))
    assert line.startswith(f"{path}: ")
    assert expected in line


def test_a_missing_file_and_a_folder_are_told(tmp_path: Path) -> None:
    """As what they are."""
    problem(lambda: read_layout(tmp_path / "none.toml"), r"none.toml: no such file")
    problem(lambda: read_layout(tmp_path), "expected a file, got a folder")
