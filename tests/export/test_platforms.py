"""Shared libraries for all platforms: where they lie, what is in them, what they ask of a machine."""

import ctypes
import hashlib
import platform
import re
import struct
import zipfile
from functools import cache
from pathlib import Path

import lief
import numpy as np
import pytest
from kit import shards
from kit.compile import SHARED, compiled
from kit.mistakes import problem, table

import fmus
from fmus.export.build import build
from fmus.export.compile import HEADERS, PLATFORMS, host, select, universal
from fmus.machine.one_block import HARVESTER
from fmus.swing import SWING
from orchestrator.base.compiler import SUFFIX
from orchestrator.check.checking import check

lief.logging.disable()

# FMI 2.0 with the smallest FMU, FMI 3.0 with the largest
FMUS = {2: SWING, 3: HARVESTER}
FOLDERS = {3: {name: name for name in PLATFORMS}}
FOLDERS[2] = FOLDERS[3] | {"x86_64-linux": "linux64", "x86_64-windows": "win64", "x86_64-darwin": "darwin64"}


@pytest.fixture(scope="session")
def everywhere(tmp_path_factory):
    """FMI version -> folder with an unpacked FMU for all platforms, the .fmu file beside it."""
    folders = {}
    for fmi, sub in FMUS.items():
        path = build(sub, tmp_path_factory.mktemp(f"fmi{fmi}"), fmi=fmi, platforms=tuple(PLATFORMS))
        folders[fmi] = path.with_suffix("")
        with zipfile.ZipFile(path) as archive:
            archive.extractall(folders[fmi])
    return folders


@pytest.fixture
def library(request):
    """library(3, "x86_64-linux"): the path of a shared library; that of this computer is the machine's."""

    def find(fmi: int, name: str) -> Path:
        member = f"binaries/{FOLDERS[fmi][name]}/{FMUS[fmi].name}{PLATFORMS[name].suffix}"
        if name != host():
            return request.getfixturevalue("everywhere")[fmi] / member
        folder = request.getfixturevalue("fmu_dir" if fmi == 2 else "fmi3_dir")
        target = request.getfixturevalue("tmp_path")
        with zipfile.ZipFile(folder / f"{FMUS[fmi].name}.fmu") as archive:
            return Path(archive.extract(member, target))

    return find


EACH = [name if name == host() else pytest.param(name, marks=shards.platforms) for name in PLATFORMS]


@cache  # a part must not outlive the file it is part of
def parse(path: Path) -> lief.ELF.Binary | lief.PE.Binary | lief.MachO.FatBinary:
    kind = {".so": lief.ELF, ".dll": lief.PE, ".dylib": lief.MachO}[path.suffix]
    return kind.parse(str(path))


def mach(path: Path) -> list[lief.MachO.Binary]:
    """The libraries in a macOS file, one per processor."""
    return [parse(path).at(i) for i in range(parse(path).size)]


# ---- choice of platforms ---------------------------------------------------------------------------


@table(__file__, "hosts", "system, processor, name")
def test_host_has_the_name_of_the_standard(monkeypatch, system, processor, name):
    """Python's names of system and processor become FMI's platform tuple."""
    monkeypatch.setattr(platform, "system", lambda: system)
    monkeypatch.setattr(platform, "machine", lambda: processor)
    assert host() == name


def test_unknown_host_is_told(monkeypatch):
    """An unsupported platform gives one line with the supported ones."""
    monkeypatch.setattr(platform, "system", lambda: "FreeBSD")
    monkeypatch.setattr(platform, "machine", lambda: "riscv64")
    problem(host, r"^FreeBSD on riscv64 is not supported, expected one of x86_64-linux, .*$")


def test_words_of_the_user_become_platforms():
    """host and all too; each once, in a fixed order; wasm is not in all, and alone brings the host."""
    assert select(["all"]) == tuple(PLATFORMS)
    assert select(["host"]) == (host(),)
    assert select(["x86_64-windows", "x86_64-linux", "x86_64-windows"]) == ("x86_64-linux", "x86_64-windows")
    problem(lambda: select(["linux64"]), r"'linux64' is unknown, expected host, all or x86_64-linux, .*wasm$")
    assert select(["wasm"]) == (host(), "wasm")
    assert select(["all", "wasm"]) == (*PLATFORMS, "wasm")
    assert select(["x86_64-windows", "wasm"]) == ("x86_64-windows", "wasm")


