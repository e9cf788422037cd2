"""Rules on shared libraries: exported functions, libraries needed on the target machine, platforms.

FMUs that need an interpreter such as Python on the target machine are reported here, too.
"""

import ast
import re
import sys
from collections.abc import Callable, Iterator
from functools import partial

from orchestrator.base.text import grouped
from orchestrator.check.binary import SUFFIXES, Binary, required
from orchestrator.check.finding import Finding, error, join_names, note, warning
from orchestrator.check.subject import Subject
from orchestrator.fmi.library import platform_folders


def models(subject: Subject) -> Iterator[tuple[Binary, list[str]]]:
    """The libraries with the name of a model identifier, and their interface types."""
    for b in subject.binaries:
        kinds = [k for k, e in subject.model.interfaces.items() if e.get("modelIdentifier") == b.stem]
        if b.format and kinds:
            yield b, kinds


def binary_functions(subject: Subject) -> Iterator[str]:
    """Every library exports all functions of its FMI version and interface types."""
    for b, kinds in models(subject):
        missing = [f for f in required(subject.major, kinds) if f not in b.exports]
        if not missing:
            continue
        prefixed = f"{b.stem}_{missing[0]}"
        hint = f"; it exports {prefixed} as for static linking" if prefixed in b.exports else ""
        yield f"{_at(b)}: does not export {join_names(missing)}{hint}"


def _at(b: Binary) -> str:
    return f"{b} ({b.machine})" if b.format == "Mach-O" else str(b)


def binary_version(subject: Subject) -> Iterator[str]:
    """Libraries export functions of their FMI version only."""
    prefix = f"fmi{subject.major}"
    for b, _ in models(subject):
        others = sorted(e for e in b.exports if re.match(r"fmi[123][A-Z]", e) and not e.startswith(prefix))
        if others:
            yield f"{_at(b)}: exports functions of another FMI version: {join_names(others, 2)}"


def binary_symbols(subject: Subject) -> Iterator[str]:
    """All undefined symbols of a library are in the libraries that it needs."""
    for b, _ in models(subject):
        if b.unresolved:
            yield (
                f"{b}: needs {join_names(b.unresolved, 3)}, which none of {', '.join(b.libraries)} has;"
                " it loads only inside a program that provides them"
            )


def binary_private(subject: Subject) -> Iterator[str]:
    """Libraries export no other functions."""
    for b, _ in models(subject):
        others = [e for e in b.exports if not re.search(r"fmi[123][A-Z]|^_init|^_fini", e)]
        if len(others) > 20:
            yield f"{_at(b)}: exports functions that are not of FMI: {join_names(sorted(others), 2)}"


def binary_debug(subject: Subject) -> Iterator[str]:
    """Libraries contain no debug information."""
    for b in subject.binaries:
        if b.debug:
            yield f"{b}: {b.debug / 1e3:.0f} kB of debug information, with paths and names of the sources"


def binary_traits(subject: Subject) -> Iterator[str]:
    """Libraries have no writable code and no executable stack."""
    consequences = {
        "executable stack": "Linux with glibc 2.41 and newer does not load it",
        "writable code": "hardened systems do not load it",
        "text relocations": "hardened systems do not load it",
        "unsigned": "Macs with Apple processors do not run unsigned code",
    }
    for b in subject.binaries:
        for trait in b.traits:
            yield f"{b}: {trait}; {consequences[trait]}"


