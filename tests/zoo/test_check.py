"""`harvester check` of FMUs with faults: a finding that names the call, and nothing is left.

tests/check/test_children.py interrupts a check while an FMU hangs.
"""

import sys
from pathlib import Path

import pytest
from kit import shards
from kit.wait import LONG

from zoo.command import command
from zoo.faulty import CASES, CAUSES, HANGS, MEMORY, faulty

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="faults and signals of POSIX")
TIMEOUT = 1.0  # [s] for one call of an FMU that hangs; others may leak or print for a while
# the limit is a quarter of the machine's memory
LIMITS = f"import orchestrator.base.processes as p; p.machine_memory = lambda: 4 * {MEMORY}e9"


@pytest.mark.parametrize(
    ("fault", "phase", "major"),
    shards.few([("segfault", "step", 2), ("spin", "instantiate", 3)], CASES, shards.faults),
)
def test_a_fault_is_found(tmp_path: Path, fault: str, phase: str, major: int) -> None:
    """Under the name of the file, with the call that did not return."""
    fmu = faulty(tmp_path, fault, phase, major)
    timeout = TIMEOUT if fault in HANGS else LONG
    ended = command(["check", fmu.fmu, "--timeout", str(timeout)], tmp_path, setup=LIMITS)
    assert ended.left == ()
    assert fmu.committed.exists()
    # the findings under the heading of errors
    found = ended.out.partition("\nerrors\n")[2].partition("\n\n")[0].splitlines()
    if fmu.harmless:
        assert (ended.status, found, ended.err) == (0, [], "")
        return
    assert ended.status == 1
    assert ended.out.startswith(f"{fmu.fmu}: ")
    if fault == "nan":
        assert any("y is nan" in line for line in found), ended.out
        return
    cause = f"hang: no return within {TIMEOUT:g} s" if fault in HANGS else CAUSES[fault]
    assert any(cause in line and f" in {fmu.call}" in line for line in found), ended.out
