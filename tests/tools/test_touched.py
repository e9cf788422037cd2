"""What `.ci/run` runs whole: the shards that a change touches, by the last landing as far as it is known."""

import re
import subprocess
import sys
from fnmatch import fnmatchcase
from pathlib import Path

import pytest
from kit import shards, touched

ROOT = Path(__file__).parents[2]
ENGINE, SEARCHED = "tests/orchestrator/test_loops.py", "@shards.search\ndef test(): pass\n"


def git(folder, *arguments):
    """What it prints, as an author of its own."""
    author = ["-c", "user.name=a", "-c", "user.email=a@example.org"]
    return subprocess.check_output(["git", *author, *arguments], cwd=folder, text=True).strip()


@pytest.fixture
def history(tmp_path):
    """A repository with four commits, each of which adds a file: a, b, c, d."""
    git(tmp_path, "init", "--quiet", "--initial-branch=main")
    for name in "abcd":
        (tmp_path / name).write_text(name)
        git(tmp_path, "add", name)
        git(tmp_path, "commit", "--quiet", "--message", name)
    return tmp_path


def known(folder):
    """Files that have changed since the last landing, and how this is known."""
    base, how = touched.last_landing(folder)
    return touched.changed(folder, base), how


def test_the_last_landing_is_where_the_change_left_main(history):
    """Also if main has gone on; its own changes are none of the change."""
    git(history, "checkout", "--quiet", "-b", "other", "HEAD~2")
    (history / "e").write_text("e")
    git(history, "add", "e")
    git(history, "commit", "--quiet", "--message", "e")
    git(history, "update-ref", "refs/remotes/origin/main", "main")
    assert known(history) == (["e"], "at which it left origin/main")


def test_without_main_a_record_tells_the_last_landing(history):
    """Main is the change itself, as in a clone after a merge. A record of another history does not count."""
    git(history, "update-ref", "refs/remotes/origin/main", "main")
    (history / ".ci").mkdir()
    (history / touched.LANDED).write_text(git(history, "rev-parse", "HEAD~2") + "\n")
    assert known(history) == (["c", "d"], "in .ci/landed")
    for other in ("0" * 40, git(history, "rev-parse", "HEAD")):
        (history / touched.LANDED).write_text(other)
        assert known(history)[0] == ["b", "c", "d"]


def test_in_a_shallow_clone_nothing_is_known_to_be_touched(history, tmp_path_factory):
    """Nor is it a failure: all shards run in turn."""
    folder = tmp_path_factory.mktemp("shallow") / "clone"
    subprocess.run(["git", "clone", "--quiet", "--depth=1", f"file://{history}", folder], check=True)
    (folder / ".ci").mkdir()
    (folder / touched.LANDED).write_text(git(history, "rev-parse", "HEAD~2"))
    assert known(folder)[0] == []


@pytest.mark.parametrize(
    ("files", "among", "not_among"),
    [
        (["docs/run.md"], {"documents"}, {"fresh", "machine", "c"}),
        (["orchestrator/cli/run.py"], {"documents", "machine"}, {"platforms", "c", "fresh"}),
        (["orchestrator/engine/c/step.c"], {"c", "platforms", "search", "faults"}, {"fresh", "browser"}),
        (["orchestrator/drive/page.js"], {"browser"}, {"c", "search"}),
        (["fmus/export/c/core.c.inc"], {"c", "tools", "platforms"}, {"fresh"}),
        ([ENGINE], {"search"}, {"documents", "machine"}),
        ([ENGINE.replace(".py", ".toml")], {"search"}, {"documents"}),
        (["LICENSE"], set(), {*touched.SHARDS}),
    ],
)
def test_a_change_touches_the_shards_of_its_files(files, among, not_among):
    """By patterns, and the tests of a shard themselves, with their tables."""
    found = touched.touched(files, {ENGINE: SEARCHED})
    assert among <= found
    assert not found & not_among


def test_the_touched_run_whole_and_first_and_the_others_in_turn():
    """In as many runs as it has parts, all of a shard has run."""
    plans = [touched.plan({"c", "fresh"}, turn) for turn in range(8)]
    begin = [(name, how) for name, _, how in plans[0][:3]]
    assert begin == [("fresh", "whole"), ("c", "whole"), ("documents", "part")]
    assert {part for plan in plans for n, part, _ in plan if n == "documents"} == {f"{k}/8" for k in range(8)}


@pytest.mark.parametrize(
    ("test", "file", "is_touched"),
    [
        ("tests/a/test_a.py::test", "tests/a/test_a.py", True),
        ("tests/a/test_a.py::test", "tests/a/test_a.toml", True),
        ("tests/d/test_pages.py::test_runs[docs/run.md]", "docs/run.md", True),
        ("tests/d/test_pages.py::test_runs[first-run]", "docs/tutorials/first-run.md", True),
        ("tests/d/test_pages.py::test_runs[docs/run.md]", "docs/view.md", False),
        ("tests/d/test_pages.py::test_runs", "docs/run.md", False),
    ],
)
def test_a_test_is_touched_by_its_file_its_table_or_its_page(test, file, is_touched):
    """By the names in its parameters."""
    assert touched.is_touched(test, [file]) == is_touched


def test_every_shard_and_pattern_exists():
    """All shards but that for which there is no time; a pattern that fits no file would touch nothing."""
    assert {*touched.SHARDS} == {*shards.SHARDS} - {"targets"}
    files = git(ROOT, "ls-files").splitlines()
    patterns = {pattern for shard in touched.SHARDS.values() for pattern in shard["by"]}
    assert [p for p in patterns if not any(fnmatchcase(file, p) for file in files)] == []


def test_what_is_touched_begins_and_nothing_begins_too_late(tmp_path):
    """First come the tests of the changed file, then those of the part; what has no time left is named."""
    needs, own = "tests/tools/test_needs.py", "tests/tools/test_touched.py"
    (tmp_path / "changed").write_text(own)
    options = [
        f"--first={tmp_path / 'changed'}",
        "--until=1",
        "-v",
        "-k",
        "installs or exists",
        "--part=1/2",
    ]
    command = [sys.executable, "-m", "pytest", *options, needs, own]
    told = subprocess.check_output(command, cwd=ROOT, text=True)
    assert re.findall(r"^(tests/\S+) s", told, re.MULTILINE) == [own, needs]
    assert re.search(r"^not run, 2: needs time; ", told, re.MULTILINE)
