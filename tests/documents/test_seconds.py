"""`make test` fails if a file takes too much of it."""

import subprocess
import sys
from pathlib import Path

from kit.shares import too_slow

TESTS = Path(__file__).parents[1]
# worker-seconds of `make test` at commit 664ecd85: of the slowest files, and of all 391
SLOWEST = {"whole_machine/test_units.py": 306.0, "orchestrator/test_any_fmus.py": 81.0}
OTHERS, ALL = 389, 1880.0


def test_the_file_that_took_a_sixth_would_have_been_stopped():
    """Fifteen times the mean file, also on a computer of half the speed; a file just below that passes."""
    rest = (ALL - sum(SLOWEST.values())) / OTHERS
    for speed in (1.0, 0.5):
        files = {n: s / speed for n, s in (SLOWEST | {f"{k}.py": rest for k in range(OTHERS)}).items()}
        found = list(too_slow(files | {"70.py": 70.0 / speed}).values())
        assert [line.partition(":")[0] for line in found] == list(SLOWEST)
        assert f" {306 / speed:.0f} s, expected at most " in found[0]


def test_a_run_with_such_a_file_fails_with_its_name(tmp_path):
    """The others pass; without the option, or without that file, the run passes."""
    (tmp_path / "conftest.py").write_text('pytest_plugins = ["kit.shares"]\n')
    for k in range(20):
        (tmp_path / f"test_{k}.py").write_text("def test(): pass\n")
    slow = tmp_path / "test_slow.py"
    slow.write_text("import time\ndef test(): time.sleep(1.1)\n")
    command = [sys.executable, "-m", "pytest", "-q", "-c", "/dev/null", "-o", f"pythonpath={TESTS}", tmp_path]

    def run(*options):
        done = subprocess.run([*command, *options], capture_output=True, text=True, check=False)
        return done.returncode, done.stdout

    status, told = run("--seconds")
    assert status == 1
    assert "21 passed" in told
    assert "test_slow.py: 1 s, expected at most 1 s, 15 times the mean file" in told
    slow.unlink()
    assert run("--seconds")[0] == 0
