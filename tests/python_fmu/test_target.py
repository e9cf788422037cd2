"""What an FMU in Python says where something is missing, and how it runs in programs without Python."""

import json
import re
import shutil
import subprocess
import sys
import sysconfig
import zipfile
from pathlib import Path

import lief
import numpy as np
import pytest
import pythonfmu
from fmpy import read_model_description
from kit import shards
from kit.any_fmu.edit import edited, renamed
from kit.compile import WARNINGS, compiled
from kit.fmu import Fmu, in_new_process
from kit.mistakes import table
from kit.needs import lacks, needs

from fmus.export.compile import PLATFORMS, host
from fmus.export.python.build import build_user
from orchestrator import load, run
from orchestrator.base.files import write_zip
from orchestrator.check.checking import check
from orchestrator.ssp.swap import with_swaps
from orchestrator.ssp.write import write_ssp
from python_fmu.lag import built, written

BLOCKED = """
import sys
sys.modules["fmus"] = None  # as if it were not installed
from pathlib import Path
from kit.fmu import Fmu
try:
    Fmu(Path(sys.argv[1]))
except Exception as problem:
    print(type(problem).__name__)
"""

PUSHED = """
import os, sys
from pathlib import Path
from kit.fmu import Fmu
fmu = Fmu(Path(sys.argv[1])).start(boom_command=3.0)
print(fmu.step(1e-3, 50).get("boom_force", "stick_force").tobytes().hex(), flush=True)
os._exit(0)
"""


def test_a_missing_package_is_told(actuator):
    """If the package is not installed, the message contains what the FMU needs, in which Python."""
    out = in_new_process(BLOCKED, actuator)
    assert re.search(r"ERROR.*my_actuator needs the package harvester-cosim \S+ in the Python in \S+: ", out)


@table(__file__, "cards", "key, value, message")
def test_an_fmu_that_does_not_fit_here_is_refused(actuator, tmp_path, capsys, key, value, message):
    """Another version, a file that is missing, files of different builds: one line each."""
    with zipfile.ZipFile(actuator) as archive:
        content = {name: archive.read(name) for name in archive.namelist()}
    card = json.loads(content["resources/model.json"]) | {key: value}
    write_zip(tmp_path / "changed.fmu", content | {"resources/model.json": json.dumps(card).encode()})
    with pytest.raises(Exception, match="Failed to instantiate"):
        Fmu(tmp_path / "changed.fmu")
    (line,) = capsys.readouterr().out.splitlines()
    assert line.startswith("[ERROR] ")
    assert message in line


@pytest.mark.parametrize("run", [False, pytest.param(True, marks=shards.machine)], ids=["files", "run"])
def test_check_finds_nothing_but_python(tmp_path, run):
    """`harvester check` finds no error and notes that Python is needed."""
    report = check(built(tmp_path, fmi=3 if run else 2), run=run)
    assert [f for f in report.findings if f.severity == "error"] == []
    found = {f.rule: f.text for f in report.findings}
    assert "needs Python on the target" in found["python.needed"]


@needs("Linux", "the program is written for Linux")
def test_a_program_without_python_runs_it(tmp_path):
    """A program in C loads the library and runs the FMU twice, or gets a message about what is missing."""
    host = Path(__file__).with_name("host.c")
    program, fmu = compiled("host", [host], "-O1", *WARNINGS, "-ldl"), built(tmp_path)
    shutil.unpack_archive(fmu, tmp_path / "lag", "zip")
    (binary,) = (tmp_path / "lag" / "binaries").rglob("*.so")
    resources, guid = (tmp_path / "lag" / "resources").as_uri(), read_model_description(str(fmu)).guid

    def run(**environment: str) -> str:
        command = [program, binary, resources, guid]
        return subprocess.run(command, capture_output=True, text=True, check=False, env=environment).stdout

    here = Path(sysconfig.get_config_var("LIBDIR"), sysconfig.get_config_var("INSTSONAME"))
    if not here.is_file() or here.suffix == ".a":
        lacks("a Python that is a shared library")
    missing = run(FMU_PYTHON=str(here), PYTHONHOME=sys.base_prefix)
    assert "logStatusError: lag needs the package harvester-cosim" in missing
    path = ":".join(p for p in sys.path if p)
    done = run(FMU_PYTHON=str(here), PYTHONHOME=sys.base_prefix, PYTHONPATH=path)
    assert done.splitlines() == ["value 0.10000000000000001"] * 2 + ["done"]


