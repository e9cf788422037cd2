"""Installs this checkout into the Python that runs this file, and says what takes time.

    .venv/bin/python tools/install.py build          the base and the extra `build`, as `make demo` does
    .venv/bin/python tools/install.py --newest test  without constraints.txt, the versions that were tested

pip does the work. Of its output this prints downloads above 20 MB and the number of packages; all of the
output follows if pip fails. Byte code is compiled on first use, not in advance: most modules are never used.
"""

from __future__ import annotations

import re
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
LARGE = 20.0  # MB: takes over 5 s at 4 MB/s
SIZES = {"kB": 1e-3, "MB": 1.0, "GB": 1e3}
FILE = re.compile(r"\s+(Downloading|Using cached) ([\w.]+?)-\S+ \(([\d.]+) (kB|MB|GB)\)")


def main(arguments: list[str]) -> int:
    """Install the extras that are named."""
    constraints = [] if "--newest" in arguments else ["-c", "constraints.txt"]
    extras = ",".join(a for a in arguments if not a.startswith("-"))
    target = f".[{extras}]" if extras else "."
    pip = [sys.executable, "-m", "pip", "install", "--disable-pip-version-check", "--progress-bar", "off"]
    print(f"installing harvester-cosim{target[1:]} into {Path(sys.prefix).name} with pip", flush=True)
    began = time.monotonic()
    status, output, size = _run([*pip, "--no-compile", *constraints, "-e", target])
    if status:
        print(output, file=sys.stderr)
        return status
    print(f"installed: {time.monotonic() - began:.0f} s, {size:.0f} MB of packages", flush=True)
    return 0


def _run(command: list[str]) -> tuple[int, str, float]:
    """Run pip; its status, its output, and the size of what it fetched [MB]."""
    lines, size = [], 0.0
    with subprocess.Popen(
        command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    ) as pip:
        assert pip.stdout is not None
        for line in pip.stdout:
            lines.append(line)
            if found := FILE.match(line):
                how, name, number, unit = found.groups()
                fetched = float(number) * SIZES[unit]
                size += fetched
                if how == "Downloading" and fetched > LARGE:
                    print(f"  downloading {name}, {fetched:.0f} MB", flush=True)
            elif line.startswith("Installing collected packages:"):
                count = line.count(",") + 1
                print(f"  unpacking {count} packages, {size:.0f} MB compressed", flush=True)
    return pip.returncode, "".join(lines), size


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
