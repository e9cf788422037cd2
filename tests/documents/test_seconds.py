"""`make test` fails if a file takes too much of it."""

import re
import subprocess
import sys
from pathlib import Path

TESTS = Path(__file__).parents[1]


def test_a_run_with_such_a_file_fails_with_its_name(tmp_path):
    """The others pass; without the option, or without that file, the run passes."""
    short = "def pytest_configure():\n    from kit import shares\n    shares.LOOP = 1000\n"
    (tmp_path / "conftest.py").write_text(f'pytest_plugins = ["kit.shares"]\n{short}')
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
    whole, before, after = re.search(
        r"(\d+) times a loop of Python, .* (\S+) s before and (\S+) s after", told
    ).groups()
    assert float(whole) > 0
    assert 0 <= float(before) + float(after) < 1
    assert "test_slow.py: 1 s, expected at most 1 s, 15 times the mean file" in told
    slow.unlink()
    assert run("--seconds")[0] == 0
