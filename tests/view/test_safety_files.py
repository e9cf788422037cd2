"""Names of files from a browser: what lies in the folder is found, everything else is one line."""

import os
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from kit.mistakes import problem

from orchestrator.base.errors import Problem
from orchestrator.view import result_files
from orchestrator.view.result_files import find_result, list_results


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Results, and things beside them that must not be read."""
    results = tmp_path / "results"
    (results / "deep").mkdir(parents=True)
    for name in ("run.csv", "deep/more.parquet", "notes.txt"):
        (results / name).write_text("time\n")
    (tmp_path / "secret.csv").write_text("time\n")
    (results / "out.csv").symlink_to(tmp_path / "secret.csv")
    (results / "up").symlink_to(tmp_path)
    (results / "in.csv").symlink_to(results / "run.csv")
    (results / "loop.csv").symlink_to(results / "loop.csv")
    (results / "hidden.csv").symlink_to(results / "notes.txt")
    (results / "dir.csv").mkdir()
    os.mkfifo(results / "pipe.csv")
    return results


def test_found_and_listed(folder: Path) -> None:
    """Files in the folder, below, and where a link inside leads; what is listed can be opened, no more."""
    for name in ("run.csv", "deep/more.parquet"):
        assert find_result(name, [folder / "nowhere", folder]) == find_result(name, [folder]) == folder / name
    assert find_result("in.csv", [folder]) == folder / "run.csv"
    names = list_results([folder])
    assert names == ["run.csv"]
    assert all(find_result(name, [folder]) for name in names)
    assert list_results([folder / "nowhere"]) == []


REFUSED = [
    *("../secret.csv", "deep/../../secret.csv", "..", "/etc/passwd", "/etc/x.csv", "//host/share/x.csv"),
    *("..\\secret.csv", "C:\\x.csv", "C:x.csv", "\\\\host\\x.csv", "~/x.csv", "run.csv\x00.csv", "a\nb.csv"),
    *("out.csv", "up/secret.csv", "up/results/../secret.csv", "loop.csv", "hidden.csv"),
    *("dir.csv", "pipe.csv", "CON.csv", "nul.csv", "deep/com1.parquet", "aux .csv"),
    *("run.csv:stream", "*.csv", "\ud800.csv", "a\u202eb.csv"),
    *("", "notes.txt", "run", ".csv", "nowhere.csv", "a" * 300 + ".csv", None, 3, ["run.csv"], b"run.csv"),
]


@pytest.mark.parametrize("name", REFUSED, ids=ascii)
def test_refused(folder: Path, name: object) -> None:
    """Ways out of the folder, devices, folders, pipes and things that are no name: one short line each."""
    told = problem(lambda: find_result(name, [folder]), r"file(: | '.*': )")
    assert str(folder) not in told, "a browser learns no path of this computer"
    assert len(told) < 200


@given(st.text(max_size=300))
def test_never_outside(name: str) -> None:
    """No text whatever leads to a file outside the folders."""
    with pytest.raises(Problem):
        find_result(name, [Path(__file__).parent])


def test_huge(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A file that would fill the memory is refused by its size, before it is read."""
    monkeypatch.setattr(result_files, "LARGEST", 3)
    with pytest.raises(Problem, match="expected at most"):
        find_result("run.csv", [folder])
