"""Compiles the shared libraries of an FMU: platforms, their folders in the FMU, compiler options.

WebAssembly. The platform `wasm` adds a module for browsers next to the native libraries. The C files are
the same, compiled for wasm32-wasi. The compiler's run-time library has the elementary functions, and
wasm/library.c the few functions of the C library that our code calls. A model with other functions, such as
atan2, is linked with wasi-libc of the compiler package, which is compiled first, for half a minute. The
module is binaries/wasm32-wasip1/<modelIdentifier>.wasm. It exports the C functions of FMI, `malloc`, `free`,
its memory, and its table of functions for callbacks. It imports nothing.

The draft layered standard fmi-ls-wasm (state of 8 July 2026, no release) defines a component of the
WebAssembly component model with a WIT interface, in binaries/wasm32-wasip2/<modelIdentifier>.wasm, and a
manifest in extra/org.modelica.fmi-ls-wasm/. Browsers cannot load components. Our module follows the
draft's rule for the names of folder and file, with the target of its own interface. It omits the draft's
folder and manifest, because an importer that finds those expects a component.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path

import fmpy

from fmus.export.c_code import INCLUDED
from orchestrator.base import compiler
from orchestrator.base.compiler import PLATFORMS, CompilerError, Platform, host, linker_arguments
from orchestrator.base.errors import Problem

WASM = "wasm"
TARGETS: Mapping[str, Platform] = {
    **PLATFORMS,
    WASM: Platform("wasm32-wasip1", ("wasm32-wasip1",), "wasm32-wasi", ".wasm"),
}


def select(names: Sequence[str]) -> tuple[str, ...]:
    """Names of `TARGETS` from options of a user: host, all (the native ones), or names.

    `wasm` is for browsers: it is never part of `all`, and alone it is added to the host.
    """
    chosen: list[str] = []
    for name in names:
        if name not in ("host", "all", *TARGETS):
            raise Problem(f"platform {name!r} is unknown, expected host, all or {', '.join(TARGETS)}")
        chosen += PLATFORMS if name == "all" else [host() if name == "host" else name]
    if set(chosen) == {WASM}:
        chosen.append(host())
    return tuple(name for name in TARGETS if name in chosen)


def binaries(model: str, fmi: int, libraries: Mapping[str, bytes]) -> dict[str, bytes]:
    """Files of the FMU, path -> content, from shared libraries by platform."""
    slices: dict[str, list[bytes]] = {}
    for name, library in libraries.items():
        target = TARGETS[name]
        for folder in target.folders if fmi == 2 else (target.name,):
            slices.setdefault(f"binaries/{folder}/{model}{target.suffix}", []).append(library)
    return {path: libs[0] if len(libs) == 1 else universal(libs) for path, libs in slices.items()}


def universal(slices: Sequence[bytes]) -> bytes:
    """A macOS library for several processors: a big-endian table, then the libraries, aligned to pages."""
    page = 14  # log2 of the page size of arm64
    table = struct.pack(">II", 0xCAFEBABE, len(slices))
    body, start = b"", 1 << page
    for library in slices:
        processor = struct.unpack_from("<II", library, 4)  # type and subtype
        offset = start + len(body)
        table += struct.pack(">IIIII", *processor, offset, len(library), page)
        body += library + b"\0" * (-len(library) % (1 << page))
    return table.ljust(start, b"\0") + body


# vectors of neighbouring statements gain nothing in our equations, and take a sixth of the compiler's time
FLAGS = (
    *("-std=c99", "-O3", "-fno-slp-vectorize", "-g0", "-s", "-fvisibility=hidden"),
    *("-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wshadow", "-Werror"),
    *("-ffp-contract=off", "-fno-math-errno", "-fno-trapping-math"),
)
LIBRARY = ("-fPIC", "-shared")
# a module exports what is visible, and a table in which an importer can put its callbacks
MODULE = (
    "-rdynamic",
    "-Wl,--export=malloc",
    "-Wl,--export=free",
    "-Wl,--export-table",
    "-Wl,--growable-table",
)
# without main: with wasi-libc, and with our library in its place
REACTOR, BARE = "-mexec-model=reactor", ("-Wl,--no-entry", "-Wl,--export=_initialize")
HEADERS = Path(fmpy.__file__).parent / "c-code"  # fmi2*.h and fmi3*.h, which FMUs must not contain


def shared_library(
    model: str,
    code: Mapping[str, bytes],
    compiled: Sequence[str],
    platform: str,
    libraries: Sequence[str] = ("-lm",),
) -> bytes:
    """The shared library of a model.

    code        the files under sources/ by name
    compiled    names of the files to compile
    platform    a name of `TARGETS`
    libraries   linker options for system libraries, except on Windows and macOS
    """
    try:
        if platform == WASM:
            return _module(model, code, compiled)
        if START + INCLUDED in code:
            code, compiled = _in_parts(model, code, compiled, platform)
        made = compiler.shared_library(*recipe(model, code, compiled, platform, libraries))
    except CompilerError as error:
        raise Problem(f"{model}, {platform}: {error}") from None
    return made.read_bytes()


START, START_HEADER, INITIAL = "start.c", "start.h", "initial.c"
IN_PARTS = ("-DIN_PARTS", "-Wno-unused-function")
# without the checks of a debug build
UNOPTIMISED = ("-O0", "-fno-sanitize=undefined", "-fno-stack-protector")


def _in_parts(
    model: str, code: Mapping[str, bytes], compiled: Sequence[str], platform: str
) -> tuple[dict[str, bytes], list[str]]:
    """The code with all but the start values as object files, and what is left to compile.

    An FMU with other values has the same object files, and the one of the other FMI version has the largest,
    equations with solver. That is compiled last: two versions at once then begin with different files. What
    is called a few times before a run is not optimised, which would take a fifth of the time of all.
    """
    names = re.findall(r'#include "(.+)"', code[compiled[0]].decode())
    names.remove(START + INCLUDED)
    version = [name for name in names if name.startswith("fmi")]
    shared = [name for name in names if name not in (*version, INITIAL + INCLUDED)]
    headers = {name: text for name, text in code.items() if name.endswith(".h") and name != START_HEADER}
    made = {START: code[START + INCLUDED], START_HEADER: code[START_HEADER]}
    system, flags = _headers(), [flag for flag in (*FLAGS, *LIBRARY) if flag not in ("-s", "-shared")]
    flags = ["-target", TARGETS[platform].target, *flags, *IN_PARTS, "-c", "-isystem", str(HEADERS)]
    parts = {"fmi": version, "initial": [INITIAL + INCLUDED], "model": shared}
    for part, included in parts.items():
        texts = {n: h for n, h in headers.items() if part == "fmi" or not n.startswith("fmi")}
        texts |= {name: code[name] for name in included}
        texts[f"{part}.c"] = "".join(f'#include "{name}"\n' for name in included).encode()
        name, level = f"{model}_{part}.o", UNOPTIMISED if part == "initial" else ()
        made[name] = compiler.shared_library(name, texts, [*flags, *level, f"{part}.c"], system).read_bytes()
    return made, [*IN_PARTS, START, *(name for name in made if name.endswith(".o"))]


def _module(model: str, code: Mapping[str, bytes], compiled: Sequence[str]) -> bytes:
    """The module of a model, with the small library if that has all it needs, else with wasi-libc."""
    target, name, part = TARGETS[WASM].target, f"{model}.wasm", f"{model}_wasm.o"
    flags = ("-target", target, *(flag for flag in FLAGS if flag != "-s"), "-c")
    arguments = [*flags, "-isystem", str(HEADERS), *compiled]
    content = compiler.shared_library(part, code, arguments, _headers()).read_bytes()
    linked = ["-target", "wasm32-freestanding", *FLAGS, *MODULE, *BARE, part, LIBRARY_OBJECT]
    try:
        parts = {part: content, LIBRARY_OBJECT: _small_library(flags)}
        made = compiler.shared_library(name, parts, linked)
    except CompilerError:  # it lacks a function, or another version of the compiler has musl elsewhere
        linked = ["-target", target, *FLAGS, *MODULE, REACTOR, part]
        made = compiler.shared_library(name, {part: content}, linked)
    return made.read_bytes()


LIBRARY_OBJECT = "library.o"


@cache
def _small_library(flags: Sequence[str]) -> bytes:
    """wasm/library.c, compiled: once for all models."""
    import ziglang

    musl = Path(ziglang.__file__).parent / "lib" / "libc" / "musl"
    folders = [musl / part for part in ("src/math", "src/include", "src/internal", "arch/generic")]
    included = [argument for folder in folders for argument in ("-I", str(folder))]
    source = Path(__file__).parent / "wasm" / "library.c"
    arguments = [*flags, "-w", "-fno-builtin", *included, source.name]  # warnings are those of musl
    return compiler.shared_library(LIBRARY_OBJECT, {source.name: source.read_bytes()}, arguments).read_bytes()


def recipe(
    model: str,
    code: Mapping[str, bytes],
    compiled: Sequence[str],
    platform: str,
    libraries: Sequence[str] = ("-lm",),
) -> tuple[str, Mapping[str, bytes], list[str], list[bytes]]:
    """How the library of a model is made: arguments of `compiler.shared_library`."""
    target = TARGETS[platform]
    library = f"{model}{target.suffix}"
    arguments = ["-target", target.target, *FLAGS, *LIBRARY, "-isystem", str(HEADERS), *compiled]
    arguments += linker_arguments(library, target, libraries)
    return library, code, arguments, _headers()


@cache
def _headers() -> list[bytes]:
    return [path.read_bytes() for path in sorted(HEADERS.glob("*.h"))]
