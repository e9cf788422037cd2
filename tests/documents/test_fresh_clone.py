"""The last commit in an empty folder: the site, and the wheel alone with the commands of README."""

import os
import re
import subprocess
from pathlib import Path
from time import perf_counter

import pytest
from kit import shards
from kit.mistakes import entry
from kit.tutorial import Page

# s, ten times what they take on two idle cores; these only bound a failure
SLOW = pytest.mark.timeout(6000)
ROOT = Path(__file__).parents[2]
EXTRAS = "model,build,view,sweep,identify,control"  # of README's commands
TRIED, ELSEWHERE = entry(__file__, "tried"), entry(__file__, "elsewhere")


@pytest.fixture
def clone(tmp_path):
    """The files of the last commit, without an environment."""
    subprocess.run(["git", "clone", "--quiet", "--depth=1", f"file://{ROOT}", tmp_path / "clone"], check=True)
    return tmp_path / "clone"


def ran(folder, *command):
    """What a command prints that must succeed; no environment is active."""
    environment = {name: value for name, value in os.environ.items() if name != "VIRTUAL_ENV"}
    options = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True, "check": False}
    done = subprocess.run(command, cwd=folder, env=environment, **options)
    assert done.returncode == 0, done.stdout
    return done.stdout


def test_every_target_of_the_makefile_has_a_trial():
    """In a fresh clone, or the reason why not."""
    text = (ROOT / "Makefile").read_text(encoding="utf-8").replace("\\\n", " ")
    targets = set(re.findall(r"^\.PHONY: (.*)$", text, re.MULTILINE)[0].split())
    tried = {target for group in TRIED.values() for target in group}
    assert targets - {*tried, *ELSEWHERE} == set()


@shards.targets
@SLOW
@pytest.mark.parametrize("installation", TRIED)
def test_targets_run_in_a_fresh_clone(installation, clone):
    """Each installs what it needs."""
    for target, variables in TRIED[installation].items():
        begin = perf_counter()
        assert "Traceback" not in ran(clone, "make", target, *variables), target
        print(f"make {target}: {perf_counter() - begin:.0f} s")


@shards.targets
@SLOW
def test_the_commands_of_readme_after_make_demo(clone):
    """In order, with what `make demo` has installed and built."""
    ran(clone, "make", "demo")
    assert "Demonstration" in (clone / "build" / "report.html").read_text(encoding="utf-8")
    Page(clone / "README.md", clone, programs=clone / ".venv" / "bin").run()


@shards.fresh
@SLOW
def test_make_docs_needs_nothing_else(clone):
    """It installs what it needs, builds the FMUs of the home page, and writes every page."""
    ran(clone, "make", "docs")
    site = clone / "build" / "site"
    assert (site / "index.html").is_file()
    for page in (clone / "docs").rglob("*.md"):
        assert (site / page.relative_to(clone)).with_suffix(".html").is_file(), page
    assert 'class="harvester-machine"' in (site / "docs" / "index.html").read_text(encoding="utf-8")


@shards.fresh
@SLOW
def test_the_wheel_alone(clone, tmp_path):
    """In an empty folder: some commands without extras, then those of README with theirs.

    The environment without extras has at most 350 MB, with byte code and pip.
    """
    ran(clone, "make", "release", "PLATFORMS=host")
    (wheel,) = (clone / "dist").glob("*.whl")
    place, empty = tmp_path / "environment", tmp_path / "empty"
    empty.mkdir()
    ran(clone, ".venv/bin/python", "-m", "venv", place)
    pip = [place / "bin" / "python", "-m", "pip", "install", "--quiet", "-c", "constraints.txt"]
    ran(clone, *pip, wheel)
    size = sum(p.lstat().st_size for p in place.rglob("*") if p.is_file() and not p.is_symlink())
    assert size <= 350e6, f"{size / 1e6:.0f} MB"
    for command in entry(__file__, "without_extras"):
        ran(tmp_path, place / "bin" / "harvester", *command.split())
    ran(clone, *pip, f"harvester-cosim[{EXTRAS}] @ {wheel.as_uri()}")
    Page(clone / "README.md", empty, programs=place / "bin").run()
    ran(empty, place / "bin" / "harvester", "page")
    assert 'data-part="module"' in (empty / "build" / "report.html").read_text(encoding="utf-8")
