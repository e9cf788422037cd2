"""Planted faults in shared libraries: compiled in, or patched in."""

import struct
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import lief
import pytest

from check.good import TARGETS, Archive, Good, compiled
from check.test_faults import new_findings
from orchestrator.check.binary import _macho, required

LINUX, WINDOWS, INTEL_MAC, ARM_MAC = TARGETS
SONAME = "libharvester_tables.so.1"

Patch = Callable[[Archive, Path], Archive]


def flags(*options: str, target: str = LINUX) -> Patch:
    """The library of one target compiled with additional options."""

    def patch(good: Archive, _: Path) -> Archive:
        library = compiled(target, f"-DFMI={good.major}", *options)
        return good.put(good.library(target), library)

    return patch


def copied(target: str) -> Patch:
    """The library for Linux in one more folder."""
    return lambda good, _: good.put(f"binaries/{target}/lag.so", good.members[good.library()])


def data(change: Callable[[bytes], bytes], target: str = LINUX) -> Patch:
    """Other bytes of the library of one target."""
    return lambda good, _: good.put(good.library(target), change(good.members[good.library(target)]))


def lib(change: Callable[[Any], object], target: str = LINUX) -> Patch:
    """The library of one target, changed with lief."""

    def patch(good: Archive, folder: Path) -> Archive:
        binary = lief.parse(good.members[good.library(target)])
        assert binary is not None
        change(binary)
        binary.write(str(folder / "changed"))
        return good.put(good.library(target), (folder / "changed").read_bytes())

    return patch


def move(old: str, new: str) -> Patch:
    """A member under another name."""
    return lambda good, _: good.put(new, good.members[old]).drop(old)


def _executable_stack(binary: lief.ELF.Binary) -> None:
    stack = next(s for s in binary.segments if s.type == lief.ELF.Segment.TYPE.GNU_STACK)
    stack.add(lief.ELF.Segment.FLAGS.X)


def _writable_code(binary: lief.ELF.Binary) -> None:
    loads = [s for s in binary.segments if s.type == lief.ELF.Segment.TYPE.LOAD]
    next(s for s in loads if s.has(lief.ELF.Segment.FLAGS.X)).add(lief.ELF.Segment.FLAGS.W)


def _prefixed(binary: lief.ELF.Binary) -> None:
    for symbol in binary.dynamic_symbols:
        if str(symbol.name).startswith("fmi2"):
            symbol.name = f"lag_{symbol.name}"


def _fortran(good: Archive, folder: Path) -> Archive:
    """The library needs the Fortran runtime, which is documented as the standard requires."""
    changed = lib(lambda b: b.add_library("libgfortran.so.5"))(good, folder)
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


def _new_macos(binary: lief.MachO.Binary) -> None:
    binary.build_version.minos = [15, 0, 0]


def _without_rpath(good: Archive, folder: Path) -> Archive:
    """The library needs one in the same folder, and has no rpath to find it."""
    changed = lib(lambda b: b.add_library(SONAME))(good, folder)
    return changed.put(f"binaries/linux64/{SONAME}", b"")


