"""The run in C: compiled on first use by the compiler of the package `ziglang`, kept in the user's cache."""

from __future__ import annotations

import ctypes
import hashlib
import os
import subprocess
import sys
import tempfile
from contextlib import suppress
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

FOLDER = Path(__file__).parent
SOURCES = (
    *("calls.c", "driver.c", "foresight.c", "loop.c", "march.c", "pace.c", "signal.c", "sweep.c"),
    "threads.c",
)
SUFFIX = {"win32": ".dll", "darwin": ".dylib"}.get(sys.platform, ".so")
FLAGS = (
    *("-std=gnu11", "-O2", "-g0", "-fPIC", "-shared", "-pthread", "-fvisibility=hidden"),
    *("-Wall", "-Wextra", "-Wconversion", "-Wshadow", "-Werror"),
    "-ffp-contract=off",  # the same numbers as in Python
    "-mcpu=baseline",  # the cache may be shared by machines whose processors know different instructions
)


@cache
def library() -> ctypes.CDLL | str:
    """The compiled code, or one line that tells why there is none."""
    try:
        return ctypes.CDLL(str(_file()))
    except (OSError, PackageNotFoundError, subprocess.CalledProcessError) as error:
        told = (getattr(error, "stderr", None) or str(error)).strip().splitlines() or [repr(error)]
        reason = next((line for line in told if "error: " in line), told[-1])
        return f"the compiled loop is not available, Python does it slower: {reason}"


def _file() -> Path:
    """The library, compiled unless it was before."""
    digest = hashlib.sha256(" ".join((version("ziglang"), sys.platform, *FLAGS)).encode())
    for path in sorted(FOLDER.glob("*.[ch]")):
        digest.update(path.read_bytes())
    kept = _cache() / f"run-{digest.hexdigest()[:32]}{SUFFIX}"
    if kept.is_file():
        return kept
    kept.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=kept.parent) as folder:
        made = Path(folder) / kept.name
        command = [sys.executable, "-m", "ziglang", "cc", *FLAGS, *SOURCES, "-o", str(made)]
        subprocess.run(command, cwd=FOLDER, check=True, capture_output=True, text=True)
        with suppress(OSError):  # somebody else was faster, and uses it already
            made.replace(kept)
    return kept


def _cache() -> Path:
    """The user's folder for what can be made again."""
    named = os.environ.get("XDG_CACHE_HOME") or os.environ.get("LOCALAPPDATA")
    return Path(named or Path.home() / ".cache") / "harvester-cosim"
