"""One FMU: instances, failures, messages, rollback, slopes, clean-up."""

import ctypes
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import fmpy
import numpy as np
import pytest
from kit.any_fmu.description import packed
from kit.mistakes import problem, table
from kit.needs import needs

from orchestrator import Problem
from orchestrator.base import files as base_files
from orchestrator.base.files import Location
from orchestrator.fmi.calls import compatible_buffer
from orchestrator.fmi.library import SUFFIX, load_library

USES = """
import sys, tempfile
from pathlib import Path
from orchestrator.base.files import Location, _unpacked
from orchestrator.fmi.cosimulation import UNUSED

def unpacked(path):
    with Location(Path(path)).unpacked(UNUSED) as folder:
        return folder

first, other = sys.argv[1:]
folder = unpacked(first)
assert unpacked(first) == folder
(folder / "left by a run").touch()
again = unpacked(first)
assert again != folder and not folder.exists()
Path(first).write_bytes(Path(other).read_bytes())
assert unpacked(first) != again
assert len([*Path(tempfile.gettempdir()).glob("fmu-*")]) == 2
"""


def test_unpacked_files_stay_for_the_next_run_only(each, tmp_path):
    """Unless a run has changed them or the file is another one; the end of the process removes them."""
    files = [shutil.copy(each[name], tmp_path / f"{name}.fmu") for name in ("gain", "types")]
    environment = {**os.environ, "TMPDIR": str(tmp_path), "TEMP": str(tmp_path), "TMP": str(tmp_path)}
    subprocess.run([sys.executable, "-c", USES, *files], env=environment, check=True)
    assert [*tmp_path.glob("fmu-*")] == []


@pytest.fixture
def kept(tmp_path, monkeypatch):
    """kept(name, content): the number of folders that stay after an archive with this file has been used."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr(base_files, "_unpacked", {})

    def used(name, content="a"):
        packed(tmp_path / name, {"a": content})
        with Location(tmp_path / name).unpacked():
            pass
        return len([*tmp_path.glob("fmu-*")])

    return used


@needs("Linux", "elsewhere none stay")
def test_folders_stay_up_to_64_megabytes(kept):
    """All together, the last ones."""
    assert [kept(f"{k}.zip", f"{k}" * 30_000_000) for k in range(3)] == [1, 2, 2]
    assert kept("small.zip") == 3
    assert kept("large.zip", bytes(64_000_001)) == 3


def test_a_folder_whose_library_is_still_loaded_does_not_stay(each, kept, tmp_path, monkeypatch):
    """Nor does any where the system does not tell: variables of a library would keep their values."""
    with Location(each["gain"]).unpacked() as folder:
        library = next(folder.glob(f"binaries/*/*{SUFFIX}")).read_bytes()
    monkeypatch.setattr(base_files, "_unpacked", {})
    before = len([*tmp_path.glob("fmu-*")])
    for load in (False, True):
        packed(tmp_path / f"{load}.zip", {f"{load}.so": library + bytes([load])})
        with Location(tmp_path / f"{load}.zip").unpacked() as folder:
            if load:
                ctypes.CDLL(str(folder / "True.so"))
        assert len([*tmp_path.glob("fmu-*")]) == before + (sys.platform == "linux")
    monkeypatch.setattr(base_files, "_is_loaded", lambda _: True)
    assert kept("unknown.zip") == before + (sys.platform == "linux")


def test_an_archive_that_is_written_again_is_unpacked_again(kept, tmp_path):
    """Also with the same size and time of change."""
    kept("one.zip", "a")
    times = os.stat(tmp_path / "one.zip")
    packed(tmp_path / "one.zip", {"a": "b"})
    os.utime(tmp_path / "one.zip", ns=(times.st_atime_ns, times.st_mtime_ns))
    with Location(tmp_path / "one.zip").unpacked() as folder:
        assert (folder / "a").read_text() == "b"


def test_a_failed_start_leaves_nothing_open(each, tmp_path, monkeypatch, opened):
    """The next start of the same file works in the same folder."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    stranger = each.make("gain", "stranger", guid="nobody knows me")
    for _ in range(2):
        problem(lambda: opened(stranger))
    assert len([*tmp_path.glob("fmu-*")]) == 1


