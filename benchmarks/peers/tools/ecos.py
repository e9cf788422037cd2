"""Ecos by its Python package: its fixed-step algorithm, recording with its CSV writer.

The package always steps FMUs in parallel, with as many threads of TBB as there are cores; `threads` tells TBB
to take fewer. Its CSV has six decimals.
"""

from __future__ import annotations

import contextlib
import ctypes
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

import ecospy
import numpy as np

from benchmarks.peers.tools import Run, Spent, nothing

CREATE = "_ZN3tbb6detail2r16createERNS0_2d114global_controlE"
DESTROY = "_ZN3tbb6detail2r17destroyERNS0_2d114global_controlE"


def run(
    system: Path,
    stop: float,
    record: Sequence[str],
    judged: Sequence[str],
    step: float,
    threads: int | None = None,
) -> Run:
    """One run."""
    ecospy.EcosLib.set_log_level("off")
    steps = round(stop / step)
    with tempfile.TemporaryDirectory() as folder, limited(threads):
        file = Path(folder) / "run.csv"
        with ecospy.EcosSimulation(step_size=step, ssp_path=str(system)) as simulation:
            if record:
                simulation.add_csv_writer(str(file), identifiers=[_name(signal) for signal in record])
            if not simulation.init():
                raise RuntimeError(ecospy.EcosLib.get_last_error())
            begin = Spent.until_now()
            simulation.step(steps)
            spent = Spent.until_now() - begin
            simulation.terminate()
        return _read(file, step, judged, spent, steps) if record else nothing(spent, steps)


def _name(signal: str) -> str:
    return signal.replace(".", "::", 1)


def _read(file: Path, step: float, judged: Sequence[str], spent: Spent, steps: int) -> Run:
    with file.open(encoding="utf-8") as lines:
        names = [name.strip() for name in next(lines).split(",")]
    columns = [names.index("iterations"), *(names.index(f"{_name(signal)}[REAL]") for signal in judged)]
    number, *values = np.loadtxt(file, delimiter=",", skiprows=1, usecols=columns).T
    return Run(spent, steps, number * step, dict(zip(judged, values, strict=True)))


class Control(ctypes.Structure):
    """tbb::global_control: value, a reserved word, and which parameter; 0 is the number of threads."""

    _fields_ = (("value", ctypes.c_size_t), ("reserved", ctypes.c_ssize_t), ("parameter", ctypes.c_int))


@contextlib.contextmanager
def limited(threads: int | None) -> Iterator[None]:
    """At most so many threads for what Ecos does in parallel."""
    if threads is None:
        yield
        return
    tbb, control = ctypes.CDLL("libtbb.so.12"), Control(threads, 0, 0)
    tbb[CREATE](ctypes.byref(control))
    try:
        yield
    finally:
        tbb[DESTROY](ctypes.byref(control))