SYSTEM = {  # libraries that every machine with this format has
    "ELF": r"lib(c|m|dl|pthread|rt|util)\.so\.\d|ld-linux.*\.so\.\d|linux-vdso\.so\.1",
    "PE": r"(?i)(kernel32|user32|advapi32|gdi32|shell32|ole32|oleaut32|ws2_32|wsock32|msvcrt|ucrtbase|ntdll"
    r"|shlwapi|version|winmm|psapi|dbghelp|secur32|crypt32|bcrypt|bcryptprimitives|iphlpapi|userenv|rpcrt4"
    r"|api-ms-win-[a-z0-9-]+|ext-ms-win-[a-z0-9-]+)\.dll",
    "Mach-O": r"/usr/lib/lib(System|c\+\+|c\+\+abi|objc|iconv|z|resolv)\b.*|/System/Library/.*",
}
COMMON = {  # libraries that most Linux systems have
    r"libgcc_s\.so\.\d": "on all usual Linux systems, missing in small containers",
    r"libstdc\+\+\.so\.\d+": "on most Linux systems; the newest symbols need a new version",
}
RUNTIMES = {  # other libraries, and what the user has to install
    r"(?i)(vcruntime|msvcp|concrt)\d+(_\d)?\.dll|msvcr\d+\.dll": "the Visual C++ runtime; link with /MT",
    r"(?i)(vcruntime\d+|msvcp\d+|ucrtbase|msvcr\d+)d\.dll": "the debug runtime, which is not redistributable",
    r"(?i)lib(gcc_s|winpthread|stdc\+\+|gomp).*\.dll": "the MinGW runtime; link it statically",
    r"(?i)libgfortran.*|libquadmath.*|libifcore.*": "the Fortran runtime",
    r"(?i)lib(blas|lapack|openblas|mkl).*": "a linear algebra library",
    r"(?i)libgomp.*|libomp.*|libiomp.*": "the OpenMP runtime",
    r"(?i)libmw.*": "the MATLAB runtime",
    r"(?i)(lib)?jvm\..*|libjvm.*": "Java",
    r"(?i)lib(sundials).*": "SUNDIALS",
}
PYTHON_LIBRARY = re.compile(r"(?i)(lib)?python\d?.*\.(so|dll|dylib).*|.*/Python\.framework/.*")
# a version that Linux distributions in use lack, and the newest one that they all have, except CentOS 7
GLIBC = ((2, 34), "RHEL 8 and Ubuntu 20.04 lack it", (2, 28), "RHEL 8 has 2.28, CentOS 7 has 2.17")
GLIBCXX = (3, 4, 28)  # Ubuntu 20.04
MACOS = (13,)


def _next_to(b: Binary, library: str, subject: Subject) -> bool:
    """True if the library is in the same folder of the archive."""
    return f"binaries/{b.platform}/{library.rpartition('/')[2]}" in subject.files


def binary_libraries(subject: Subject) -> Iterator[Finding]:
    """The libraries that a library needs are on every machine of the platform, or in the same folder."""
    for b in subject.binaries:
        needed = [n for n in b.libraries if not re.fullmatch(SYSTEM[b.format], n)]
        needed = [n for n in needed if not (PYTHON_LIBRARY.fullmatch(n) or _next_to(b, n, subject))]
        for (description, common), names in grouped(needed, partial(_describe, b)).items():
            make = note if common else warning
            yield make(f"{b}: needs {', '.join(names)} on the target machine: {description}")


def _describe(b: Binary, library: str) -> tuple[str, bool]:
    """Description of a library, and whether most machines have it."""
    common = next((t for p, t in COMMON.items() if re.fullmatch(p, library)), "")
    if common and b.format == "ELF":
        return common, True
    return next((t for p, t in RUNTIMES.items() if re.fullmatch(p, library)), "another library"), False


def binary_loader(subject: Subject) -> Iterator[str]:
    """Libraries find the libraries in the same folder."""
    for b in subject.binaries:
        neighbours = [n for n in b.libraries if b.format == "ELF" and _next_to(b, n, subject)]
        if neighbours and not any("$ORIGIN" in p for p in b.rpaths):
            text = f"{b}: needs {neighbours[0]} from the same folder, but its rpath lacks $ORIGIN"
            yield f"{text}; the loader will not find it"


