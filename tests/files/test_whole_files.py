"""Files are written completely or not at all, whatever stops the work, and by one function."""

import errno
import re
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from kit.mistakes import entry, problem

from orchestrator.base.files import put, write_columns, write_rows, write_whole
from orchestrator.engine.result import read_metadata
from orchestrator.pages.figures import TraceFigure, TraceLine, TracePanel, plot

ROOT = Path(__file__).parents[2]
WRITERS = [
    partial(write_whole, content=b"new"),
    partial(write_whole, content="new"),
    partial(write_rows, rows=[["a"], [1]]),
    partial(write_columns, names=["a"], rows=np.ones((2, 1)), digits=6),
]
WRITES = r"""\.write_text\(|\.write_bytes\(|open\(["'][wax+]|savefig\(f?["']|\.to_csv\([^)f]"""


@pytest.mark.parametrize("write", WRITERS)
def test_a_full_disk_leaves_the_earlier_file_and_names_the_new_one(tmp_path, monkeypatch, write):
    """And nothing else in the folder."""
    path = tmp_path / "folder" / "a.txt"
    write(path)
    before, real = path.read_bytes(), Path.write_bytes

    def full(file, data):
        real(file, data[:1])
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", full)
    problem(lambda: write(path), r"folder/a\.txt: cannot be written: No space left on device$")
    assert [*path.parent.iterdir()] == [path]
    assert path.read_bytes() == before


def test_a_link_stays_a_link_and_a_pipe_is_written_to(tmp_path):
    """The file behind a link is replaced; what is no file, such as /dev/stdout, is not."""
    file, link = tmp_path / "file", tmp_path / "link"
    file.write_bytes(b"old")
    link.symlink_to(file)
    assert write_whole(link, "new\n") == link
    assert link.is_symlink()
    assert file.read_bytes() == b"new\n"
    folder, given = tmp_path / "folder", []
    folder.mkdir()
    put(folder, given.append)
    assert given == [folder]


def test_no_other_code_writes_files_under_their_final_names():
    """A new place must use `write_whole` or `put`, or be listed with its reason."""
    files = [p for room in ("fmus", "orchestrator") for p in sorted((ROOT / room).rglob("*.py"))]
    found = {p.relative_to(ROOT).as_posix() for p in files if re.search(WRITES, p.read_text("utf-8"))}
    assert found == entry(__file__, "own").keys()


@pytest.mark.parametrize("text", ["[" * 100_000, '{"a":' * 100_000, '{"sha256": ' + "[" * 50_000])
def test_metadata_that_are_nested_too_deeply_are_refused_in_one_line(tmp_path, text):
    """As other damaged ones are."""
    trace = tmp_path / "a.csv"
    trace.write_text("time,a.y\n0,0\n1,1\n", "utf-8")
    trace.with_suffix(".run.json").write_text(text, "utf-8")
    problem(lambda: read_metadata(trace), r"a\.run\.json: expected what harvester run writes")


@pytest.mark.parametrize("time", [0.0, 0.04, -2.0])
@pytest.mark.parametrize("window", [False, True])
def test_a_figure_of_one_point_in_time_has_axes_around_it(time, window):
    """Such as the bands of a study that stops before its first band step."""
    line = TraceLine(np.array([time]), np.array([1.0]), {"color": "black"}, "a")
    figure = TraceFigure([TracePanel("m", [line])], (time, time) if window else None)
    start, stop = figure.span
    assert start < time < stop
    assert "nan" not in str(plot(figure, "a")).lower()
