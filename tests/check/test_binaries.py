"""Planted faults in shared libraries: compiled in, or patched in."""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from pathlib import Path

import lief
import pytest

from check.good import TARGETS, Archive, compiled
from check.test_faults import new_findings

LINUX, WINDOWS, INTEL_MAC, ARM_MAC = TARGETS
SONAME = "libharvester_tables.so.1"

Patch = Callable[[Archive, Path], Archive]


def flags(*options: str, target: str = LINUX) -> Patch:
    """The library of one target compiled with additional options."""

    def patch(good: Archive, _: Path) -> Archive:
        library = compiled(target, f"-DFMI={good.major}", *options)
        return good.put(good.library(target), library)

    return patch


def data(change: Callable[[bytes], bytes], target: str = LINUX) -> Patch:
    """Other bytes of the library of one target."""
    return lambda good, _: good.put(good.library(target), change(good.members[good.library(target)]))


def elf(change: Callable[[lief.ELF.Binary], object]) -> Patch:
    """The library for Linux, changed with lief."""

    def patch(good: Archive, folder: Path) -> Archive:
        binary = lief.ELF.parse(good.members[good.library()])
        assert binary is not None
        change(binary)
        binary.write(str(folder / "changed.so"))
        return good.put(good.library(), (folder / "changed.so").read_bytes())

    return patch


def move(old: str, new: str) -> Patch:
    """A member under another name."""
    return lambda good, _: good.put(new, good.members[old]).drop(old)


def _segment(binary: lief.ELF.Binary, kind: object) -> lief.ELF.Segment:
    return next(s for s in binary.segments if s.type == kind)


def _executable_stack(binary: lief.ELF.Binary) -> None:
    _segment(binary, lief.ELF.Segment.TYPE.GNU_STACK).add(lief.ELF.Segment.FLAGS.X)


def _writable_code(binary: lief.ELF.Binary) -> None:
    loads = [s for s in binary.segments if s.type == lief.ELF.Segment.TYPE.LOAD]
    next(s for s in loads if s.has(lief.ELF.Segment.FLAGS.X)).add(lief.ELF.Segment.FLAGS.W)


def _prefixed(binary: lief.ELF.Binary) -> None:
    for symbol in binary.dynamic_symbols:
        if str(symbol.name).startswith("fmi2"):
            symbol.name = f"lag_{symbol.name}"


def _fortran(good: Archive, folder: Path) -> Archive:
    """The library needs the Fortran runtime, which is documented as the standard requires."""
    changed = elf(lambda b: b.add_library("libgfortran.so.5"))(good, folder)
    return changed.put("documentation/externalDependencies.txt", "libgfortran")


def _other_machine(library: bytes) -> bytes:
    """ELF's machine type is the 16-bit word at 18; 183 is AArch64."""
    return library[:18] + struct.pack("<H", 183) + library[20:]


def _newer_glibc(library: bytes) -> bytes:
    return library.replace(b"GLIBC_2.14\0", b"GLIBC_2.38\0").replace(b"GLIBC_2.2.5\0", b"GLIBC_2.38\0\0")


def _exporting(*names: str) -> Callable[[lief.ELF.Binary], None]:
    """The library exports more names, at the place of one that it has."""

    def change(binary: lief.ELF.Binary) -> None:
        address = next(s.value for s in binary.dynamic_symbols if s.name == "fmi2Reset")
        for name in names:
            binary.add_exported_function(address, name)

    return change


def _new_macos(good: Archive, folder: Path) -> Archive:
    return _mac(good, folder, lambda part: setattr(part.build_version, "minos", [15, 0, 0]))


def _unsigned(good: Archive, folder: Path) -> Archive:
    return _mac(good, folder, lambda part: part.remove_signature())


def _mac(good: Archive, folder: Path, change: Callable[[lief.MachO.Binary], object]) -> Archive:
    """The library for Apple processors, changed with lief."""
    binary = lief.MachO.parse(good.members[good.library(ARM_MAC)])
    assert binary is not None
    part = binary.at(0)
    assert part is not None
    change(part)
    part.write(str(folder / "changed.dylib"))
    return good.put(good.library(ARM_MAC), (folder / "changed.dylib").read_bytes())


def _without_rpath(good: Archive, folder: Path) -> Archive:
    """The library needs one in the same folder, and has no rpath to find it."""
    changed = elf(lambda b: b.add_library(SONAME))(good, folder)
    return changed.put(f"binaries/linux64/{SONAME}", b"")


