"""Good FMUs, with all that a tool can wish for: the lag in good.c for FMI 2 and FMI 3, on four platforms."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import ziglang
from kit import compile
from kit.any_fmu.description import packed
from kit.compile import SHARED

SOURCE = Path(__file__).with_name("good.c")
TARGETS = {  # target of the compiler -> folder in FMI 2, folder in FMI 3, suffix
    "x86_64-linux-gnu.2.17": ("linux64", "x86_64-linux", ".so"),
    "x86_64-windows-gnu": ("win64", "x86_64-windows", ".dll"),
    "x86_64-macos.11.0": ("darwin64", "x86_64-darwin", ".dylib"),
    "aarch64-macos.11.0": ("aarch64-darwin", "aarch64-darwin", ".dylib"),
}
DESCRIPTION = "modelDescription.xml"
XML_2, XML_3, BUILD, TERMINALS = (
    SOURCE.with_name(f"{name}.xml").read_text(encoding="utf-8")
    for name in ("good2", "good3", "good_build", "good_terminals")
)
# for systems whose C library the compiler would first have to make, which takes it minutes
WINDOWS_HEADERS = Path(ziglang.__file__).parent / "lib/libc/include/any-windows-any"
FREESTANDING = ["-nostdlib", "-fno-builtin", "-DFREESTANDING", "-idirafter", str(WINDOWS_HEADERS)]


@dataclass(frozen=True)
class Archive:
    """The content of an FMU: what each member holds."""

    major: int
    members: Mapping[str, bytes]

    def library(self, target: str = "x86_64-linux-gnu.2.17") -> str:
        """The member that holds the library of a target."""
        names = TARGETS[target]
        return f"binaries/{names[self.major - 2]}/lag{names[2]}"

    def put(self, name: str, content: bytes | str) -> Archive:
        """With one more member, or another content of it."""
        data = content.encode() if isinstance(content, str) else content
        return replace(self, members={**self.members, name: data})

    def drop(self, *starts: str) -> Archive:
        """Without the members whose names start so."""
        return replace(self, members={n: d for n, d in self.members.items() if not n.startswith(starts)})

    def swap(self, old: str, new: str, member: str = DESCRIPTION) -> Archive:
        """With a text replaced, which must be there once."""
        text = self.members[member].decode()
        assert text.count(old) == 1, f"{old!r} is there {text.count(old)} times in {member}"
        return self.put(member, text.replace(old, new))

    def write(self, path: Path) -> Path:
        """The file."""
        return packed(path, self.members)


Good = Mapping[int, Archive]  # the fixture `good`: by version of FMI


def compiled(target: str, *flags: str) -> bytes:
    """A library for a target; without debug information unless the flags ask for it."""
    # debug information without paths of this machine: they are a fault of their own
    paths = ["-fdebug-compilation-dir=project", f"-ffile-prefix-map={sys.prefix}=python"]
    more = paths if "-g" in flags else ["-s"]
    more += ["-Wl,-install_name,@rpath/lag.dylib"] if "macos" in target else []
    more += FREESTANDING if "linux" not in target else []
    flags = (*SHARED, "-std=c99", "-Wno-unused-parameter", *more, *flags)
    return compile.compiled(f"lag{TARGETS[target][2]}", [SOURCE], *flags, target=target).read_bytes()


def make(major: int) -> Archive:
    """The good FMU of a version."""
    icon = b"\x89PNG\r\n\x1a\n"
    members = {
        DESCRIPTION: (XML_2 if major == 2 else XML_3).encode(),
        "documentation/index.html": b"<html></html>",
        "documentation/licenses/license.txt": b"MIT",
        "sources/lag.c": SOURCE.read_bytes(),
        "terminalsAndIcons/icon.png": icon,
        "terminalsAndIcons/terminalsAndIcons.xml": TERMINALS.encode(),
    }
    if major == 2:
        members["model.png"] = icon
    else:
        members["sources/buildDescription.xml"] = BUILD.encode()
    archive = Archive(major, members)
    for target in TARGETS:
        archive = archive.put(archive.library(target), compiled(target, f"-DFMI={major}"))
    return archive