def binary_path(subject: Subject) -> Iterator[str]:
    """Libraries contain no search paths of the machine on which they were built."""
    for b in subject.binaries:
        for rpath in b.rpaths:
            if not rpath.startswith(("$ORIGIN", "@loader_path", "@rpath", "@executable_path")):
                yield f"{b}: rpath: expected $ORIGIN or none, got {rpath}"
        for library in b.libraries:
            if library.startswith("/") and not re.fullmatch(SYSTEM[b.format], library):
                yield f"{b}: needs {library} at an absolute path"


def binary_glibc(subject: Subject) -> Iterator[Finding]:
    """Libraries for Linux run with the glibc of older distributions."""
    too_new, who_lacks_it, common, examples = GLIBC
    for b in subject.binaries:
        needed = b.versions.get("GLIBC", ())
        if needed >= too_new:
            text = f"needs glibc {_dotted(needed)}, expected at most {_dotted(common)}"
            yield warning(f"{b}: {text}; {who_lacks_it}")
        elif needed > common:
            yield note(f"{b}: needs glibc {_dotted(needed)}; {examples}")
        needed = b.versions.get("GLIBCXX", ())
        if needed > GLIBCXX:
            yield warning(
                f"{b}: needs GLIBCXX {_dotted(needed)} of libstdc++, expected at most {_dotted(GLIBCXX)};"
                " Ubuntu 20.04 lacks it, and MATLAB ships its own libstdc++"
            )


def _dotted(version: tuple[int, ...]) -> str:
    return ".".join(map(str, version))


def binary_macos(subject: Subject) -> Iterator[str]:
    """Libraries for macOS run on versions in use."""
    for b in subject.binaries:
        if b.macos[:1] > MACOS:
            yield f"{b}: needs macOS {_dotted(b.macos)}, expected at most {_dotted(MACOS)}"


def binary_documented(subject: Subject) -> Iterator[Finding]:
    """Libraries that the FMU needs are documented in externalDependencies."""
    external = any(f.severity == "warning" for f in binary_libraries(subject))
    has_list = any(re.match(r"documentation/externalDependencies\.(txt|html)", f) for f in subject.files)
    if external and not has_list:
        make = error if subject.major == 3 else note
        yield make("the FMU needs other libraries, expected documentation/externalDependencies.txt or .html")


TUPLES = {  # FMI 2 name -> FMI 3 tuple
    "win32": "x86-windows",
    "win64": "x86_64-windows",
    "linux32": "x86-linux",
    "linux64": "x86_64-linux",
    "darwin32": "x86-darwin",
    "darwin64": "x86_64-darwin",
}
NAMES = {tuple_: name for name, tuple_ in TUPLES.items()}
TUPLE = re.compile(
    r"(aarch32|aarch64|riscv32|riscv64|x86|x86_64|ppc32|ppc64)-(darwin|linux|windows)(-[a-z][a-z0-9_]*)?"
)
WASM = re.compile(r"wasm(32|64)-(unknown|wasip?[0-9]*)")  # folders of modules; fmi-ls-wasm has wasm32-wasip2
FORMATS = {"linux": "ELF", "windows": "PE", "darwin": "Mach-O"}


def folders(subject: Subject) -> list[str]:
    """The folders in binaries/ that contain files."""
    return sorted({n.split("/")[1] for n in subject.files if n.startswith("binaries/") and n.count("/") > 1})


def as_tuple(folder: str) -> tuple[str, str]:
    """Machine and system of a platform folder of either FMI version; empty if it is not in the standard."""
    machine, _, system = TUPLES.get(folder, folder).partition("-")
    return (machine, system.partition("-")[0]) if TUPLE.fullmatch(TUPLES.get(folder, folder)) else ("", "")


def _legal(folder: str, major: int) -> bool:
    if major == 2:
        return folder in TUPLES or (bool(TUPLE.fullmatch(folder)) and folder not in NAMES)
    return bool(TUPLE.fullmatch(folder))