@pytest.mark.parametrize(
    ("fmi", "sub"), [(2, SWING), (3, SWING), pytest.param(3, HARVESTER, marks=shards.platforms)]
)
def test_wasm_module(fmi, sub, tmp_path):
    """Each version of FMI gets a module next to its library; the checker finds nothing wrong with it."""
    path = build(sub, tmp_path, fmi=fmi, platforms=select(["wasm"]))
    name = f"binaries/wasm32-wasip1/{sub.name}.wasm"
    with zipfile.ZipFile(path) as archive:
        module = archive.read(name)
    assert module[:8] == b"\0asm\1\0\0\0"
    exported = (b"malloc", b"free", f"fmi{fmi}DoStep".encode(), f"fmi{fmi}GetDirectionalDerivative".encode())
    assert all(function in module for function in exported)
    assert [f.text for f in check(path, run=False).findings if "wasm" in f.text] == []


# ---- layout ----------------------------------------------------------------------------------------


@shards.platforms
@pytest.mark.parametrize("fmi", FMUS)
def test_binaries_lie_where_the_standard_says(everywhere, fmi):
    """Folders of FMI 2.0, with tuples for what it does not name, and tuples of FMI 3.0.

    With all platforms, sources and documentation the file is small enough for an e-mail: 3 MB.
    """
    folder, library = everywhere[fmi] / "binaries", FMUS[fmi].name
    found = {p.relative_to(folder).as_posix() for p in folder.rglob("*.*")}
    assert found == {f"{own}/{library}{PLATFORMS[name].suffix}" for name, own in FOLDERS[fmi].items()}
    assert everywhere[fmi].with_suffix(".fmu").stat().st_size < 3e6


@shards.platforms
def test_universal_library_holds_both_processors(library):
    """The library for macOS of FMI 2.0 runs on Intel and on Apple Silicon; its parts are those made alone."""
    path = library(2, "x86_64-darwin")
    both, arm = path.read_bytes(), library(2, "aarch64-darwin").read_bytes()
    assert [b.header.cpu_type.name for b in mach(path)] == ["X86_64", "ARM64"]
    parts = [struct.unpack_from(">IIIII", both, 8 + 20 * i) for i in range(2)]
    assert all(offset % 2**align == 0 for _, _, offset, _, align in parts)
    intel, again = (both[offset : offset + size] for _, _, offset, size, _ in parts)
    assert again == arm
    assert universal([intel, arm]) == both


# ---- what a library offers and asks for ------------------------------------------------------------


def functions(fmi: int) -> set[str]:
    """All functions of a version of FMI, from its header."""
    header = (HEADERS / f"fmi{fmi}Functions.h").read_text()
    return set(re.findall(r"#define (fmi\d\w+)\s+fmi\dFullName\(", header))


def exports(path: Path) -> set[str]:
    """Names that a library gives to the loader."""
    if path.suffix == ".so":
        return {s.name for s in parse(path).exported_symbols}
    if path.suffix == ".dll":
        return {e.name for e in parse(path).get_export().entries}
    # the linker adds two names of its own, which no other library sees: names on macOS belong to a library
    own = {"__mh_dylib_header", "___dso_handle"}
    tables = [{e.symbol.name for e in b.dyld_info.exports} - own for b in mach(path)]
    assert all(table == tables[0] for table in tables)
    return {name.removeprefix("_") for name in tables[0]}


@pytest.mark.parametrize("fmi", FMUS)
@pytest.mark.parametrize("name", EACH)
def test_library_exports_the_functions_of_its_version_and_nothing_else(library, fmi, name):
    """The library exports all FMI functions, which importers look up, and nothing else."""
    assert len(functions(fmi)) > 40
    assert exports(library(fmi, name)) == functions(fmi)


@pytest.mark.parametrize("fmi", FMUS)
@pytest.mark.parametrize("name", [e for e in EACH if "linux" in str(e)])
def test_linux_library_runs_on_old_systems(library, fmi, name):
    """The library depends only on the C library, in a version not newer than glibc 2.17 of 2012."""
    elf = parse(library(fmi, name))
    assert set(elf.libraries) <= {"libc.so.6", "libm.so.6"}
    asked = {a.name for needed in elf.symbols_version_requirement for a in needed.get_auxiliary_symbols()}
    assert asked
    assert all(tuple(map(int, v.removeprefix("GLIBC_").split("."))) <= (2, 17) for v in asked), asked
    stack = next(s for s in elf.segments if s.type == lief.ELF.Segment.TYPE.GNU_STACK)
    assert not stack.has(lief.ELF.Segment.FLAGS.X)  # hardened systems refuse such a library


