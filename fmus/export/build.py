"""Builds FMUs with C code: generates the files, compiles them, writes the archives.

Equal subsystems with equal values give equal bytes.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from fmus.contract import Subsystem
from fmus.export.compile import WASM, binaries, host, shared_library
from fmus.export.package import Package, packages
from fmus.parameters import Values
from orchestrator.base.files import write_zip


def build(
    sub: Subsystem,
    out_dir: Path,
    step: float = 1e-3,
    stop: float = 10.0,
    values: Values | None = None,
    fmi: int = 2,
    platforms: Sequence[str] | None = None,
) -> Path:
    """Write `<sub.name>.fmu` to `out_dir` and return its path.

    step, stop   default experiment [s]
    values       parameter and start values; default: those of the subsystem's parameters.toml
    fmi          2 or 3
    platforms    names of `compile.TARGETS`; default: the platform that this program runs on
    """
    names = tuple(platforms or (host(),))
    return _write([(Path(out_dir), packages(sub, step, stop, values, [fmi])[fmi], names)])[0]


def build_all(
    subs: Sequence[Subsystem],
    folders: Mapping[int, Path],
    step: float = 1e-3,
    stop: float = 10.0,
    platforms: Sequence[str] | None = None,
    subfolders: Mapping[str, str] | None = None,
    wasm: Sequence[str] = (),
) -> dict[int, list[Path]]:
    """Build several FMUs of one or both FMI versions; returns version -> paths, in the order of `subs`.

    All FMUs are compiled in parallel; no file is written before all are compiled.

    folders      FMI version -> output folder
    subfolders   name of a subsystem -> folder inside the output folder
    wasm         names of subsystems whose FMU of FMI 3.0 gets a WebAssembly module in addition
    """
    names = tuple(platforms or (host(),))
    made = [packages(sub, step, stop, versions=list(folders)) for sub in subs]
    targets = [
        (
            Path(folder) / (subfolders or {}).get(sub.name, ""),
            files[fmi],
            names if fmi != 3 or sub.name not in wasm else tuple(dict.fromkeys((*names, WASM))),
        )
        for fmi, folder in folders.items()
        for sub, files in zip(subs, made, strict=True)
    ]
    paths = iter(_write(targets))
    return {fmi: [next(paths) for _ in subs] for fmi in folders}


def _write(targets: Sequence[tuple[Path, Package, Sequence[str]]]) -> list[Path]:
    """Compile each package for its platforms, then write all to their folders, or none if one fails."""
    jobs = [(p, name) for _, p, names in targets for name in names]
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        libraries = iter(list(pool.map(lambda job: _library(*job), jobs)))
    paths = []
    for folder, p, names in targets:
        by_platform = {name: next(libraries) for name in names}
        paths.append(folder / f"{p.name}.fmu")
        write_zip(paths[-1], {**p.files, **binaries(p.name, p.fmi, by_platform)})
    return paths


def _library(p: Package, platform: str) -> bytes:
    return shared_library(p.name, p.code, p.compiled, platform)
