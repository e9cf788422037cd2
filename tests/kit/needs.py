"""What a test may need that a computer lacks: the only reasons for which a test is skipped.

A plugin of pytest prints them with the number of tests. A run fails that skips a test for another reason, or
although the Debian package is installed that brings what it needs.
"""

import os
import platform
import shutil
import subprocess
import sys
from collections import Counter
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, NoReturn

import pytest


def program(*names: str) -> str | None:
    """The first of some programs that is on the search path."""
    return next(filter(None, map(shutil.which, names)), None)


WINE = program("wine64", "/usr/lib/wine/wine64", "wine")
QEMU = program("qemu-aarch64", "qemu-aarch64-static")
ARM = Path("/usr/aarch64-linux-gnu")  # loader and libraries
CHROMIUM = program("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
REFERENCE_FMUS = Path(os.environ.get("REFERENCE_FMUS") or "/none")

# Debian package that `.ci/run` installs -> what a test looks for
PACKAGES: dict[str, object] = {
    "gcc": sys.platform == "linux" and program("gcc"),
    "valgrind": program("valgrind"),
    "wine64": WINE,
    "qemu-user": QEMU,
    "libc6-arm64-cross": ARM.is_dir(),
    "chromium": CHROMIUM,
    "libtbb12": None,  # the loader finds it, or an import fails
}
# anything else -> what a test looks for; nothing of pip, as the extra `test` has that
OTHERS: dict[str, object] = {
    "Linux": sys.platform == "linux",
    "POSIX": os.name == "posix",
    "x86-64": platform.machine() in ("x86_64", "AMD64"),
    "openssl": program("openssl"),
    "make and cc": program("make") and program("cc"),
    "OpenModelica": program("omc"),
    "Reference-FMUs": REFERENCE_FMUS.is_dir(),
    "a package index": None,
    "time": None,  # no test begins after --until
    "a Python that is a shared library": None,
}
KNOWN = PACKAGES | OTHERS


def needs(name: str, why: str = "") -> Any:
    """Mark: the test is skipped without what it needs, one of `KNOWN`."""
    return pytest.mark.skipif(not KNOWN[name], reason=_reason(name, why))


def lacks(name: str, why: str = "") -> NoReturn:
    """Skip the test that runs, which has found out that what it needs is not there."""
    assert name in KNOWN, name
    pytest.skip(_reason(name, why))


def _reason(name: str, why: str) -> str:
    return f"needs {name}{why and f': {why}'}"


def is_installed(package: str) -> bool:
    """Does Debian say that a package is installed?"""
    dpkg = shutil.which("dpkg")
    return (
        bool(dpkg) and not subprocess.run([dpkg, "-s", package], capture_output=True, check=False).returncode
    )


def hidden(reasons: Iterable[str], installed: Callable[[str], bool] = is_installed) -> dict[str, str]:
    """Reasons of skipped tests that hide something -> what is wrong."""
    found = {}
    for reason in reasons:
        name = reason.removeprefix("needs ").partition(":")[0]
        if name not in KNOWN or reason == name:
            found[reason] = "expected `needs` or `lacks` with a name of tests/kit/needs.py"
        elif name in PACKAGES and installed(name):
            found[reason] = f"the package {name} is installed"
    return found


def _reasons(config: pytest.Config) -> dict[str, Counter[str]]:
    """Reasons -> files of the tests that were skipped for them."""
    reporter: Any = config.pluginmanager.get_plugin("terminalreporter")
    found: dict[str, Counter[str]] = {}
    for report in reporter.stats.get("skipped", []) if reporter else []:
        files = found.setdefault(report.longrepr[2].removeprefix("Skipped: "), Counter())
        files[report.nodeid.partition("::")[0]] += 1
    return found


def pytest_sessionfinish(session: pytest.Session, exitstatus: int) -> None:
    """A run that passed fails if a skipped test hides something."""
    main = not hasattr(session.config, "workerinput")
    if main and exitstatus == pytest.ExitCode.OK and hidden(_reasons(session.config)):
        session.exitstatus = pytest.ExitCode.TESTS_FAILED


def pytest_terminal_summary(terminalreporter: Any, config: pytest.Config) -> None:
    """How many tests were not run for which reason, and of which files."""
    reasons = _reasons(config)
    for reason, files in reasons.items():
        names = ", ".join(f"{name} {count}" for name, count in files.most_common())
        terminalreporter.line(f"not run, {files.total()}: {reason}; {names}")
    for reason, why in hidden(reasons).items():
        terminalreporter.line(f"ERROR skipped for {reason!r}: {why}", red=True)
