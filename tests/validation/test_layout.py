"""Layouts: what a report shows, read from a file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fmus.machine.build import data
from orchestrator.base.errors import Problem
from orchestrator.data.trace import Trace
from orchestrator.results.layout import FigureSpec, Layout, PanelSpec, read_layout

LAYOUT = """
title = "Shaft"
[[figure]]
title = "Turning"
caption = "of the shaft"
panels = [
    { label = "Angle", signals = ["shaft.angle"] },
    { label = "Pressures", signals = ["pump.pressure", "pump.command"], names = ["p", "u"] },
]
[motion]
angle = "shaft.angle"
tip = "end"
points = [
    { label = "foot", radius = 0, height = 0.5 },
    { label = "end", radius = "pump.command", height = 1.0 },
]
lines = [["foot", "end"]]
"""


def written(folder: Path, text: str) -> Path:
    path = folder / "l.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_all_that_a_layout_holds(tmp_path: Path, trace: Trace) -> None:
    """Title, figures with their panels, and motion come out as they were written."""
    layout = read_layout(written(tmp_path, LAYOUT))
    panels = (
        PanelSpec("Angle", ("shaft.angle",)),
        PanelSpec("Pressures", ("pump.pressure", "pump.command"), ("p", "u")),
    )
    assert (layout.title, layout.figures) == ("Shaft", (FigureSpec("Turning", panels, "of the shaft"),))
    layout.check(trace)
    motion = layout.motion(trace)
    assert motion is not None
    assert (motion.tip, motion.lines, motion.turning) == ("end", (("foot", "end"),), True)
    radius, angle = trace["pump.command"], trace["shaft.angle"]
    expected = np.column_stack((radius * np.cos(angle), radius * np.sin(angle), np.ones(len(radius))))
    np.testing.assert_array_equal(motion.points["end"], expected)
    np.testing.assert_array_equal(motion.points["foot"], np.tile([0, 0, 0.5], (len(radius), 1)))


def test_a_planar_machine_stays_in_its_plane(tmp_path: Path, trace: Trace) -> None:
    """Without an angle the points keep y = 0, and no view from above is drawn."""
    layout = read_layout(written(tmp_path, LAYOUT.replace('angle = "shaft.angle"\n', "", 1)))
    motion = layout.motion(trace)
    assert motion is not None
    assert motion.views == ("side",)
    assert not motion.points["end"][:, 1].any()


def test_nothing_is_needed(tmp_path: Path, trace: Trace) -> None:
    """An empty file is a layout: no title, no figures, no motion."""
    layout = read_layout(written(tmp_path, ""))
    assert (layout.title, layout.figures, layout.motion(trace)) == ("", (), None)
    layout.check(trace)


def test_no_motion_of_a_trace_without_its_signals(tmp_path: Path, trace: Trace) -> None:
    """A reference need not hold the signals that move the points: it gives no ghost, which is no mistake."""
    layout = read_layout(written(tmp_path, LAYOUT))
    assert layout.motion(trace.select(["shaft.angle"])) is None


def test_the_projects_own_layout_can_be_read() -> None:
    """One figure per actuator with five rows, and a moving arm."""
    layout = read_layout(data("reference/work_cycle.layout.toml"))
    assert [len(figure.panels) for figure in layout.figures] == [5, 5, 5]
    assert [point.label for point in layout.points][-1] == layout.tip == "head"


def test_what_a_run_lacks_can_be_left_out(tmp_path: Path, trace: Trace) -> None:
    """Signals with their names, rows and figures without signals, and a motion that cannot be shown."""
    layout = read_layout(written(tmp_path, LAYOUT))
    assert layout.within(trace) == layout
    kept = layout.within(trace.select(["pump.command"]))
    assert [f.panels for f in kept.figures] == [(PanelSpec("Pressures", ("pump.command",), ("u",)),)]
    assert (kept.points, kept.angle) == ((), "")
    assert layout.within(trace.select([])).figures == ()


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        (
            "shaft.angle",
            "shaft.angel",
            r"figure 'Turning': no signal shaft.angel in the run; did you mean shaft.angle",
        ),
        (
            'radius = "pump.command"',
            'radius = "tip"',
            r"\[motion\] point 'end': no signal tip in the run; there are ",
        ),
        ('angle = "shaft.angle"', 'angle = "a"', r"\[motion\] angle: no signal a in the run"),
    ],
)
def test_a_signal_that_the_run_lacks_is_named(
    tmp_path: Path, trace: Trace, old: str, new: str, told: str
) -> None:
    """With the file, the place and what it could be."""
    path = written(tmp_path, LAYOUT.replace(old, new, 1))
    with pytest.raises(Problem, match=f"l.toml: {told}"):
        read_layout(path).check(trace)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("x = ", r"expected TOML, got "),
        ("colour = 1", r"unknown key 'colour'; there are title, figure, motion"),
        ("titel = 'A'", r"unknown key 'titel'; did you mean title"),
        ("title = 3", r"title: expected a text, got 3"),
        ("figure = 'A'", r"figure: expected a list, got 'A'"),
        ("figure = ['A']", r"figure: 1: expected a table of title, panels, caption, got 'A'"),
        ("[[figure]]\npanels = []", r"figure 1: title: expected a text, got nothing"),
        ("[[figure]]\ntitle = 'A'\npanels = 3", r"figure 1: panels: expected a list, got 3"),
        ("[[figure]]\ntitle = 'A'\npanels = []", r"figure 'A': panels: expected at least one, got none"),
        (
            "[[figure]]\ntitle = 'A'\npanels = [{label = 'b'}]",
            r"figure 1: panels 1: signals: expected a list, got nothing",
        ),
        (
            "[[figure]]\ntitle = 'A'\npanels = [{label = 'b', signals = [1]}]",
            r"figure 1: panels 1: signals: 1: expected a text, got 1",
        ),
        ("[motion]\npoints = 3", r"motion: points: expected a list, got 3"),
        ("[motion]\nangle = 3", r"motion: angle: expected a text, got 3"),
        (
            "[motion]\npoints = [{label = 'a', radius = 1}]",
            r"motion: points 1: height: expected a text or a number, got nothing",
        ),
        (
            "[motion]\npoints = [{label = 'a', radius = true, height = 1}]",
            r"motion: points 1: radius: expected a text or a number, got True",
        ),
        (
            "[motion]\nlines = [['a', 'b']]\npoints = [{label = 'a', radius = 1, height = 1}]",
            r"motion: expected one of the points a, got 'b'",
        ),
        ("[motion]\nlines = 3", r"motion: lines: expected a list, got 3"),
    ],
)
def test_mistakes_name_file_place_and_what_was_expected(tmp_path: Path, text: str, told: str) -> None:
    """A wrong layout is refused when it is read, before anything runs."""
    with pytest.raises(Problem, match=f"l.toml: {told}|l.toml: .*{told}"):
        read_layout(written(tmp_path, text))


def test_a_missing_file_and_a_folder_are_told(tmp_path: Path) -> None:
    """As what they are."""
    with pytest.raises(Problem, match=r"none.toml: no such file"):
        read_layout(tmp_path / "none.toml")
    with pytest.raises(Problem, match=r"cannot be read: "):
        read_layout(tmp_path)


def test_a_bare_layout_shows_nothing(trace: Trace) -> None:
    """The default layout of `harvester validate` has a row for each signal."""
    assert Layout().motion(trace) is None
