"""The last commit in an empty folder: the site, and the wheel alone with the commands of README."""

import os
import subprocess
from pathlib import Path

import pytest
from kit import shards
from kit.tutorial import Page

# s, ten times what they take on two idle cores; these only bound a failure
pytestmark = [shards.fresh, pytest.mark.timeout(6000)]
ROOT = Path(__file__).parents[2]
EXTRAS = "build,view,sweep,identify"  # of README's commands


@pytest.fixture
def clone(tmp_path):
    """The files of the last commit, without an environment."""
    subprocess.run(["git", "clone", "--quiet", "--depth=1", f"file://{ROOT}", tmp_path / "clone"], check=True)
    return tmp_path / "clone"


def ran(folder, *command):
    """What a command prints that must succeed; no environment is active."""
    environment = {name: value for name, value in os.environ.items() if name != "VIRTUAL_ENV"}
    done = subprocess.run(
        command,
        cwd=folder,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout
    return done.stdout


def test_make_docs_needs_nothing_else(clone):
    """It installs what it needs, builds the FMUs of the home page, and writes every page."""
    ran(clone, "make", "docs")
    site = clone / "build" / "site"
    assert (site / "index.html").is_file()
    for page in (clone / "docs").rglob("*.md"):
        assert (site / page.relative_to(clone)).with_suffix(".html").is_file(), page
    assert 'class="harvester-machine"' in (site / "docs" / "index.html").read_text(encoding="utf-8")


def test_the_wheel_alone_runs_what_readme_prints(clone, tmp_path):
    """In an environment with the wheel and the extras of the commands, from an empty folder."""
    ran(clone, "make", "release", "PLATFORMS=host")
    (wheel,) = (clone / "dist").glob("*.whl")
    place, uv = tmp_path / "environment", clone / ".venv" / "bin" / "uv"
    ran(clone, uv, "venv", "--quiet", "--python", ".venv/bin/python", place)
    wanted = f"harvester-cosim[{EXTRAS}] @ {wheel.as_uri()}"
    ran(clone, uv, "pip", "install", "--quiet", "--python", place, "-c", "constraints.txt", wanted)
    (tmp_path / "empty").mkdir()
    Page(clone / "README.md", tmp_path / "empty", programs=place / "bin").run()
