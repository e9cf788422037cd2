"""Headers of the shared libraries of an FMU, in the same terms for ELF, PE and Mach-O; functions to export.

A library must export all functions of its interface types, also if a capability flag is false (FMI 2.0.5,
section 2.3). In FMI 3 it must export all functions of fmi3Functions.h (FMI 3.0.1, section 2.5).
"""

import warnings
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from orchestrator.base.interrupts import DeferredInterrupts
from orchestrator.worker.calls import FUNCTIONS_2, FUNCTIONS_3

SUFFIXES = {"ELF": ".so", "PE": ".dll", "Mach-O": ".dylib"}
MACHINES = {
    "X86_64": "x86_64",
    "AMD64": "x86_64",
    "I386": "x86",
    "X86": "x86",
    "AARCH64": "aarch64",
    "ARM64": "aarch64",
    "ARM": "aarch32",
    "ARMNT": "aarch32",
}
MAX_SIZE = 300 << 20  # bytes of a library; lief needs twice as much. The largest in use have 200 MB
NAMES = {"exports": frozenset, "imports": frozenset} | dict.fromkeys(
    ("libraries", "unresolved", "rpaths"), tuple
)
DEBUG_SECTIONS = (".debug_info", ".zdebug_info", "__debug_info")


@dataclass(frozen=True)
class Binary:
    """One shared library, or one architecture of a universal one.

    file         path inside the FMU: binaries/linux64/swing.so
    format       ELF, PE, Mach-O; "" if unknown
    exports      names of exported functions, without the underscore of Mach-O
    libraries    names of the libraries that it needs
    unresolved   undefined symbols that none of these libraries provides, as far as the file shows
    versions     newest symbol version of each family that it needs: {"GLIBC": (2, 17)}
    rpaths       search path for libraries
    traits       unusual properties: "executable stack", "writable code", "text relocations", "unsigned"
    debug        size of the debug sections [bytes]
    macos        oldest macOS that loads it, as written
    head         the first bytes of the file
    damage       why the file cannot be read
    """

    file: str
    size: int
    format: str = ""
    machine: str = ""
    is_library: bool = True
    exports: frozenset[str] = frozenset()
    libraries: tuple[str, ...] = ()
    imports: frozenset[str] = frozenset()
    unresolved: tuple[str, ...] = ()
    versions: Mapping[str, tuple[int, ...]] = field(default_factory=dict)
    rpaths: tuple[str, ...] = ()
    traits: tuple[str, ...] = ()
    debug: int = 0
    macos: tuple[int, ...] = ()
    head: bytes = b""
    damage: str = ""

    def __str__(self) -> str:
        return self.file

    @property
    def platform(self) -> str:
        """The folder below binaries."""
        return self.file.split("/")[1]

    @property
    def name(self) -> str:
        return self.file.rpartition("/")[2]

    @property
    def stem(self) -> str:
        return self.name.rpartition(".")[0]


def read_all(folder: Path, files: Iterable[str]) -> tuple[Binary, ...]:
    """The shared libraries among the files, those directly in a platform folder."""
    candidates = [f for f in files if f.startswith("binaries/") and f.count("/") == 2]
    return tuple(b for f in candidates if f.endswith(tuple(SUFFIXES.values())) for b in _read(folder / f, f))


def _read(path: Path, file: str) -> list[Binary]:
    """One library, or the parts of a universal one; without format if the file cannot be read."""
    with path.open("rb") as opened:
        head = opened.read(64)
    size, damage = path.stat().st_size, ""
    if size > MAX_SIZE:
        return [Binary(file, size, head=head, damage=f"more than {MAX_SIZE / 1e6:.0f} MB")]
    try:
        with warnings.catch_warnings():  # lief warns about each unusual value in a header
            warnings.simplefilter("ignore")
            binaries = [Binary(file, size, **_decoded(b)) for b in _parse(path)] if size else []
    except Exception as problem:  # lief raises many types on invalid headers
        binaries, damage = [], f"{type(problem).__name__} while reading it"
    return binaries or [Binary(file, size, head=head, damage=damage)]


def _parse(path: Path) -> Iterator[dict[str, Any]]:
    """The fields of the binary, or of the parts of a universal one."""
    with DeferredInterrupts():  # one while lief is loaded would abort this process
        import lief

    lief.logging.disable()
    if lief.is_elf(str(path)):
        yield _elf(lief, _checked(lief.ELF.parse(str(path))))
    elif lief.is_pe(str(path)):
        yield _pe(lief, _checked(lief.PE.parse(str(path))))
    elif lief.is_macho(str(path)):
        universal = _checked(lief.MachO.parse(str(path)))  # must exist as long as its parts are used
        for part in range(universal.size):
            yield _macho(lief, universal.at(part))


def _decoded(fields: dict[str, Any]) -> dict[str, Any]:
    """The fields with texts only; lief returns names that are not UTF-8 as bytes."""
    for field_, kind in NAMES.items():
        names = fields.get(field_, ())
        texts = (n.decode(errors="replace") if isinstance(n, bytes) else str(n) for n in names)
        fields[field_] = kind(texts)
    return fields


def _checked(parsed: Any) -> Any:
    if parsed is None:
        raise ValueError("damaged")
    return parsed


