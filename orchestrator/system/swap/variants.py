"""Which file a swap names: a variant lies beside the system, in variants/<component>_<name>.fmu."""

from __future__ import annotations

from pathlib import Path

from orchestrator.errors import Problem
from orchestrator.files.archive import Location

FOLDER, SUFFIX, MAKE = "variants", ".fmu", "harvester build"


def find(system_file: Location | None, component: str, chosen: str | Path) -> Location:
    """The FMU that is chosen for a component: a path ending in .fmu, an unpacked FMU, or a variant's name."""
    where, path = f"swap {component}={chosen}", Path(chosen)
    if path.suffix.lower() == SUFFIX or (path / "modelDescription.xml").is_file():
        if not path.exists():
            raise Problem(f"{where}: no such file")
        return Location(path)
    if path.suffix.lower() == ".py":
        makes = f"{MAKE} {chosen} makes one"
        raise Problem(f"{where}: {chosen} is a Python file, expected an {SUFFIX} file: {makes}")
    if any(mark in str(chosen) for mark in "/\\,"):
        raise Problem(f"{where}: expected the name of a variant or a path that ends in {SUFFIX}")
    if system_file is None:
        raise Problem(
            f"{where}: the system has no file to look for variants beside, expected a path to an .fmu"
        )
    home, stem = system_file.path.parent / FOLDER, f"{component.rpartition('.')[2]}_"
    file = home / f"{stem}{chosen}{SUFFIX}"
    if file.is_file():
        return Location(file)
    names = sorted(p.stem.removeprefix(stem) for p in home.glob(f"{stem}*{SUFFIX}"))
    there = f"there are {', '.join(names)}" if names else f"there is no variant of {component}"
    raise Problem(f"{where}: no file {file}; {there}; {MAKE} makes the variants, a path ends in {SUFFIX}")
