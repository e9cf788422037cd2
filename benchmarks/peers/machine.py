"""What the figures were measured on."""

from __future__ import annotations

import os
import platform
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from fmus.export.compile import FLAGS

PACKAGES = ("harvester-cosim", "fmpy", "pyfmi", "OMSimulator", "ecospy", "libcosimpy", "numpy", "ziglang")


def describe() -> dict[str, str]:
    """Processor, system, versions, and how the FMUs were compiled."""
    return {
        "processor": f"{_processor()}, {os.cpu_count()} cores",
        "system": platform.platform(),
        "load": ", ".join(f"{load:.2f}" for load in os.getloadavg()) if hasattr(os, "getloadavg") else "?",
        "python": platform.python_version(),
        **{package: _version(package) for package in PACKAGES},
        "FMUs": "zig cc " + " ".join(flag for flag in FLAGS if flag.startswith(("-O", "-f"))),
    }


def _processor() -> str:
    info = Path("/proc/cpuinfo")
    if not info.exists():
        return platform.processor() or platform.machine()
    lines = (line.partition(":") for line in info.read_text(encoding="utf-8").splitlines())
    return next((value.strip() for name, _, value in lines if name.strip() == "model name"), "?")


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"
