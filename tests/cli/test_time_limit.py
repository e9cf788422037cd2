"""A test that hangs is ended and named; the others run."""

import subprocess
import sys
from pathlib import Path

import pytest
from kit import shards

pytestmark = shards.faults

ROOT = Path(__file__).parents[2]
HANGS = {
    "in_python": "import time\n\n\ndef test_in_python():\n    while True:\n        time.sleep(0.1)\n",
    # one call into C that asks for no signal
    "in_c": "from itertools import count\n\n\ndef test_in_c():\n    sum(count())\n",
}


@pytest.mark.parametrize("name", ["in_python", "in_c"])
def test_a_test_that_never_ends_is_named_with_its_stack(name: str, tmp_path: Path) -> None:
    """By the settings of this project, with shorter limits."""
    file = tmp_path / f"test_{name}.py"
    file.write_text(HANGS[name] + "\n\ndef test_fine():\n    pass\n")
    limits = ["-o", "timeout=1", "-o", "faulthandler_timeout=3"]
    command = [sys.executable, "-m", "pytest", "-n", "1", "-c", str(ROOT / "pyproject.toml"), *limits]
    command += [f"--basetemp={tmp_path / 'base'}", str(file)]
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    said = ended.stdout + ended.stderr
    assert ended.returncode == 1, said
    assert f"::test_{name} - " in said, said  # named, with the cause
    assert f"in test_{name}" in said or f"def test_{name}" in said, said  # the stack
    assert "1 failed, 1 passed" in said, said
