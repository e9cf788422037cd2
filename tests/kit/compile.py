"""Compiles the C files of tests with the project's compiler, once for all test processes and later runs."""

from collections.abc import Sequence
from pathlib import Path

import fmpy

from orchestrator.base.compiler import PLATFORMS, SUFFIX, host, shared_library

HEADERS = Path(fmpy.__file__).parent / "c-code"  # of FMI
WARNINGS = ("-Wall", "-Wextra", "-Werror", "-isystem", str(HEADERS))
SHARED = ("-O1", "-shared", "-fPIC", *WARNINGS)


def compiled(
    name: str, sources: Sequence[Path], *flags: str, included: Sequence[Path] = (), target: str | None = None
) -> Path:
    """The library or program `name` from C files.

    included   files that the sources include
    target     a platform as the compiler names it; without one, this computer's
    """
    code = {path.name: path.read_bytes() for path in (*sources, *included)}
    names = [path.name for path in sources]
    where = ("-target", target or PLATFORMS[host()].target)
    libraries = () if "-nostdlib" in flags else ("-lm",)
    return shared_library(name, code, [*where, *flags, *names, *libraries])


def library(name: str, sources: Sequence[Path], *flags: str, included: Sequence[Path] = ()) -> bytes:
    """The content of a shared library for this computer."""
    return compiled(f"{name}{SUFFIX}", sources, *SHARED, *flags, included=included).read_bytes()
