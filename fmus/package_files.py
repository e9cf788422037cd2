"""Files that come with the package: data, and in the wheel the built FMUs and systems."""

from __future__ import annotations

import platform
import sys
from pathlib import Path

from orchestrator.base.errors import Problem
from orchestrator.base.xml import package_version

PACKAGE = Path(__file__).parent
BUILT = PACKAGE / "built"  # what `harvester build --platform all` makes; only in the wheel


def project_file(name: str) -> Path | None:
    """A file by its path in a checkout, such as data/x.csv; an installed package contains a copy."""
    return next((folder / name for folder in (PACKAGE.parent, PACKAGE) if (folder / name).is_file()), None)


def data(name: str) -> Path:
    """A file in the folder data of the project."""
    path = project_file(f"data/{name}")
    if path is None:
        raise Problem(f"data/{name} is missing, expected next to or inside the package fmus")
    return path


def shipped(name: str) -> Path | None:
    """A built FMU or system that the package contains, such as harvester.ssp; None in a checkout."""
    path = BUILT / name
    return path if path.is_file() else None


def version_text(build: Path) -> str:
    """Versions of harvester-cosim and Python, the platform, and the folder of the FMUs that commands take.

    build   folder of FMUs that were built, which commands prefer to those in the package
    """
    if (build / "harvester.ssp").exists():
        origin = f"built, in {build.resolve()}"
    elif shipped("harvester.ssp"):
        origin = f"as in the package, in {BUILT}"
    else:
        origin = "none; harvester build makes them"
    return "\n".join(
        [
            f"harvester-cosim {package_version()}",
            f"Python {platform.python_version()} in {sys.prefix}",
            f"platform: {platform.machine()} {platform.platform(terse=True)}",
            f"FMUs: {origin}",
        ]
    )
