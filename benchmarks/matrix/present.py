"""Which tools are here, in which version, and what they can be asked for."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path


@dataclass(frozen=True)
class Tool:
    """One tool.

    key, name   of its runner, for people
    package     a distribution of this Python, if that is how it comes
    command     a program on the search path that runs it, or a Python that has it
    module      which that Python has
    alone       (FMI version, side) of single FMUs
    systems     FMI versions of systems
    masters     of systems
    strokes     takes moving inputs of an FMU
    short       systems are run for 8 s only, for it is slow
    """

    key: str
    name: str
    package: str = ""
    command: str = ""
    module: str = ""
    alone: Sequence[tuple[int, str]] = ()
    systems: Sequence[int] = ()
    masters: Sequence[str] = ("jacobi",)
    strokes: Sequence[tuple[int, str]] = ()
    short: bool = False

    @property
    def python(self) -> str:
        """The interpreter that its runner needs."""
        return shutil.which(self.command) or sys.executable if self.module else sys.executable

    @cache  # noqa: B019  there are a dozen
    def found(self) -> str:
        """The version; empty where the tool is not here."""
        if self.package:
            try:
                return version(self.package)
            except PackageNotFoundError:
                return ""
        if not shutil.which(self.command):
            return ""
        if self.module:
            code = f"from importlib.metadata import version; import {self.module}; print(version('{self.module}'))"
            run = subprocess.run([self.python, "-c", code], capture_output=True, text=True, check=False)
            return run.stdout.strip().splitlines()[-1] if run.returncode == 0 else ""
        return _modelica() if self.command == "omc" else _said(self.command)


def _modelica() -> str:
    """OpenModelica tells its version to scripts only."""
    with tempfile.TemporaryDirectory() as folder:
        script = Path(folder) / "version.mos"
        script.write_text("getVersion();\n")
        run = subprocess.run(["omc", str(script)], capture_output=True, text=True, check=False, timeout=300)
    told = run.stdout.strip().strip('"')
    return told if re.search(r"\d", told) else "tells no version"


def _said(command: str) -> str:
    """What a program says of its version."""
    for option in ("--version", "-v", "-V"):
        run = subprocess.run([command, option], capture_output=True, text=True, check=False, timeout=60)
        match = re.search(r"v?\d+\.\d+[\w.+-]*", run.stdout + run.stderr)
        if match:
            return match[0].lstrip("v")
    return "tells no version"


BOTH = tuple((fmi, side) for fmi in (2, 3) for side in ("CS", "ME"))
TOOLS = (
    Tool(
        "harvester", "harvester-cosim", "harvester-cosim", systems=(2, 3), masters=("jacobi", "gauss-seidel")
    ),
    Tool("fmpy", "FMPy", "fmpy", alone=BOTH, systems=(2,), strokes=BOTH),
    Tool("fmpy_container", "FMPy, container", "fmpy", systems=(2, 3)),
    Tool("fmucontainer", "fmu-manipulation-toolbox", "fmu-manipulation-toolbox", systems=(2, 3)),
    Tool("ecos", "Ecos", "ecospy", alone=((2, "CS"), (3, "CS")), systems=(2, 3)),
    Tool("libcosim", "libcosim", "libcosimpy", alone=((2, "CS"),), systems=(2,)),
    Tool("omsimulator", "OMSimulator", command="OMSimulator", alone=BOTH, systems=(2,)),
    Tool(
        "pyfmi",
        "PyFMI",
        command="pyfmi-python",
        module="pyfmi",
        alone=((2, "CS"), (2, "ME"), (3, "ME")),
        systems=(2,),
        strokes=((2, "ME"), (3, "ME")),
    ),
    Tool("fmusim", "fmusim", command="fmusim", alone=BOTH, strokes=BOTH),
    Tool("fmucheck", "fmuCheck", command="fmuCheck", alone=((2, "CS"), (2, "ME"))),
    Tool("openmodelica", "OpenModelica", command="omc", alone=((2, "ME"),), systems=(2,)),
    Tool(
        "cofmupy",
        "CoFmuPy",
        command="cofmupy-python",
        module="cofmupy",
        systems=(2, 3),
        masters=("jacobi", "gauss-seidel"),
        short=True,
    ),
    Tool(
        "mastersim",
        "MasterSim",
        command="MasterSimulator",
        systems=(2,),
        masters=("jacobi", "gauss-seidel"),
        short=True,
    ),
)
NEVER = ("Dymola", "Simulink", "Amesim")  # nobody here has them
