"""Prints the table of extras in README.md: what needs each of them, and its size on this computer.

    python tools/extras.py

The packages of each extra are installed into an environment of its own in build/extras, in the versions of
constraints.txt. The size of an extra is what it adds to that of the base, with compiled byte code.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from orchestrator.base.extras import EXTRAS, NEEDED_BY

ROOT = Path(__file__).resolve().parents[1]
UV = [sys.executable, "-m", "uv"]
BASE = "all other commands"


def main() -> int:
    """Measure and print."""
    base = _size("base")
    sizes = {extra: _size(extra, extra) - base for extra in EXTRAS}
    print(table(base, sizes | {"all": _size("all", *EXTRAS) - base}), end="")
    return 0


def table(base: float, sizes: dict[str, float]) -> str:
    """The table, from sizes [MB]."""
    rows = [("extra", "needed by", "MB"), ("---", "---", "--:"), ("none", BASE, f"{base:.0f}")]
    rows += [
        (f"`[{extra}]`", NEEDED_BY.get(extra, "everything above"), f"{n:.0f}") for extra, n in sizes.items()
    ]
    return "".join(f"| {' | '.join(row)} |\n" for row in rows)


def _size(name: str, *extras: str) -> float:
    """Size [MB] of what the base with the extras installs."""
    folder = ROOT / "build" / "extras" / name
    subprocess.run([*UV, "venv", "--quiet", "--clear", "--python", sys.executable, folder], check=True)
    command = [
        *UV,
        "pip",
        "install",
        "--quiet",
        "--compile-bytecode",
        "--python",
        folder,
        "-r",
        "pyproject.toml",
        "-c",
        "constraints.txt",
    ]
    subprocess.run([*command, *(f"--extra={extra}" for extra in extras)], cwd=ROOT, check=True)
    files = [p for p in folder.rglob("*") if p.is_file() and not p.is_symlink()]
    return sum(p.stat().st_size for p in files) / 1e6


if __name__ == "__main__":
    sys.exit(main())
