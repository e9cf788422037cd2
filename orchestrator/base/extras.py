"""Packages that only some commands need: the extras of harvester-cosim, such as `harvester-cosim[view]`."""

from __future__ import annotations

import platform
from collections.abc import Mapping
from importlib.util import find_spec

from orchestrator.base.errors import Problem

# extra -> modules that it brings, as they are imported; the same packages are in pyproject.toml
EXTRAS: Mapping[str, tuple[str, ...]] = {
    "model": ("casadi", "scipy"),
    "build": ("casadi", "fmpy", "latex2mathml", "markdown_it", "pythonfmu", "scipy", "ziglang"),
    "view": ("starlette", "uvicorn", "websockets"),
    "sweep": ("SALib", "locket", "pandas", "pyarrow", "scipy"),
    "cluster": ("distributed", "upath"),
    "identify": ("casadi", "scipy", "statsmodels", "ziglang"),
    "files": ("h5py", "pandas", "pyarrow", "scipy"),
    "logger": ("asammdf", "nptdms"),
    "control": ("control", "scipy"),
    "reference": ("sksundae",),
    "learn": ("gymnasium",),
    "rating": ("objective_rating_metrics",),
}
# extra -> what needs it, for the table in README.md
NEEDED_BY: Mapping[str, str] = {
    "model": "`harvester parameters`, `variants`, `track`, `rig`; the equations in `fmus`",
    "build": "`harvester build`, `crane`; `fmus.build`; in `batch` and `sweep` several machines on each core",
    "view": "`harvester view`",
    "sweep": "`harvester sweep`, `convergence`",
    "cluster": "`--scheduler`: runs on a cluster of Dask; folders of studies at a URL; needs `[sweep]`, too",
    "identify": "`harvester identify`",
    "files": "Parquet and MATLAB files, `to_pandas()`",
    "logger": "MF4 and TDMS files of loggers",
    "control": "`harvester linearize`; `to_control()`: linear models for python-control",
    "reference": "`harvester reference`, `harvester validate --monolithic`",
    "learn": "`MachinesEnv`: machines for reinforcement learning; needs `[build]`, too",
    "rating": "`harvester validate --rate`, `compare --rate`; limits of `iso18571`",
}
# module -> systems and processors without a wheel, which pyproject.toml excludes
NO_WHEEL: Mapping[str, tuple[tuple[str, str], ...]] = {
    "sksundae": (("Linux", "aarch64"),),
    "objective_rating_metrics": (("Darwin", "x86_64"),),
}


class MissingExtra(Problem):
    """Packages of an extra are not installed."""


def install(extra: str) -> str:
    """The command that installs an extra."""
    return f'pip install "harvester-cosim[{extra}]"'


def require(extra: str, purpose: str, *modules: str, advice: str = "") -> None:
    """Raise MissingExtra unless the modules of an extra are installed; by default all of its modules.

    purpose   what needs them, such as "harvester view", for the message
    advice    end of the message, such as what works without them
    """
    missing = [name for name in modules or EXTRAS[extra] if not _installed(name)]
    here = platform.system(), platform.machine()
    if any(here in NO_WHEEL.get(name, ()) for name in missing):
        where = f"no wheel for {' on '.join(here)}: build it from source, or use another computer"
        raise MissingExtra(f"{purpose} needs {_listed(missing)}, which has {where}{advice}")
    if missing:
        raise MissingExtra(f"{purpose} needs {_listed(missing)}; install with: {install(extra)}{advice}")


def extra_of(module: str) -> str | None:
    """The first extra that brings a module, such as "view" for starlette.routing."""
    top = module.partition(".")[0]
    return next((extra for extra, names in EXTRAS.items() if top in names), None)


def _installed(name: str) -> bool:
    try:
        return find_spec(name) is not None
    except (ImportError, ValueError):  # ValueError: a module without a specification is in sys.modules
        return False


def _listed(names: list[str]) -> str:
    plural = "s" if len(names) > 1 else ""
    return f"the package{plural} {', '.join(names)}"
