"""Installs this checkout into the Python that runs this file, and says what takes time.

    .venv/bin/python tools/install.py build          the base and the extra `build`, as `make demo` does
    .venv/bin/python tools/install.py --newest test  without constraints.txt, the versions that were tested

uv does the work, which pip installs first: uv downloads and unpacks in parallel, and takes a quarter of the
time of pip. It does not read the settings of pip. So where pip uses another index than PyPI, or uv fails,
pip installs everything. Byte code is compiled on first use, not in advance: most modules are never used.
"""

from __future__ import annotations

import re
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PIP = [sys.executable, "-m", "pip", "--disable-pip-version-check"]
UV = [sys.executable, "-m", "uv", "pip", "install", "--no-progress", "--python", sys.executable]
# downloads of less than 20 MB take less than 5 s
TOLD = re.compile(
    r"\s*(Resolved|Prepared|Installed|Installing collected packages|error:|ERROR:"
    r"|Downloading .*\((\d{3,}|[2-9]\d)[.\d]* ?Mi?B\))"
)


def main(arguments: list[str]) -> int:
    """Install the extras that are named."""
    extras = ",".join(a for a in arguments if not a.startswith("-"))
    target = f".[{extras}]" if extras else "."
    versions = [] if "--newest" in arguments else ["-c", "constraints.txt"]
    began = time.monotonic()
    print(f"installing the packages of harvester-cosim{target[1:]} into {Path(sys.prefix).name}", flush=True)
    status = _uv([*versions, "-e", target]) if _has_uv(versions) else 1
    if status:
        pip = [*PIP, "install", "--progress-bar", "off", "--no-compile", *versions, "-e", target]
        status = _run(pip)
    if not status:
        print(f"installed in {time.monotonic() - began:.0f} s", flush=True)
    return status


def _has_uv(versions: list[str]) -> bool:
    """Install uv unless pip uses another index than PyPI; whether that worked."""
    settings = subprocess.run([*PIP, "config", "list"], capture_output=True, text=True, check=False).stdout
    if re.search(r"\bindex-url=", settings.replace("extra-index-url", "")):
        return False
    command = [*PIP, "install", "--quiet", "--no-compile", *versions, "uv"]
    return subprocess.run(command, cwd=ROOT, check=False).returncode == 0


def _uv(arguments: list[str]) -> int:
    status = _run([*UV, *arguments])
    if status:
        print("uv failed; installing with pip", flush=True)
    return status


def _run(command: list[str]) -> int:
    """Run an installer; print what it does, and everything if it fails. Returns its exit status."""
    lines = list[str]()
    with subprocess.Popen(
        command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    ) as process:
        assert process.stdout is not None
        for line in process.stdout:
            lines.append(line)
            if TOLD.match(line):
                text = line.strip()
                print(f"  {text if len(text) < 100 else f'{text[:96]} ...'}", flush=True)
    if process.returncode:
        print("".join(lines), file=sys.stderr)
    return process.returncode


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
