"""harvester rig: what it writes, and what it refuses in one line."""

import pytest
from kit.mistakes import refused, table

from fmus.rig import recordings
from orchestrator.__main__ import main

SHORT = ("motor_leakage_1", "hose_dynamics_1")


@pytest.fixture(autouse=True)
def _few(monkeypatch):
    """Restricts the rig to some experiments, to save time."""
    few = {name: made for name, made in recordings.EXPERIMENTS.items() if name in SHORT}
    monkeypatch.setattr(recordings, "EXPERIMENTS", few)


def test_writes_recordings_and_a_readme(tmp_path, capsys):
    """Each experiment gives two files and a line; the README states that it is simulated."""
    out = tmp_path / "new" / "rig"
    assert main(["rig", "--out", str(out), "--machine", "lumped", "--seed", "7"]) == 0
    files = {f"{name}.{ending}" for name in SHORT for ending in ("csv", "toml")}
    assert {path.name for path in out.iterdir()} == files | {"README.md"}
    text = (out / "README.md").read_text(encoding="utf-8")
    assert "**Simulated.**" in text
    assert "harvester rig --machine lumped --seed 7" in text
    told = capsys.readouterr().out
    assert all(name in told for name in SHORT)


def test_the_number_of_processes_changes_no_byte(tmp_path, monkeypatch):
    """The files and lines of two processes are those of one, in the same order."""
    monkeypatch.setattr(recordings, "MANY", 1)
    lines = {count: list[str]() for count in (1, 2)}
    for count, told in lines.items():
        recordings.write_all(tmp_path / str(count), "lumped", 3, told.append, processes=count)
    one, two = ([*map(str.split, told[2:-1])] for told in lines.values())  # without times
    assert [line[1:] for line in one] == [line[1:] for line in two] != []
    for file in (tmp_path / "1").iterdir():
        assert file.read_bytes() == (tmp_path / "2" / file.name).read_bytes()


def test_writes_over_its_own_files_only(tmp_path, capsys):
    """A folder of the rig is overwritten; a folder with other files is refused."""
    assert main(["rig", "--out", str(tmp_path), "--machine", "lumped"]) == 0
    before = (tmp_path / "motor_leakage_1.csv").read_bytes()
    assert main(["rig", "--out", str(tmp_path), "--machine", "lumped", "--seed", "1"]) == 0
    assert (tmp_path / "motor_leakage_1.csv").read_bytes() != before
    other = tmp_path / "other"
    other.mkdir()
    (other / "my.csv").write_text("mine")
    capsys.readouterr()
    told = refused(capsys, ["rig", "--out", other])
    assert "expected an empty folder or one of the rig, got a folder with my.csv" in told
    assert [path.name for path in other.iterdir()] == ["my.csv"]


@table(__file__, "mistakes", "out, options, told")
def test_mistakes_are_told_in_one_line(out, options, told, tmp_path, capsys):
    """A wrong option, a path that cannot be a folder: one line, and nothing is written."""
    (tmp_path / "file").write_text("")
    assert told in refused(capsys, ["rig", "--out", tmp_path / out, *options])
    assert [path.name for path in tmp_path.iterdir()] == ["file"]