def _machine(value: Any) -> str:
    """A machine type as in the platform tuples of FMI 3, else as in the file."""
    return MACHINES.get(value.name, str(value.name).lower())


def _elf(lief: Any, b: Any) -> dict[str, Any]:
    tags, types, flags = lief.ELF.DynamicEntry.TAG, lief.ELF.Segment.TYPE, lief.ELF.Segment.FLAGS
    executable = [s for s in b.segments if s.has(flags.X)]
    undefined = [s for s in b.dynamic_symbols if not s.shndx and s.name]
    versions: dict[str, tuple[int, ...]] = {}
    families = {}
    for requirement in b.symbols_version_requirement:
        for auxiliary in requirement.get_auxiliary_symbols():
            family, _, version = auxiliary.name.partition("_")
            families[requirement.name] = family
            numbers = tuple(int(n) for n in version.split(".") if n.isdigit())
            versions[family] = max(versions.get(family, ()), numbers)
    traits = {
        "executable stack": any(s.type == types.GNU_STACK for s in executable),
        "writable code": any(s.type == types.LOAD and s.has(flags.W) for s in executable),
        "text relocations": b.has(tags.TEXTREL),
    }
    libraries = [str(n) for n in b.libraries]
    return {
        "format": "ELF",
        "machine": _machine(b.header.machine_type),
        "is_library": b.header.file_type == lief.ELF.Header.FILE_TYPE.DYN,
        "exports": [s.name for s in b.dynamic_symbols if s.shndx and s.name],
        "libraries": libraries,
        "imports": [s.name for s in undefined],
        "unresolved": _unresolved(lief, undefined, libraries, families),
        "versions": versions,
        "rpaths": [p for e in b.dynamic_entries if e.tag in (tags.RPATH, tags.RUNPATH) for p in e.paths],
        "traits": tuple(trait for trait, found in traits.items() if found),
        "debug": sum(s.size for s in b.sections if s.name in DEBUG_SECTIONS),
    }


def _unresolved(
    lief: Any, symbols: list[Any], libraries: Iterable[str], versioned: Iterable[str]
) -> tuple[str, ...]:
    """Undefined symbols without a version, if all needed libraries have versioned symbols.

    All symbols of glibc and of the compiler's libraries have versions. A symbol without version must come
    from another library, which the file does not list.
    """
    if not set(versioned) or set(libraries) - set(versioned):
        return ()
    weak = lief.ELF.Symbol.BINDING.WEAK
    strong = (s for s in symbols if s.binding != weak)
    unversioned = [s for s in strong if not (s.has_version and s.symbol_version.has_auxiliary_version)]
    return tuple(sorted(s.name for s in unversioned))


def _pe(lief: Any, b: Any) -> dict[str, Any]:
    flags = lief.PE.Section.CHARACTERISTICS
    executable = [s for s in b.sections if s.has_characteristic(flags.MEM_EXECUTE)]
    writable_code = any(s.has_characteristic(flags.MEM_WRITE) for s in executable)
    return {
        "format": "PE",
        "machine": _machine(b.header.machine),
        "is_library": b.header.has_characteristic(lief.PE.Header.CHARACTERISTICS.DLL),
        "exports": [e.name for e in b.exported_functions],
        "libraries": dict.fromkeys(str(n) for n in b.libraries),
        "imports": [e.name for i in b.imports for e in i.entries if e.name],
        "traits": ("writable code",) * writable_code,
        "debug": sum(s.size for s in b.sections if s.name.startswith((".debug", "/"))),
    }


def _macho(lief: Any, b: Any) -> dict[str, Any]:
    arm, files = b.header.cpu_type == lief.MachO.Header.CPU_TYPE.ARM64, lief.MachO.Header.FILE_TYPE
    macos = (
        b.build_version.minos if b.has_build_version else b.version_min.version if b.has_version_min else ()
    )
    # libraries for old versions of macOS list their exports in the symbol table only, as external symbols of
    # a section: N_EXT is set, N_TYPE is N_SECT, N_STAB is zero
    exports = list(b.exported_functions) or [s for s in b.symbols if s.raw_type & 0xEF == 0x0F]
    return {
        "format": "Mach-O",
        "machine": _machine(b.header.cpu_type),
        "is_library": b.header.file_type in (files.DYLIB, files.BUNDLE),
        "exports": [str(s.name).removeprefix("_") for s in exports],
        "libraries": [n.name for n in b.libraries if n.command != lief.MachO.LoadCommand.TYPE.ID_DYLIB],
        "imports": [s.name.removeprefix("_") for s in b.imported_symbols],
        "rpaths": [r.path for r in b.rpaths],
        "traits": ("unsigned",) * (arm and not b.has_code_signature),
        "debug": sum(s.size for s in b.sections if s.name in DEBUG_SECTIONS),
        "macos": tuple(macos),
    }


def required(major: int, kinds: Collection[str]) -> tuple[str, ...]:
    """Names of all functions that a library with these interface types must export."""
    if major == 3:
        return tuple(f"fmi3{name}" for name in FUNCTIONS_3.split())
    names = [n for kind, functions in FUNCTIONS_2.items() if kind in ("", *kinds) for n in functions.split()]
    return tuple(f"fmi2{name}" for name in names)
