"""C to a shared library for this computer, compiled once and kept in the user's cache."""

from __future__ import annotations

import atexit
import ctypes
import hashlib
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from contextlib import suppress
from functools import cache
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path

from fmus.contract import ModelError
from fmus.export.codegen import native_sources
from fmus.export.keep import store

FLAGS = (
    *("-std=gnu11", "-O2", "-g0", "-fPIC", "-shared", "-fvisibility=hidden"),
    # numbers as in the FMU, but for the derivatives: native/sensitivities.c
    *("-ffp-contract=off", "-fno-math-errno", "-fno-trapping-math"),
    "-mcpu=native",  # the widest registers; what is kept is kept by processor
)
SUFFIX = {"win32": ".dll", "darwin": ".dylib"}.get(sys.platform, ".so")
ORDER = ("model.c", "motion.c", "rosenbrock.c", "kutta.c", "solver.c", "slopes.c", "sensitivities.c")


def library(generated: Mapping[str, str]) -> ctypes.CDLL:
    """The library of a model from its generated files and those by hand."""
    native = native_sources(2)
    code = {name: text for name, text in native.items() if name in ORDER or name.endswith(".h")}
    own = files("fmus.identification.refinement") / "native" / "sensitivities.c"
    code |= {"sensitivities.c": own.read_text(encoding="utf-8"), **generated}
    code["all.c"] = "".join(f'#include "{name}"\n' for name in ORDER)
    return ctypes.CDLL(str(_file(code)))


def _file(code: Mapping[str, str]) -> Path:
    """The compiled library, made unless it was made before."""
    digest = hashlib.sha256(" ".join((version("ziglang"), sys.platform, *FLAGS, _processor())).encode())
    for name in sorted(code):
        digest.update(f"{name}\0{code[name]}\0".encode())
    name = f"refined-{digest.hexdigest()[:32]}{SUFFIX}"
    try:
        return _made(code, store() / name)
    except OSError:  # a store that cannot be written to keeps nothing
        return _made(code, _own() / name)


@cache
def _own() -> Path:
    """A folder for this process alone."""
    folder = Path(tempfile.mkdtemp(prefix="harvester-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder


def _made(code: Mapping[str, str], kept: Path) -> Path:
    if kept.is_file():
        return kept
    kept.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=kept.parent) as folder:
        for name, text in code.items():
            (Path(folder) / name).write_text(text, encoding="utf-8")
        made = Path(folder) / kept.name
        command = [sys.executable, "-m", "ziglang", "cc", *FLAGS, "all.c", "-o", kept.name, "-lm"]
        run = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
        if run.returncode:
            told = run.stderr.strip().splitlines() or ["it says nothing"]
            reason = next((line for line in told if "error: " in line), told[-1])
            raise ModelError(f"the C compiler failed with exit status {run.returncode}: {reason}")
        with suppress(OSError):  # somebody else was faster, and uses it already
            made.replace(kept)
    return kept


@cache
def _processor() -> str:
    """What the compiler knows of this processor."""
    command = [sys.executable, "-m", "ziglang", "build-exe", "--show-builtin"]
    return subprocess.run(command, capture_output=True, text=True, check=False).stdout
