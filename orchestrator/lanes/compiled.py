"""C++ libraries of a batch: the models of native FMUs in vector lanes, and the code that couples them.

A native FMU of this project contains its C sources. native/model.cpp includes them with a vector type in
place of double. The libraries are compiled for the processor of this computer, and kept in the user's cache.
They run in the process of the caller, so the code must be of an FMU that this installation has generated.
"""

import ctypes
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

from orchestrator.base.compiler import (
    PLATFORMS,
    SUFFIX,
    CompilerError,
    host,
    is_generated,
    linker_arguments,
    shared_library,
)
from orchestrator.base.errors import Problem
from orchestrator.engine.c_library import structures, without_comments
from orchestrator.ssp.system import Component

LANES = 8  # number of machines in a group, as in lanes.h
FOLDER = Path(__file__).parent / "native"
ENGINE = Path(__file__).parents[1] / "engine" / "native"
# files of the engine that machines.cpp includes
STEPPING = ["engine.h", "coupling_input.c", "communication_step.c", "scenario.c", "simulation_loop.c"]
STEPPING += ["step_size.c"]
# C files of a native FMU that model.cpp includes
SOURCES = (
    *("sizes.h", "model.h", "model.c", "initial.c", "start.h", "start.c", "opening_curve.h"),
    *("solver.h", "inputs.h", "inputs.c", "rosenbrock.c", "runge_kutta.c"),
)
FLAGS = (
    *("-x", "c++", "-std=gnu++20", "-O2", "-g0", "-s", "-shared", "-fvisibility=hidden"),
    *("-nostdinc++", "-nostdlib++", "-fno-exceptions", "-fno-rtti"),
    *("-Wall", "-Wextra", "-Werror", "-Wno-unused-function"),
    *("-fno-math-errno", "-fno-trapping-math"),
)
# in models divisions dominate, so they become products with reciprocals; RECIPROCALS: see lanes.h
FAST = ("-DRECIPROCALS", "-freciprocal-math", "-ffp-contract=fast", "-fno-signed-zeros")
EXACT = ("-ffp-contract=off",)  # as in the engine for one machine
# instruction sets of x86-64, the best one first -> the features of NumPy that they need, and further flags
LEVELS: Mapping[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "x86_64_v4": (("AVX512_SKX",), ("-mprefer-vector-width=512",)),  # the default is 256
    "x86_64_v3": (("AVX2", "FMA3"), ()),
}


class NotInLanes(Problem):
    """The machines cannot be simulated in lanes; the message says why."""


@cache
def processor() -> str:
    """The instruction set to compile for: one of LEVELS, or `baseline`."""
    if not host().startswith("x86_64"):
        return "baseline"
    try:
        features = import_module("numpy._core._multiarray_umath").__cpu_features__
    except (ImportError, AttributeError):  # not part of the interface of NumPy
        return "baseline"
    return next((name for name, (needed, _) in LEVELS.items() if all(map(features.get, needed))), "baseline")


def recipe(
    name: str, file: str, code: Mapping[str, bytes], cpu: str, arithmetic: Sequence[str] = FAST
) -> tuple[str, dict[str, bytes], list[str]]:
    """A library for an instruction set, as arguments of `shared_library`.

    file   in `code`, or of this package
    """
    target, library = PLATFORMS[host()], f"{name}_lanes{SUFFIX}"
    headers = {path.name: path.read_bytes() for path in FOLDER.glob("*.h")}
    flags = ["-target", target.target, f"-mcpu={cpu}", *FLAGS, *arithmetic, *LEVELS.get(cpu, ((), ()))[1]]
    flags += ["-fPIC"] if SUFFIX != ".dll" else []
    own = {} if file in code else {file: (FOLDER / file).read_bytes()}
    sources = {**code, **headers, **own}
    return library, sources, [*flags, file, *linker_arguments(library, target, ("-lm",))]


@cache
def header() -> Any:
    """Structures and constants of the headers for several machines, by name."""
    files = FOLDER / "lanes.h", FOLDER / "instance.h", ENGINE / "engine.h", FOLDER / "machines.h"
    text = without_comments("\n".join(file.read_text(encoding="utf-8") for file in files))
    return structures(text, LANES)


@cache
def machines_library() -> ctypes.CDLL:
    """The functions of machines.cpp."""
    code = {name: (ENGINE / name).read_bytes() for name in STEPPING}
    return _loaded("", *recipe("machines", "machines.cpp", code, processor(), EXACT))


@dataclass(frozen=True)
class Model:
    """The compiled model of a component.

    struct   `Model` of instance.h
    names    variable name -> value reference
    """

    component: str
    library: ctypes.CDLL
    struct: Any
    names: Mapping[str, int]

    def requirement(self, index: int) -> str:
        """The description of a requirement."""
        describe = ctypes.CFUNCTYPE(ctypes.c_char_p, ctypes.c_int32)(self.struct.requirement)
        return (describe(index) or b"").decode()

    def name(self, reference: int) -> str:
        """The name of a variable."""
        return next(name for name, r in self.names.items() if r == reference)

    def is_derivative(self, reference: int) -> bool:
        """Is this the derivative of a state?"""
        s = self.struct
        return bool(0 <= reference - s.parameters - s.inputs - s.states < s.states)


def sources_of(component: Component, generated: bool = False) -> dict[str, bytes]:
    """The C files of a native FMU; raises NotInLanes for another one.

    generated   the client of this worker has generated the FMU, whose code runs here in any case
    """
    source = component.source
    assert source is not None
    try:
        names = [n for n in source.names() if n.startswith(("sources/", "modelDescription.xml"))]
        files = {name: source.member(name).read() for name in names}
        code = {name: files.get(f"sources/{name}.inc") or files[f"sources/{name}"] for name in SOURCES}
    except (Problem, KeyError):
        raise NotInLanes(f"{component.name} ({source}) has no C sources of harvester-cosim") from None
    if not (generated or is_generated(files)):
        expected = "expected an FMU that this installation of harvester-cosim has built"
        raise NotInLanes(f"{component.name} ({source}): {expected}, got another one or a changed one")
    return code


def compiled_model(
    component: Component, begin: Callable[[], object] | None = None, generated: bool = False
) -> Model:
    """The compiled model of a component; raises NotInLanes if that is impossible.

    begin       is called before a compilation
    generated   see `sources_of`
    """
    if component.source is None:
        raise NotInLanes(f"{component.name} is not an FMU")
    if component.interface.declares_events:
        raise NotInLanes(f"{component.name} ({component.source}): the FMU has events")
    variables = component.interface.variables.values()
    if others := [v.name for v in variables if not v.is_real]:
        raise NotInLanes(f"{component.name}.{others[0]} is not a Real variable")
    code = sources_of(component, generated)
    if re.search(rb"#define SAMPLING 0(\.0)? ", code["sizes.h"]) is None:
        raise NotInLanes(f"{component.name} ({component.source}) is sampled, as a control unit")
    made = recipe(component.interface.identifier, "model.cpp", code, processor())
    library = _loaded(f"{component.name}: ", *made, begin=begin)
    library.lane_model.restype = ctypes.c_void_p
    struct = header().Model.from_address(library.lane_model())
    return Model(component.name, library, struct, {v.name: v.reference for v in variables})


def _loaded(context: str, *library: Any, begin: Callable[[], object] | None = None) -> ctypes.CDLL:
    try:
        return ctypes.CDLL(str(shared_library(*library, begin=begin)))
    except (CompilerError, OSError) as error:
        raise NotInLanes(f"{context}{error}") from None
