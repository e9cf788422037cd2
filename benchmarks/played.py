"""harvester.fmu of FMI 2.0, played by a loop in C: the least that a run of a native FMU can cost."""

from __future__ import annotations

import ctypes
import subprocess
import sys
import zipfile
from collections.abc import Callable, Sequence
from pathlib import Path

import fmpy
import numpy as np

from fmus.export.build import build
from fmus.export.compile import HEADERS
from fmus.machine.one_block import HARVESTER

Array = np.ndarray


class Fmu:
    """One FMU and the names of what goes in and out; a call is a run from the start."""

    CALLS = (
        *("Instantiate", "SetupExperiment", "EnterInitializationMode", "ExitInitializationMode", "SetReal"),
        *("SetRealInputDerivatives", "DoStep", "GetReal", "FreeInstance"),
    )

    def __init__(
        self,
        folder: Path,
        names: tuple[Sequence[str], Sequence[str], Sequence[str]],
        time: Array,
        u: Array,
    ) -> None:
        """names: inputs, parameters, outputs. time: (n,) [s], u: (n, nu)."""
        fmu = build(HARVESTER, folder)
        zipfile.ZipFile(fmu).extractall(folder / "fmu")
        (file,) = (folder / "fmu" / "binaries").glob("*/harvester.*")
        self.library, self.time, self.u = ctypes.CDLL(str(file)), time, u
        addresses = [ctypes.cast(self.library[f"fmi2{name}"], ctypes.c_void_p) for name in self.CALLS]
        self.functions = (ctypes.c_void_p * len(addresses))(*addresses)
        described = fmpy.read_model_description(str(fmu))
        self.guid = described.guid.encode()
        references = {v.name: v.valueReference for v in described.modelVariables}
        self.references = [np.array([references[n] for n in group], dtype=np.uint32) for group in names]
        self.play = _player(folder)

    def __call__(self, p: Array, tolerance: float) -> Array:
        """Outputs at the samples, shape (n, ny)."""
        inputs, free, outputs = self.references
        y = np.empty((self.time.size, outputs.size))

        def vector(values: Array) -> tuple[ctypes.c_size_t, ctypes.c_void_p]:
            return ctypes.c_size_t(values.size), ctypes.c_void_p(values.ctypes.data)

        p = np.ascontiguousarray(p)
        failed = self.play(
            *(self.functions, self.guid, ctypes.c_double(tolerance), self.time.size),
            *(ctypes.c_void_p(self.time.ctypes.data), *vector(inputs), ctypes.c_void_p(self.u.ctypes.data)),
            *(
                *vector(free),
                ctypes.c_void_p(p.ctypes.data),
                *vector(outputs),
                ctypes.c_void_p(y.ctypes.data),
            ),
        )
        if failed:
            raise RuntimeError("the FMU failed")
        return y


def _player(folder: Path) -> Callable[..., int]:
    file = folder / "play.so"
    command = [sys.executable, "-m", "ziglang", "cc", "-O3", "-std=c99", "-fPIC", "-shared", f"-I{HEADERS}"]
    subprocess.run([*command, str(Path(__file__).with_name("play.c")), "-o", str(file)], check=True)
    return ctypes.CDLL(str(file)).play