@shards.platforms
@pytest.mark.parametrize("fmi", FMUS)
def test_windows_library_needs_only_what_windows_has(library, fmi):
    """The library depends only on KERNEL32 and the C library of Windows 10."""
    dll = parse(library(fmi, "x86_64-windows"))
    allowed = re.compile(r"KERNEL32\.dll|api-ms-win-crt-[a-z]+-l1-1-0\.dll", re.IGNORECASE)
    assert all(allowed.fullmatch(i.name) for i in dll.imports), [i.name for i in dll.imports]
    assert dll.get_export().name == f"{FMUS[fmi].name}.dll"
    header = dll.optional_header
    assert (header.major_subsystem_version, header.minor_subsystem_version) <= (10, 0)


@pytest.mark.parametrize("fmi", FMUS)
@pytest.mark.parametrize("name", [e for e in EACH if "darwin" in str(e)])
def test_macos_library_needs_only_the_system(library, fmi, name):
    """The library depends only on libSystem of macOS 11; its install name contains no folder of the build."""
    for part in mach(library(fmi, name)):
        own, *others = [(entry.command.name, entry.name) for entry in part.libraries]
        assert own == ("ID_DYLIB", f"@rpath/{FMUS[fmi].name}.dylib")
        assert others == [("LOAD_DYLIB", "/usr/lib/libSystem.B.dylib")]
        assert part.build_version.minos <= [11, 0, 0]


@shards.platforms
@pytest.mark.parametrize("fmi", FMUS)
def test_apple_silicon_library_is_signed(library, fmi):
    """macOS ends a process that loads ARM code without a signature; its hashes are those of the pages."""
    data = library(fmi, "aarch64-darwin").read_bytes()
    (part,) = mach(library(fmi, "aarch64-darwin"))
    start = part.code_signature.data_offset
    magic, _, count, kind, at = struct.unpack_from(">IIIII", data, start)
    assert (magic, count, kind) == (0xFADE0CC0, 1, 0)  # one code directory
    directory = start + at
    flags, hashes, _, _, pages, limit = struct.unpack_from(">IIIIII", data, directory + 12)
    size, algorithm, _, shift = struct.unpack_from("BBBB", data, directory + 36)
    assert flags & 2  # ad hoc: no certificate
    assert (size, algorithm) == (32, 2)  # SHA-256
    assert pages == -(-limit // 2**shift)
    for i in range(pages):
        page = data[i << shift : min((i + 1) << shift, limit)]
        stored = data[directory + hashes + i * size :][:size]
        assert hashlib.sha256(page).digest() == stored


FORMATS = [b"%.15g", b"%g", b"%.9g", b"%.3g", b"%.6g"]  # of messages in fmus/export/native
NUMBERS = [0.0, -0.0, 1.0, -2.5, 1e-5, 1e-4, 123456.0, 1234567.0, 999999.5, 0.1, 1e22, 1e23, 5e-324, 1.8e308]


def test_a_module_writes_messages_as_c_does():
    """Its small library has the digits of the C library, in any length of text, and its texts."""
    source = Path(fmus.__file__).parent / "export" / "wasm" / "library.c"
    made = compiled(f"library{SUFFIX}", [source], *SHARED, "-fno-builtin", "-DNAMED(name)=our_##name")
    library = ctypes.CDLL(str(made))
    text = ctypes.create_string_buffer(400)

    def written(form, *values, size=400):
        used = library.our_snprintf(text, ctypes.c_size_t(size), form, *values)
        return used, text.value

    rng = np.random.default_rng(3)
    random = rng.normal(size=2000) * 10.0 ** rng.integers(-300, 300, 2000)
    for value in [*NUMBERS, np.nan, np.inf, -np.inf, *map(float, random)]:
        for form in FORMATS:
            expected = form % value
            assert written(form, ctypes.c_double(value)) == (len(expected), expected)
    all_ = (b"a", ctypes.c_int(-7), ctypes.c_uint(9), ctypes.c_size_t(2**40), ctypes.c_double(0.25))
    whole = b"a -7 9 1099511627776 0.25 %"
    assert written(b"%s %d %u %zu %g %%", *all_) == (27, whole)
    assert written(b"%s %d %u %zu %g %%", *all_, size=9) == (27, whole[:8])
    assert library.our_strspn(b" \t x", b" \t") == 3
    assert [library.our_strcmp(b"ab", b) for b in (b"ab", b"aa", b"abc")] == [0, 1, -ord("c")]
