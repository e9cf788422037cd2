"""Builds .fmu files: generate, compile, pack. The same subsystem gives the same bytes."""

from __future__ import annotations

import platform
import subprocess
import sys
import tempfile
import uuid
import zipfile
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from importlib.resources import files
from pathlib import Path

import fmpy

from fmus.contract import ModelError, Subsystem
from fmus.export.codegen import sources
from fmus.export.documentation import page
from fmus.export.interface import interface
from fmus.export.model_description import model_description
from fmus.parameters import Values, values

# FMI name of a platform -> (target of the compiler, suffix of a shared library)
TARGETS = {
    "linux64": ("x86_64-linux-gnu.2.17", ".so"),
    "win64": ("x86_64-windows-gnu", ".dll"),
    "darwin64": (f"{'aarch64' if platform.machine() == 'arm64' else 'x86_64'}-macos", ".dylib"),
}
FLAGS = (
    *("-std=c99", "-O3", "-g0", "-fPIC", "-shared", "-fvisibility=hidden"),
    *("-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wshadow", "-Werror"),
    *("-ffp-contract=off", "-fno-math-errno", "-fno-trapping-math"),
)
_PLACEHOLDER = "{00000000-0000-0000-0000-000000000000}"
_NAMESPACE = uuid.uuid5(uuid.NAMESPACE_URL, "harvester-cosim")


def build(
    sub: Subsystem, out_dir: Path, step: float = 1e-3, stop: float = 10.0, numbers: Values | None = None
) -> Path:
    """Write `<sub.name>.fmu` to `out_dir` and return its path.

    step, stop   default experiment [s]
    numbers      parameters and start values; by default those of the subsystem's parameters.toml
    """
    content = _content(sub, numbers or values(sub), step, stop)
    suffix = TARGETS[host()][1]
    content[f"binaries/{host()}/{sub.name}{suffix}"] = _compile(sub.name, content, host())
    path = Path(out_dir) / f"{sub.name}.fmu"
    path.parent.mkdir(parents=True, exist_ok=True)
    pack(path, content)
    return path


def build_all(subs: Sequence[Subsystem], out_dir: Path, step: float = 1e-3, stop: float = 10.0) -> list[Path]:
    """Build several FMUs; the compilers run at the same time."""
    with ThreadPoolExecutor() as pool:
        return list(pool.map(lambda sub: build(sub, out_dir, step, stop), subs))


def host() -> str:
    """FMI name of the platform this runs on."""
    names = {("Linux", "x86_64"): "linux64", ("Windows", "AMD64"): "win64", ("Darwin", "x86_64"): "darwin64"}
    names[("Darwin", "arm64")] = "darwin64"
    machine = (platform.system(), platform.machine())
    if machine not in names:
        raise ModelError(
            f"no FMI 2.0 platform for {' '.join(machine)}, expected x86-64 Linux, Windows or macOS"
        )
    return names[machine]


def native_sources() -> dict[str, str]:
    """The hand-written C files by name."""
    folder = files("fmus.export") / "native"
    return {f.name: f.read_text(encoding="utf-8") for f in folder.iterdir() if f.name.endswith((".c", ".h"))}


def _content(sub: Subsystem, numbers: Values, step: float, stop: float) -> dict[str, bytes]:
    """All files of the FMU but the binary; the GUID is a fingerprint of their text."""
    face = interface(sub, numbers)
    code = native_sources() | sources(face, _PLACEHOLDER)
    compiled = sorted(name for name in code if name.endswith(".c"))
    draft = model_description(face, _PLACEHOLDER, compiled, step, stop).decode()
    fingerprint = "\n".join([draft, *(code[name] for name in sorted(code))])
    guid = f"{{{uuid.uuid5(_NAMESPACE, fingerprint)}}}"
    content = {f"sources/{name}": text.replace(_PLACEHOLDER, guid).encode() for name, text in code.items()}
    content["modelDescription.xml"] = draft.replace(_PLACEHOLDER, guid).encode()
    content["documentation/index.html"] = page(sub, face).encode()
    if sub.values.is_file():  # provenance of the numbers
        content["resources/parameters.toml"] = sub.values.read_bytes()
    icon = sub.values.parent / "icon.png"
    if icon.is_file():
        content["model.png"] = icon.read_bytes()
    return content


def _compile(name: str, content: Mapping[str, bytes], target: str) -> bytes:
    """The shared library for a platform, from the files under sources/."""
    triple, suffix = TARGETS[target]
    with tempfile.TemporaryDirectory() as folder:
        for path, data in content.items():
            if path.startswith("sources/"):
                (Path(folder) / Path(path).name).write_bytes(data)
        library = f"{name}{suffix}"
        code = sorted(p.name for p in Path(folder).glob("*.c"))
        headers = Path(fmpy.__file__).parent / "c-code"
        command = [sys.executable, "-m", "ziglang", "cc", "-target", triple, *FLAGS, "-s", f"-I{headers}"]
        command += [*code, "-o", library, *([] if target == "win64" else ["-lm"])]
        run = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
        if run.returncode:
            raise ModelError(f"{name}: the C compiler failed with exit status {run.returncode}\n{run.stderr}")
        return (Path(folder) / library).read_bytes()


def pack(path: Path, content: Mapping[str, bytes]) -> None:
    """A zip file with fixed times and order."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in sorted(content):
            entry = zipfile.ZipInfo(name, date_time=(1980, 1, 1, 0, 0, 0))
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.create_system = 3
            entry.external_attr = 0o644 << 16
            archive.writestr(entry, content[name])
