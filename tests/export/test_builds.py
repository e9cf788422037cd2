"""Builds: the same bytes anywhere, whole files or none, no work done twice; the command."""

import os
import subprocess
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from kit import shards
from kit.mistakes import refused, table

from fmus.export.build import build
from fmus.export.compile import FLAGS, PLATFORMS, host
from fmus.machine.build import harvester
from orchestrator.__main__ import main
from orchestrator.base.errors import Problem

CACHE = "orchestrator.base.compiler.cache_folder"
# compiles the C library of each, in minutes
EVERY = pytest.param(tuple(PLATFORMS), marks=shards.platforms)


@pytest.mark.parametrize("platforms", [(host(), "wasm"), EVERY])
def test_building_elsewhere_gives_the_same_bytes(toys, tmp_path, monkeypatch, platforms):
    """The file does not depend on the time, the folder or the order in which the compilers finish."""
    sub, numbers = toys["gain"]
    built = []
    for place in ("here", "some where else"):
        scratch = tmp_path / place / "scratch"
        scratch.mkdir(parents=True)
        monkeypatch.setattr("tempfile.tempdir", str(scratch))
        monkeypatch.setattr(CACHE, lambda place=place: tmp_path / place / "store")
        built.append(build(sub, tmp_path / place, values=numbers, platforms=platforms).read_bytes())
        assert not list(scratch.iterdir())  # nothing is left of the compilers' files
    assert built[0] == built[1]


def test_second_build_needs_no_compiler(toys, tmp_path, monkeypatch):
    """For equal code, flags and platform the library comes from the cache."""
    monkeypatch.setattr(CACHE, lambda: tmp_path / "store")
    sub, numbers = toys["gain"]
    first = build(sub, tmp_path / "first", values=numbers).read_bytes()
    assert build(sub, tmp_path / "other", values=numbers, step=0.5).read_bytes() != first

    def compiler(*_, **__):
        raise AssertionError("the compiler was called")

    monkeypatch.setattr("orchestrator.base.compiler.subprocess.run", compiler)
    assert build(sub, tmp_path / "second", values=numbers).read_bytes() == first
    arm = {"platforms": ("aarch64-linux",)}
    for other, flags in (({"fmi": 3}, FLAGS), (arm, FLAGS), ({}, ("-O1", *FLAGS))):
        monkeypatch.setattr("fmus.export.compile.FLAGS", flags)
        with pytest.raises(AssertionError, match="compiler was called"):
            build(sub, tmp_path / "third", values=numbers, **other)


def test_builds_at_once_compile_each_part_once(toys, tmp_path, monkeypatch):
    """Both versions share the equations and the solver; who comes second waits for the file in the cache."""
    monkeypatch.setattr(CACHE, lambda: tmp_path / "store")
    made: list[str] = []

    def compiler(command, cwd, **_):
        made.append(command[-1])
        time.sleep(0.05)
        (cwd / Path(command[-1])).write_bytes(os.urandom(8))  # no two files are equal
        return subprocess.CompletedProcess(command, 0, "", "")

    monkeypatch.setattr("orchestrator.base.compiler.subprocess.run", compiler)
    sub, numbers = toys["gain"]
    given = {"values": numbers, "platforms": ["x86_64-linux"]}
    with ThreadPoolExecutor(4) as pool:
        for n in range(4):
            pool.submit(build, sub, tmp_path / str(n), fmi=2 + n % 2, **given)
    shells = [name for name in ("gain.so", "gain_fmi.o") for _ in (2, 3)]
    assert sorted(made) == sorted([*shells, "gain_initial.o", "gain_model.o"])


def test_store_that_cannot_be_written_to_keeps_nothing(toys, tmp_path, monkeypatch):
    """The build also works if the home folder is read-only."""
    (tmp_path / "file").write_text("no folder")
    monkeypatch.setattr(CACHE, lambda: tmp_path / "file" / "store")
    sub, numbers = toys["gain"]
    assert build(sub, tmp_path, values=numbers).is_file()


def interrupted(*_):
    raise KeyboardInterrupt


BROKEN = r"^gain, [\w-]+: the C compiler failed with exit status 1: gain_fmu.c:1:2: error: broken$"
FAILURES = [
    ("fmus.export.build.sources", lambda *_: {"gain_fmu.c": "#error broken\n"}, Problem, BROKEN),
    ("zipfile.ZipFile.writestr", interrupted, KeyboardInterrupt, "^$"),
]


@pytest.mark.parametrize(("broken", "instead", "error", "text"), FAILURES, ids=["compiler", "interrupt"])
def test_a_build_that_fails_leaves_what_was_there(toys, tmp_path, monkeypatch, broken, instead, error, text):
    """A compiler that fails, in its words, or an interrupt during the writing: only the old file is there."""
    sub, numbers = toys["gain"]
    old = build(sub, tmp_path, values=numbers)
    before = old.read_bytes()
    monkeypatch.setattr(broken, instead)
    with pytest.raises(error, match=text):
        build(sub, tmp_path, step=0.5, values=numbers)
    assert [p.name for p in tmp_path.iterdir()] == ["gain.fmu"]
    assert old.read_bytes() == before


# ---- the command -----------------------------------------------------------------------------------


@table(__file__, "mistakes", "option, told")
def test_command_tells_what_it_expects(tmp_path, capsys, option, told):
    """One line and exit status 2; no folder is made."""
    assert refused(capsys, ["build", "--out", tmp_path / "new", *option]).startswith(f"harvester: {told}")
    assert not (tmp_path / "new").exists()


ARM = ("--platform", "aarch64-linux")


@pytest.mark.parametrize(
    ("options", "versions", "platforms", "numbers"),
    [
        ([], (2, 3), (host(),), None),
        (["--fmi", "3", "--platform", "all"], (3,), tuple(PLATFORMS), None),
        (["--fmi", "2", *ARM, "--platform", "host"], (2,), ("aarch64-linux", host()), None),
        (["--parameters", "own.toml"], (2, 3), (host(),), Path("own.toml")),
    ],
)
def test_command_builds_what_is_asked_for(tmp_path, monkeypatch, options, versions, platforms, numbers):
    """By default both versions are built for this platform, with the values of the parts."""
    asked = []
    monkeypatch.setattr("fmus.machine.build.Build.write", lambda _, *where: asked.append(where) or [])
    made, given = harvester(), list[Path | None]()
    monkeypatch.setattr("fmus.machine.build.harvester", lambda own, _: given.append(own) or made)
    assert main(["build", "--out", str(tmp_path), *options]) == 0
    ((folder, fmi, names, *_),), (own,) = asked, given
    assert (folder, fmi, set(names), own) == (tmp_path, versions, set(platforms), numbers)