def test_a_missing_or_broken_binary_and_a_failed_start_are_told(each, opened, tmp_path):
    """Expected and found, with component and FMU; what the FMU says, with its printf arguments."""
    (folder := tmp_path / "binaries" / fmpy.platform).mkdir(parents=True)
    (folder / f"x{fmpy.sharedLibraryExtension}").write_text("no library")
    problem(lambda: load_library(tmp_path, "x", 2, "label"), r"label: x\..* cannot be loaded")
    told = r"it \(.*foreign.fmu\): no binary for this platform: expected binaries/.*got binaries/amiga/f"
    problem(lambda: opened(each.make("gain", "foreign", platform="amiga")), told)
    problem(lambda: opened(each.make("gain", "bare", platform="")), "got no binaries at all")
    with pytest.raises(Problem, match="could not be instantiated; it says: wrong guid impostor"):
        opened(each.make("gain", "impostor", guid="impostor"))


@table(__file__, "failures", "version, how, message")
def test_a_failed_step_tells_when_and_why(fmus, fmus3, version, how, message, started):
    """Component, time, status, and the FMU's own words."""
    slave = started({2: fmus, 3: fmus3}[version]["fails"], when=0.15, how=how)
    slave.set("u", 1.0)
    slave.step(0.0, 0.1)
    slave.step(0.1, 0.1)
    problem(lambda: slave.step(0.2, 0.1), r"^it: .*the step " + message)


def test_warnings_are_kept_and_counted(each, started):
    """Equal warnings become one line."""
    slave = started(each["fails"], when=0.0, how=1)
    for n in range(3):
        slave.step(0.1 * n, 0.1)
    assert slave.log.warnings() == ["it: the oil is warm at: 0 (3 times, first at t = 0 s)"]


def test_messages_go_to_the_instance_that_sent_them(each, opened):
    """Two instances of one FMU, and FMPy's own logger beside them."""
    first, second = opened(each["fails"], "first"), opened(each["fails"], "second")
    for slave in (first, second):
        slave.setup(0.0, 1.0, None)
    problem(lambda: second.exit(), f"second: fmi{each.fmi}ExitInitializationMode failed")
    assert (len(first.log.messages), len(second.log.messages)) == (0, 1)


def test_restoring_a_state_repeats_the_step_exactly(each, started):
    """Save, step, restore, step: bit for bit, in the same instance, and as bytes in another one."""
    first, second = started(each["mass_b"]), started(each["mass_b"])
    first.step(0.0, 0.1)
    state = first.save()
    first.step(0.1, 0.1)
    once = first.get("x")
    for slave, saved in ((first, state), (second, second.fmu.deserialize(first.fmu.serialize(state)))):
        slave.restore(saved)
        slave.step(0.1, 0.1)
        assert slave.get("x") == once != 0.0
        slave.free_state(saved)


def test_readers_and_writers_use_slices_in_place(each, started):
    """Several variables in one call, into the middle of an array."""
    slave = started(each["gain"])
    values = np.array([-1.0, 3.0, 2.0, 0.5, -1.0])
    slave.writer(["u", "factor", "offset"], values[1:4])()
    slave.reader(["y"], values[4:])()
    np.testing.assert_array_equal(values, [-1.0, 3.0, 2.0, 0.5, 6.5])
    # a slice with gaps, or of another type, would be written beside
    with pytest.raises(ValueError, match="expected 2 contiguous values"):
        compatible_buffer(np.zeros(4)[::2], 2, ctypes.c_double)
    with pytest.raises(ValueError, match="float32"):
        compatible_buffer(np.zeros(2, np.float32), 2, ctypes.c_double)


@needs("Linux", "looks into /proc")
def test_instances_leave_nothing_behind(each, opened):
    """Their libraries are unloaded, and none of their files is mapped any more."""
    maps = Path("/proc/self/maps")
    for _ in range(5):
        opened(each["gain"]).close()
    assert "gain.so" not in maps.read_text()