def platform_some(subject: Subject) -> Iterator[Finding]:
    """The FMU has a binary for a platform."""
    if not subject.model.interfaces or any(_legal(b.platform, subject.major) for b in subject.binaries):
        return
    example = "linux64" if subject.major == 2 else "x86_64-linux"
    present = folders(subject)
    got = f"folders {', '.join(present)}" if present else "no binaries"
    if any(f.startswith("sources/") for f in subject.files):
        yield warning(f"expected binaries, got {got}, only sources, which few tools compile")
    else:
        yield error(f"expected binaries for a platform such as {example}, got {got}")


def missing_platform(subject: Subject, system: str) -> Iterator[str]:
    """There is no binary for 64-bit machines with a system."""
    platforms, required_ = {as_tuple(b.platform) for b in subject.binaries}, f"x86_64-{system.lower()}"
    if platforms and tuple(required_.split("-")) not in platforms:
        name = NAMES[required_] if subject.major == 2 else required_
        yield f"no binaries/{name}: no tool on {system} can run it"


def platform_macos(subject: Subject) -> Iterator[str]:
    """The FMU runs on macOS, on Intel and Apple machines."""
    machines = {b.machine for b in subject.binaries if as_tuple(b.platform)[1] == "darwin"}
    if subject.binaries and not machines:
        yield "no binary for macOS"
    elif machines and "aarch64" not in machines:
        yield "no binary for Macs with Apple processors, neither a universal one nor aarch64-darwin"


def platform_folder(subject: Subject) -> Iterator[Finding]:
    """Platform folders have the names of the FMI version."""
    for name in folders(subject):
        if _legal(name, subject.major) or WASM.fullmatch(name):
            continue
        if other := TUPLES.get(name) if subject.major == 3 else NAMES.get(name):
            got = f"the name of the other FMI version, binaries/{name}"
            yield warning(f"expected binaries/{other}, got {got}")
        else:
            yield note(f"binaries/{name} is not a platform of the standard; tools ignore it")


def _severity(folder_: str, subject: Subject) -> Callable[..., Finding]:
    """A fault of a binary is an error on the machine at hand, else a warning."""
    return error if folder_ in platform_folders(subject.major) else warning


def platform_format(subject: Subject) -> Iterator[Finding]:
    """Each library has the format and machine of its platform folder."""
    for b in subject.binaries:
        (machine, system), finding = as_tuple(b.platform), _severity(b.platform, subject)
        if not b.format:
            got = b.damage or "an unknown format"
            got = "a Git LFS pointer" if b.head.startswith(b"version https://git-lfs") else got
            yield finding(f"{b}: expected a shared library, got {got if b.size else 'an empty file'}")
        elif system and FORMATS[system] != b.format:
            yield finding(f"{b}: expected {FORMATS[system]} for {system}, got {b.format}")
        elif not b.is_library:
            yield finding(f"{b}: expected a shared library, got an executable")
        elif machine and all(o.machine != machine for o in subject.binaries if o.file == b.file):
            # no part of a universal library has it, either
            yield finding(f"{b}: expected code for {machine}, got {b.machine}")


def platform_name(subject: Subject) -> Iterator[Finding]:
    """Each platform has a library with the name of the model identifier."""
    for folder_ in (f for f in folders(subject) if _legal(f, subject.major)):
        system = as_tuple(folder_)[1]
        for kind, element in subject.model.interfaces.items():
            expected = f"{element.get('modelIdentifier')}{SUFFIXES[FORMATS[system]]}"
            if f"binaries/{folder_}/{expected}" in subject.files:
                continue
            inside = [f for f in subject.files if f.startswith(f"binaries/{folder_}/")]
            static = [f for f in inside if f.endswith((".a", ".lib"))]
            present = sorted(b.name for b in subject.binaries if b.platform == folder_)
            if present or not static:
                text = f"expected {expected} for {kind}, got {', '.join(present[:4]) or 'no library'}"
                yield _severity(folder_, subject)(f"binaries/{folder_}: {text}")


