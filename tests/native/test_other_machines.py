"""Binaries for other machines, run where an emulator is installed: the numbers of this machine."""

import shutil
import subprocess
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest
from kit import shards
from kit.needs import ARM, QEMU, WINE, lacks, needs
from native.bench import assert_same, begin, cycle, drive, driver, look, moves, numbers, unpack

from fmus.export.build import build_all
from fmus.machine.build import STEP
from fmus.machine.one_block import HARVESTER
from fmus.machine.parts import FERIC
from fmus.operator_input import OPERATOR
from fmus.operator_input.work_cycle import WORK_CYCLE_STOP

pytestmark = shards.platforms

STOP = 5.0  # s: all three levers have moved


def compare(machines: Any, drivers: Any, folder: Path, platform: str, before: Sequence[str]) -> None:
    """Both versions of the whole machine, its parts and the levers on the other platform, and on this one.

    The parts also as Model Exchange, with a state that is saved, written as bytes, read and restored.
    """
    folders, parts = {version: folder / str(version) for version in (2, 3)}, FERIC.subsystems
    subs = [HARVESTER, OPERATOR, *parts.values()]
    build_all(subs, folders, STEP, WORK_CYCLE_STOP, platforms=[platform])
    for version, built in folders.items():
        program = shutil.copy(driver(version, platform), folder)
        for name in (sub.name for sub in subs):
            host = machines[version, name]
            other = unpack(built / f"{name}.fmu", built / name, platform)
            script = cycle(host, STOP) if name == "harvester" else [*begin(host), *moves(host, 0, 1000)]
            if name in parts:
                script += [
                    "save 0",
                    *moves(host, 1000, 9),
                    "write 0 bytes",
                    "read 0 bytes",
                    "restore 0",
                    look(host),
                ]
                script += [*begin(host, 1, "me"), f"euler 1 1e-8 10 {host.states}", look(host, 1)]
            [ours] = drive(drivers[version], host, script, folder)
            [theirs] = drive(program, other, script, folder, before=before)
            assert_same(numbers(ours), numbers(theirs))


@pytest.fixture
def wine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """Wine with a drive C: of its own, which takes 0.7 GB and goes when the test is over."""
    if WINE is None:
        lacks("wine64")
    prefix = tmp_path / "wine"
    for name, value in (("WINEPREFIX", str(prefix)), ("WINEDEBUG", "-all"), ("DISPLAY", "")):
        monkeypatch.setenv(name, value)
    # its services live on for a while, and would keep a pipe open that they got from the first program
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    subprocess.run([WINE, "wineboot", "--init"], check=True, **quiet)
    yield WINE
    server = shutil.which("wineserver") or "/usr/lib/wine/wineserver"
    subprocess.run([server, "--kill", "--wait"], check=False, capture_output=True)
    shutil.rmtree(prefix, ignore_errors=True)


def test_windows_gives_the_same_numbers(machines, drivers, tmp_path, wine):
    """The Windows binaries under Wine follow the work cycle as the binaries of this machine do."""
    compare(machines, drivers, tmp_path, "x86_64-windows", [wine])


@needs("qemu-user")
@needs("libc6-arm64-cross")
def test_arm_gives_the_same_numbers(machines, drivers, tmp_path):
    """The aarch64 Linux binaries under qemu follow the work cycle as the binaries of this machine do."""
    compare(machines, drivers, tmp_path, "aarch64-linux", [str(QEMU), "-L", str(ARM)])
