"""Which tools are here, in which version, and what they can be asked for."""

from __future__ import annotations

import re
import shutil
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from benchmarks.matrix.cells import remark
from benchmarks.matrix.running import Ended, ran

ANSWER = 60.0  # s within which a tool must tell its version
PARTS = ("manipulator", "supply", "boom_stick", "swing", "operator_input")
MANIPULATOR_FIRST = ("operator_input", "manipulator", "supply", "boom_stick", "swing")
MANIPULATOR_LAST = ("operator_input", "supply", "boom_stick", "swing", "manipulator")


@dataclass(frozen=True)
class Master:
    """One master of a tool.

    name     for people
    method   jacobi or gauss-seidel; empty where one solver has the whole system
    order    of the FMUs, where the result depends on it and the tool can be told; empty: the tool's own
    """

    name: str
    method: str = "jacobi"
    order: Sequence[str] = ()


JACOBI = Master("jacobi")
ONE_GROUP = Master("jacobi, one group", order=MANIPULATOR_LAST)
GAUSS_SEIDEL = Master("gauss-seidel", "gauss-seidel")
ORDERED = (
    Master("gauss-seidel, manipulator first", "gauss-seidel", MANIPULATOR_FIRST),
    Master("gauss-seidel, manipulator last", "gauss-seidel", MANIPULATOR_LAST),
)


@dataclass(frozen=True)
class Presence:
    """The version of a tool that is here, or why it is not run."""

    version: str = ""
    problem: str = ""


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
    """

    key: str
    name: str
    package: str = ""
    command: str = ""
    module: str = ""
    alone: Sequence[tuple[int, str]] = ()
    systems: Sequence[int] = ()
    masters: Sequence[Master] = (JACOBI,)
    strokes: Sequence[tuple[int, str]] = ()

    @property
    def python(self) -> str:
        """The interpreter that its runner needs."""
        return (shutil.which(self.command) if self.module else None) or sys.executable

    @cache  # noqa: B019  there are a dozen
    def presence(self) -> Presence:
        """Is it here, and does it start?"""
        if self.package:
            try:
                return Presence(version(self.package))
            except PackageNotFoundError:
                return Presence(problem="not found here")
        if not shutil.which(self.command):
            return Presence(problem="not found here")
        if self.module:
            return _module(self.python, self.module)
        return _modelica() if self.command == "omc" else _said(self.command)


def _failed(ended: Ended, question: str) -> Presence | None:
    """None when a question was answered."""
    if ended.status is None:
        return Presence(problem=f"`{question}` gives no answer in {ANSWER:g} s")
    return Presence(problem=f"`{question}`: {remark(ended.reason)}") if ended.status else None


def _module(python: str, module: str) -> Presence:
    """The version of a package of another Python, which must be able to import it."""
    code = f"from importlib.metadata import version; import {module}; print(version('{module}'))"
    ended = ran([python, "-c", code], ANSWER)
    return _failed(ended, f"import {module}") or Presence(ended.out.split()[-1])


def _modelica() -> Presence:
    """OpenModelica tells its version to scripts only."""
    with tempfile.TemporaryDirectory() as folder:
        script = Path(folder) / "version.mos"
        script.write_text("getVersion();\n")
        ended = ran(["omc", str(script)], ANSWER)
    told = ended.out.strip().strip('"')
    return _failed(ended, "omc") or Presence(told if re.search(r"\d", told) else "version unknown")


def _said(command: str) -> Presence:
    """What a program says of its version; numbers in an error message are none."""
    problem = None
    for option in ("--version", "-v", "-V"):
        ended = ran([command, option], ANSWER)
        refused = _failed(ended, f"{command} {option}")
        if refused and ended.status is None:
            return refused
        match = re.search(r"v?(\d+\.\d+[\w.+-]*)", ended.out + ended.err)
        if not refused:
            return Presence(match[1] if match else "version unknown")
        problem = problem or refused
    return problem or Presence("version unknown")


def versions() -> Iterator[tuple[str, ...]]:
    """Tool and version, or that it was not run."""
    for name in dict.fromkeys(t.name for t in TOOLS):
        found = next(t for t in TOOLS if t.name == name).presence()
        yield (name, found.version or f"not run: {found.problem}")
    for name in NEVER:
        yield (name, "not run: not available")


BOTH = tuple((fmi, side) for fmi in (2, 3) for side in ("CS", "ME"))
TOOLS = (
    Tool("harvester", "harvester-cosim", "harvester-cosim", systems=(2, 3), masters=(JACOBI, GAUSS_SEIDEL)),
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
    Tool(
        "openmodelica",
        "OpenModelica",
        command="omc",
        alone=((2, "ME"),),
        systems=(2,),
        masters=(Master("none", ""),),
    ),
    Tool(
        "cofmupy",
        "CoFmuPy",
        command="cofmupy-python",
        module="cofmupy",
        systems=(2, 3),
        masters=(JACOBI, ONE_GROUP, *ORDERED),
    ),
    Tool(
        "mastersim",
        "MasterSim",
        command="MasterSimulator",
        systems=(2,),
        masters=(JACOBI, *ORDERED),
    ),
)
NEVER = ("Dymola", "Simulink", "Amesim")  # nobody here has them
OURS = TOOLS[0]