LACKS = "-DLACKING"
EMPTY = data(lambda _: b"")
LFS = b"version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 1\n"
FAULTS: Mapping[str, tuple[str, Patch, str]] = {
    "function missing, Linux": ("binary.functions", flags(LACKS), "fmi2GetDirectionalDerivative"),
    "function missing, Windows": ("binary.functions", flags(LACKS, target=WINDOWS), "win64"),
    "function missing, Mac": ("binary.functions", flags(LACKS, target=ARM_MAC), "aarch64-darwin"),
    "functions with prefix": ("binary.functions", lib(_prefixed), "static linking"),
    "undefined symbol": ("binary.symbols", lib(lambda b: b.add_dynamic_symbol(_undefined())), "Py_Anything"),
    "functions of FMI 3": ("binary.version", lib(_exporting("fmi3GetVersion")), "fmi3GetVersion"),
    "names of its own": ("binary.private", lib(_exporting(*(f"help_{i}" for i in range(30)))), "help_0"),
    "new macOS": ("binary.macos", lib(_new_macos, ARM_MAC), "15"),
    "debug information": ("binary.debug", flags("-g"), "debug"),
    "executable stack": ("binary.traits", lib(_executable_stack), "2.41"),
    "writable code": ("binary.traits", lib(_writable_code), "writable code"),
    "unsigned for Apple": ("binary.traits", lib(lambda b: b.remove_signature(), ARM_MAC), "unsigned"),
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
    "folder of FMI 3": ("platform.folder", copied("x86_64-linux"), "expected binaries/linux64"),
    "unknown folder": ("platform.folder", copied("plan9"), "plan9"),
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
def test_a_fault_in_a_library_is_reported_by_its_rule_alone(good: Good, name: str, tmp_path: Path) -> None:
    """One change of a library or its folder gives findings of one rule."""
    rule, patch, expected = FAULTS[name]
    found = new_findings(patch(good[2], tmp_path), tmp_path)
    assert {r for r, _, _ in found} == {rule}, found
    assert any(expected in text for _, _, text in found), found


@pytest.mark.parametrize(("target", "severity"), [(LINUX, "error"), (WINDOWS, "warning")])
def test_a_broken_binary_is_an_error_at_hand(good: Good, target: str, severity: str, tmp_path: Path) -> None:
    """A binary of another platform that has no content, or another name, is a warning."""
    file = good[2].library(target)
    for broken in (good[2].put(file, b""), move(file, f"{file[:-4]}_{file[-4:]}")(good[2], tmp_path)):
        assert {found for _, found, _ in new_findings(broken, tmp_path)} == {severity}


def test_what_only_fmi_3_asks_for(good: Good, tmp_path: Path) -> None:
    """FMI 3 wants the constructors of kinds that are not offered, and documentation of other libraries."""
    ((rule, _, text),) = new_findings(flags(LACKS)(good[3], tmp_path), tmp_path)
    assert rule == "binary.functions"
    assert "fmi3InstantiateScheduledExecution" in text
    broken = lib(lambda b: b.add_library("libgfortran.so.5"))(good[3], tmp_path)
    found = {rule: severity for rule, severity, _ in new_findings(broken, tmp_path)}
    assert found == {"binary.libraries": "warning", "binary.documented": "error"}


def test_each_kind_may_have_its_own_binary(good: Good, tmp_path: Path) -> None:
    """Two model identifiers are noted, and each needs a library of its name on each platform."""
    two = good[2].swap('<ModelExchange modelIdentifier="lag"', '<ModelExchange modelIdentifier="lag_me"')
    assert {rule for rule, _, _ in new_findings(two, tmp_path)} == {"identity.same", "platform.name"}
    for member in [m for m in two.members if m.startswith("binaries/")]:
        two = two.put(member.replace("lag.", "lag_me."), two.members[member])
    assert {rule for rule, _, _ in new_findings(two, tmp_path)} == {"identity.same"}


class _Old:
    """A library as lief reads it if the file has no tables of the dynamic loader (before macOS 10.6)."""

    exported_functions = ()

    def __init__(self, new: lief.MachO.Binary) -> None:
        self.new = new

    def __getattr__(self, name: str) -> Any:
        return getattr(self.new, name)


def test_an_old_library_of_macos_exports_by_its_symbol_table() -> None:
    """Its exports are those that the tables of the dynamic loader list in a new library."""
    library = lief.parse(compiled(INTEL_MAC, "-DFMI=2"))
    assert isinstance(library, lief.MachO.Binary)
    exports = {*_macho(lief, _Old(library))["exports"]}
    assert exports == {*_macho(lief, library)["exports"]} >= set(required(2, ["CoSimulation"]))


def named(archive: Archive, identifier: str) -> Archive:
    """With another model identifier."""
    for kind in ("ModelExchange", "CoSimulation"):
        archive = archive.swap(f'<{kind} modelIdentifier="lag"', f'<{kind} modelIdentifier="{identifier}"')
    return archive


@pytest.mark.parametrize("identifier", ["my lag", "2lag", "double", "läg"])
def test_a_model_identifier_is_a_c_identifier(good: Good, identifier: str, tmp_path: Path) -> None:
    """Model identifiers name binaries and C functions; anything else is an error."""
    found = new_findings(named(good[2], identifier), tmp_path)
    assert "identity.identifier" in {rule for rule, _, _ in found}


def test_a_keyword_as_model_identifier_is_noted(good: Good, tmp_path: Path) -> None:
    """An FMU called operator is legal; a wrapper in Modelica or C++ cannot have its name."""
    archive = named(good[2], "operator")
    for member in [m for m in archive.members if m.startswith("binaries/")]:
        archive = move(member, member.replace("lag.", "operator."))(archive, tmp_path)
    ((rule, severity, text),) = new_findings(archive, tmp_path)
    assert (rule, severity) == ("identity.keyword", "note")
    assert "Modelica and C++" in text