# for another system the compiler first makes its C library
@pytest.mark.parametrize("platform", shards.few([host()], PLATFORMS, shards.platforms))
def test_there_is_a_library_for_each_platform(tmp_path, platform):
    """The library compiles for all platforms without a warning, and needs no library of Python."""
    with zipfile.ZipFile(build_user(written(tmp_path), tmp_path, [platform], 3)) as archive:
        (binary,) = (name for name in archive.namelist() if name.startswith("binaries/"))
        parsed = lief.parse(list(archive.read(binary)))  # it has to outlive its libraries
    names = [str(getattr(needed, "name", needed)) for needed in parsed.libraries]
    assert names
    assert not [name for name in names if re.search(r"libpython|python3|Python\.framework", name)]


def test_pythonfmu_runs_the_same_slave(actuator, tmp_path):
    """With the library of PythonFMU the slave gives the same results.

    In a process of its own: that library frees a dictionary of the script's module once too often.
    """
    theirs = tmp_path / "theirs.fmu"
    folder = Path(pythonfmu.__file__).parent / "resources" / "binaries"
    with zipfile.ZipFile(actuator) as archive:
        content = {n: archive.read(n) for n in archive.namelist() if not n.startswith("binaries/")}
    for path in folder.rglob("*pythonfmu-export.*"):
        content[f"binaries/{path.parent.name}/my_actuator{path.suffix}"] = path.read_bytes()
    write_zip(theirs, content)
    found = [in_new_process(PUSHED, path).splitlines()[-1] for path in (actuator, theirs)]
    assert found[0] == found[1]
    assert len(found[0]) == 32


# ---- An FMU in Python in the machine: the example's model by hand


@shards.machine
def test_the_example_stands_in_for_boom_and_stick(system, actuator):
    """The look-up table moves the machine through the start of the work cycle as the lumped drives do."""
    lumped = run(system, stop=5.0).trace
    table = run(system, stop=5.0, swap={"boom_stick": str(actuator)}).trace
    for angle in ("manipulator.boom_angle", "manipulator.stick_angle"):
        moved = np.ptp(lumped[angle])
        assert moved > 0.2  # rad
        # a static table in the place of hoses and chambers: measured 10 and 8 % of the motion
        assert np.abs(table[angle] - lumped[angle]).max() < 0.2 * moved


def test_an_fmu_without_load_pressure_runs_and_says_so(system, actuator, tmp_path):
    """Its wire is left out with a note, with a warning only if the supply needs the load; also in an SSP."""
    line = f"{actuator} has no boom_stick_load_pressure: the load of boom_stick is not sensed"
    usual = run(system, stop=0.1, swap={"boom_stick": str(actuator)})
    assert line in usual.card.notes
    assert usual.card.warnings == ()
    assert (usual.trace["supply.boom_stick_load_pressure"] == 0.0).all()
    needed = run(system, stop=0.1, swap={"boom_stick": str(actuator), "supply": "load_sensing"})
    assert f"{line}; supply (supply_load_sensing) could use this signal" in needed.card.warnings
    assert not any("load_pressure" in note for note in needed.card.notes)
    wires = [str(c) for c in load(write_ssp(needed.system, tmp_path / "mine.ssp")).connections]
    assert wires == [str(c) for c in needed.system.connections]
    assert not any("boom_stick_load_pressure" in wire for wire in wires)


def test_an_fmu_of_the_version_before_fits(fmu_dir, system, tmp_path):
    """Each part without the new ports: one line for each lost signal, none for its rate."""
    new = re.compile("load_pressure|load_sensing|payload_mass")
    notes = {
        "swing": ["flow is not shared with the other drives", "the load of swing is not sensed"],
        "boom_stick": ["flow is not shared with the other drives", "the load of boom_stick is not sensed"],
        "manipulator": ["the head holds nothing"],
        "supply": ["flow is not shared", "the load of swing is", "the load of boom_stick is"],
    }
    for part, expected in notes.items():
        names = [n for n in system.components[part].interface.variables if new.search(n)]
        changes = [renamed(n, f"other_{n}") for n in names]
        changes.append(("<VendorAnnotations>.*</VendorAnnotations>", ""))
        old = edited(fmu_dir / f"{part}.fmu", tmp_path / f"{part}.fmu", *changes)
        swapped = with_swaps(system, {part: old})
        said = [note for note in swapped.notes if note.startswith(f"{old} has no ")]
        assert all(len([note for note in said if text in note]) == 1 for text in expected), said
        assert not any(f"{name}_rate" in note for note in said for name in names)
        assert swapped.warnings == ()
