"""Builds .fmu files: generate, compile, pack. The same subsystem gives the same bytes."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from fmus.contract import Subsystem
from fmus.export.compile import binaries, host, shared_library
from fmus.export.package import Package, package
from fmus.parameters import Values
from orchestrator.base.files import write_zip


def build(
    sub: Subsystem,
    out_dir: Path,
    step: float = 1e-3,
    stop: float = 10.0,
    numbers: Values | None = None,
    fmi: int = 2,
    platforms: Sequence[str] | None = None,
) -> Path:
    """Write `<sub.name>.fmu` to `out_dir` and return its path.

    step, stop   default experiment [s]
    numbers      parameters and start values; by default those of the subsystem's parameters.toml
    fmi          2 or 3
    platforms    names of `compile.PLATFORMS`; by default the one this runs on
    """
    return _write([(Path(out_dir), package(sub, fmi, step, stop, numbers))], platforms)[0]


def build_all(
    subs: Sequence[Subsystem],
    folders: Mapping[int, Path],
    step: float = 1e-3,
    stop: float = 10.0,
    platforms: Sequence[str] | None = None,
    under: Mapping[str, str] | None = None,
) -> dict[int, list[Path]]:
    """Build several FMUs, those of FMI version 2 into folders[2] and of 3 into folders[3]; their paths.

    All compilers run side by side, and nothing is written before the last one is done.

    under   name of a subsystem -> folder in that folder
    """
    below = under or {}
    orders = [
        (Path(out) / below.get(sub.name, ""), package(sub, fmi, step, stop))
        for fmi, out in folders.items()
        for sub in subs
    ]
    paths = iter(_write(orders, platforms))
    return {fmi: [next(paths) for _ in subs] for fmi in folders}


def _write(orders: Sequence[tuple[Path, Package]], platforms: Sequence[str] | None) -> list[Path]:
    """Compile for all platforms, then write each FMU to its folder; a build that fails writes none."""
    names = tuple(platforms or (host(),))
    jobs = [(p, name) for _, p in orders for name in names]
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        libraries = iter(list(pool.map(lambda job: _library(*job), jobs)))
    paths = []
    for folder, p in orders:
        built = {name: next(libraries) for name in names}
        paths.append(folder / f"{p.name}.fmu")
        write_zip(paths[-1], {**p.files, **binaries(p.name, p.fmi, built)})
    return paths


def _library(p: Package, platform: str) -> bytes:
    return shared_library(p.name, p.code, p.compiled, platform)