LACKS = "-DLACKING"
EMPTY = data(lambda _: b"")
LFS = b"version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 1\n"
FAULTS: Mapping[str, tuple[str, Patch, str]] = {
    "function missing, Linux": ("binary.functions", flags(LACKS), "fmi2GetDirectionalDerivative"),
    "function missing, Windows": ("binary.functions", flags(LACKS, target=WINDOWS), "win64"),
    "function missing, Mac": ("binary.functions", flags(LACKS, target=ARM_MAC), "aarch64-darwin"),
    "functions with prefix": ("binary.functions", elf(_prefixed), "static linking"),
    "undefined symbol": ("binary.symbols", elf(lambda b: b.add_dynamic_symbol(_undefined())), "Py_Anything"),
    "functions of FMI 3": ("binary.version", elf(_exporting("fmi3GetVersion")), "fmi3GetVersion"),
    "names of its own": ("binary.private", elf(_exporting(*(f"help_{i}" for i in range(30)))), "help_0"),
    "new macOS": ("binary.macos", _new_macos, "15"),
    "debug information": ("binary.debug", flags("-g"), "debug"),
    "executable stack": ("binary.traits", elf(_executable_stack), "2.41"),
    "writable code": ("binary.traits", elf(_writable_code), "writable code"),
    "unsigned for Apple": ("binary.traits", _unsigned, "unsigned"),
    "Fortran runtime": ("binary.libraries", _fortran, "Fortran"),
    "rpath of the machine": ("binary.path", flags("-Wl,-rpath,/srv/anna/lib"), "/srv/anna/lib"),
    "library in the same folder, not found": ("binary.loader", _without_rpath, "$ORIGIN"),
    "new glibc": ("binary.glibc", data(_newer_glibc), "2.38"),
    "path of the machine": ("contents.machine", data(lambda b: b + b"\0/home/anna/lag.c\0"), "/home/anna"),
    "other machine": ("platform.format", data(_other_machine), "expected code for x86_64, got aarch64"),
    "no library": ("platform.format", data(lambda _: b"#!/bin/sh\n"), "unknown format"),
    "empty library": ("platform.format", EMPTY, "empty"),
    "Git LFS pointer": ("platform.format", data(lambda _: LFS), "Git LFS"),
    "other name": ("platform.name", move("binaries/win64/lag.dll", "binaries/win64/log.dll"), "lag.dll"),
    "folder of FMI 3": (
        "platform.folder",
        lambda good, _: good.put("binaries/x86_64-linux/lag.so", good.members[good.library()]),
        "expected binaries/linux64",
    ),
    "unknown folder": (
        "platform.folder",
        lambda good, _: good.put("binaries/plan9/lag.so", good.members[good.library()]),
        "plan9",
    ),
    "no Windows": ("platform.windows", lambda good, _: good.drop("binaries/win64"), "win64"),
    "no Linux": ("platform.linux", lambda good, _: good.drop("binaries/linux64"), "linux64"),
    "no Apple": ("platform.macos", lambda good, _: good.drop("binaries/aarch64-darwin"), "Apple"),
    "no binaries": ("platform.some", lambda good, _: good.drop("binaries"), "only sources"),
}


def _undefined() -> lief.ELF.Symbol:
    symbol = lief.ELF.Symbol()
    symbol.name = "Py_Anything"
    symbol.binding = lief.ELF.Symbol.BINDING.GLOBAL
    symbol.shndx = 0
    return symbol


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_in_a_library_is_reported_by_its_rule_alone(
    good: Mapping[int, Archive], name: str, tmp_path: Path
) -> None:
    """One change of a library or its folder gives findings of one rule."""
    rule, patch, expected = FAULTS[name]
    found = new_findings(patch(good[2], tmp_path), tmp_path)
    assert {r for r, _, _ in found} == {rule}, found
    assert any(expected in text for _, _, text in found), found


def test_fmi_3_needs_the_functions_of_all_kinds(good: Mapping[int, Archive], tmp_path: Path) -> None:
    """An FMI 3 library without the constructor of a kind that the FMU does not even offer is refused."""
    broken = flags(LACKS)(good[3], tmp_path)
    found = new_findings(broken, tmp_path)
    assert [r for r, _, _ in found] == ["binary.functions"]
    assert "fmi3InstantiateScheduledExecution" in found[0][2]


def test_foreign_libraries_must_be_documented(good: Mapping[int, Archive], tmp_path: Path) -> None:
    """FMI 3 asks for documentation/externalDependencies when the FMU needs other libraries."""
    broken = elf(lambda b: b.add_library("libgfortran.so.5"))(good[3], tmp_path)
    found = {rule: severity for rule, severity, _ in new_findings(broken, tmp_path)}
    assert found == {"binary.libraries": "warning", "binary.documented": "error"}


def test_each_kind_may_have_its_own_binary(good: Mapping[int, Archive], tmp_path: Path) -> None:
    """Two model identifiers are noted, and each needs a library of its name on each platform."""
    two = good[2].swap('<ModelExchange modelIdentifier="lag"', '<ModelExchange modelIdentifier="lag_me"')
    assert {rule for rule, _, _ in new_findings(two, tmp_path)} == {"identity.same", "platform.name"}
    for member in [m for m in two.members if m.startswith("binaries/")]:
        two = two.put(member.replace("lag.", "lag_me."), two.members[member])
    assert {rule for rule, _, _ in new_findings(two, tmp_path)} == {"identity.same"}


@pytest.mark.parametrize("identifier", ["my lag", "2lag", "double", "läg"])
def test_a_model_identifier_is_a_c_identifier(
    good: Mapping[int, Archive], identifier: str, tmp_path: Path
) -> None:
    """Model identifiers name binaries and C functions; anything else is an error."""
    named = good[2]
    for kind in ("ModelExchange", "CoSimulation"):
        named = named.swap(f'<{kind} modelIdentifier="lag"', f'<{kind} modelIdentifier="{identifier}"')
    assert "identity.identifier" in {rule for rule, _, _ in new_findings(named, tmp_path)}


def test_a_keyword_as_model_identifier_is_noted(good: Mapping[int, Archive], tmp_path: Path) -> None:
    """An FMU called operator is legal; a wrapper in Modelica or C++ cannot have its name."""
    named = good[2]
    for kind in ("ModelExchange", "CoSimulation"):
        named = named.swap(f'<{kind} modelIdentifier="lag"', f'<{kind} modelIdentifier="operator"')
    for member in [m for m in named.members if m.startswith("binaries/")]:
        named = named.put(member.replace("lag.", "operator."), named.members[member]).drop(member)
    found = new_findings(named, tmp_path)
    assert [(rule, severity) for rule, severity, _ in found] == [("identity.keyword", "note")]
    assert "Modelica and C++" in found[0][2]