def platform_wasm(subject: Subject) -> Iterator[str]:
    """Folders of WebAssembly have a module with the name of the model identifier."""
    kinds = {b"\x01\0\0\0": "module", b"\r\0\x01\0": "component"}  # bytes 4 to 7: version and layer
    for folder_ in (f for f in folders(subject) if WASM.fullmatch(f)):
        for identifier in {e.get("modelIdentifier") for e in subject.model.interfaces.values()}:
            file = f"binaries/{folder_}/{identifier}.wasm"
            if file not in subject.files:
                yield f"binaries/{folder_}: expected {identifier}.wasm, found no such file"
                continue
            with (subject.folder / file).open("rb") as opened:
                head = opened.read(8)
            got = kinds.get(head[4:], "") if head[:4] == b"\0asm" else ""
            expected = "component" if folder_.endswith("p2") else "module"
            if got != expected:
                yield f"{file}: expected a WebAssembly {expected}, got {got or 'another format'}"


SCRIPTS = "resources/"
FMU_PACKAGES = ("pythonfmu", "pythonfmu3", "unifmu_fmi2", "unifmu")


def _scripts(subject: Subject) -> list[str]:
    return sorted(f for f in subject.files if f.startswith(SCRIPTS) and f.endswith(".py"))


def _evidence(subject: Subject) -> Iterator[str]:
    """Evidence that Python is needed."""
    for b in subject.binaries:
        libraries_ = [n for n in b.libraries if PYTHON_LIBRARY.fullmatch(n)]
        functions_ = sorted(i for i in b.imports if re.match(r"_?Py_?[A-Z]", i))
        if libraries_:
            yield f"{b} needs {libraries_[0]}"
        elif len(functions_) > 2:
            more = len(functions_) - 1
            yield f"{b} calls {functions_[0]} and {more} more functions of Python without needing libpython"
    tool = "" if subject.root is None else str(subject.root.get("generationTool", ""))
    if "resources/slavemodule.txt" in subject.files or "pythonfmu" in tool.lower():
        yield "it was made by PythonFMU"
    launcher = "resources/launch.toml"
    if launcher in subject.files and "python" in (subject.folder / launcher).read_text("utf-8", "replace"):
        yield f"{launcher} starts Python"


def python_needed(subject: Subject) -> Iterator[str]:
    """The FMU runs without Python on the target machine."""
    if evidence := list(_evidence(subject)):
        yield (
            f"needs Python on the target: {'; '.join(evidence[:2])}; the target machine needs the same Python"
            " on its path, with all packages"
        )


def python_packages(subject: Subject) -> Iterator[str]:
    """Scripts import only the standard library."""
    if not any(_evidence(subject)):
        return
    scripts = _scripts(subject)
    shipped = {s.removeprefix(SCRIPTS).partition("/")[0].removesuffix(".py") for s in scripts}
    packages_: dict[str, str] = {}
    for script in scripts:
        tree, _ = _parsed(subject, script)
        nodes = [*ast.walk(tree)] if tree else []
        names = {a.name for n in nodes if isinstance(n, ast.Import) for a in n.names}
        names |= {n.module for n in nodes if isinstance(n, ast.ImportFrom) and n.module and not n.level}
        for name in sorted({name.partition(".")[0] for name in names}):
            if name not in {*sys.stdlib_module_names, *shipped, *FMU_PACKAGES}:
                packages_.setdefault(name, script)
    for name, script in packages_.items():
        yield f"{script}: imports {name}, which must be installed on the target machine"


def _parsed(subject: Subject, script: str) -> tuple[ast.Module | None, Finding | None]:
    """A script as a tree, or why it cannot be parsed."""
    try:
        return ast.parse((subject.folder / script).read_text("utf-8", "replace")), None
    except (SyntaxError, ValueError) as problem:
        return None, warning(f"{script}: Python cannot parse it: {problem}")
    except (RecursionError, MemoryError):
        return None, note(f"{script}: is nested too deeply to be parsed")


def python_syntax(subject: Subject) -> Iterator[Finding]:
    """Scripts can be parsed by Python."""
    yield from filter(None, (_parsed(subject, script)[1] for script in _scripts(subject)))
