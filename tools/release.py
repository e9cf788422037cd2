"""Makes the files of a release in dist/: wheel, sdist, and a zip for people without Python.

    python tools/release.py            all platforms: ten minutes of processor time for the FMUs, which
                                       all cores share; 1.5 more once, for the C libraries of the platforms
    python tools/release.py host       a try, for this computer only

1. The files of the last commit are copied to build/release, so that nothing else gets into the release.
2. `harvester build --platform all` writes FMUs and systems, which go to fmus/built.tar.xz there; with
   `--faults` those that find what is broken, of FMI 2.0.
3. The libraries that commands load go to orchestrator/compiled.
4. Hatchling packs wheel and sdist. The sdist contains no built files.
5. The zip contains the FMUs and systems, and the documentation page of each FMU.

Equal commits, compilers and packages give equal bytes: members are sorted, times are that of the commit or
fixed, and FMUs and libraries contain neither times nor paths. `SHA256SUMS` has the hashes.
"""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import subprocess
import sys
import textwrap
import time
import tomllib
import zipfile
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from importlib.metadata import version
from pathlib import Path

# in the folder faults: the FMUs of harvester_sensors.ssp
PARTS = ("swing", "boom_stick", "manipulator", "supply")
SENSED = (*PARTS, "valve_actuation", "controller", "sensors", "diagnosis")
ROOT = Path(__file__).resolve().parents[1]
STAGE, BUILT, DIST = ROOT / "build" / "release", ROOT / "build" / "release-fmus", ROOT / "dist"
READ_ME = """harvester-cosim {version}: an electrohydraulic forestry harvester as FMUs

fmi2/    FMUs of FMI 2.0 (Co-Simulation and Model Exchange) and systems (.ssp, SSP 1.0)
fmi3/    the same as FMI 3.0 and SSP 2.0
         variants/ in both: the parts at other levels of detail, with the same ports
         faults/ in fmi2: the parts with faults as inputs, sensors and diagnosis of a control unit

documentation/   a page for each FMU: equations, ports, parameters with sources; the FMUs contain it, too

Each FMU runs on Linux (x86-64, ARM), Windows (x86-64) and macOS (x86-64, ARM) without other software.
harvester.fmu is the whole machine; harvester.ssp connects its parts; harvester_control.ssp has a controller.
harvester_actuation.ssp and harvester_control.ssp have the hysteresis of the valves (valve_actuation.fmu).

To connect the parts yourself, connect equal names, and the names that differ as listed. A rate port is
connected to the port of its name. The commands come from operator_input, controller, or your own signals.

{connections}

Simulink and OpenModelica set unconnected inputs to 0 instead of their start values.
{unpowered}
Connect constants there: each page lists the start values.
{held}
"""


def main() -> int:
    """Make the release; PLATFORM... as in `harvester build`."""
    platforms = sys.argv[1:] or ["all"]
    declared = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]
    if (installed := version("harvester-cosim")) != declared:  # the FMUs say by which version they were made
        print(
            f"pyproject.toml: version {declared}: expected the installed one, {installed}; pip install -e ."
        )
        return 2
    epoch = _output("git", "log", "-1", "--format=%ct").strip()
    os.environ.setdefault("SOURCE_DATE_EPOCH", epoch)
    if _output("git", "status", "--porcelain", "--untracked-files=no"):
        print("note: the release has the files of the last commit, without the changes since then")
    _timed("copy the files of the last commit", _stage)
    sys.path.insert(0, str(STAGE))  # the release is built by its own code
    os.environ["PYTHONPATH"] = str(STAGE)
    _timed(f"build the FMUs, platform {', '.join(platforms)}", partial(_build, platforms))
    _timed("compress the FMUs for the wheel", _archive)
    _timed("compile the libraries of the commands", partial(_compile, platforms))
    shutil.rmtree(DIST, ignore_errors=True)
    DIST.mkdir()
    _timed("pack wheel and sdist", _pack)
    _timed("pack the zip", _zip)
    sums = [f"{hashlib.sha256(p.read_bytes()).hexdigest()}  {p.name}" for p in sorted(DIST.iterdir())]
    (DIST / "SHA256SUMS").write_text("\n".join([*sums, ""]), encoding="utf-8")
    for path in sorted(DIST.iterdir()):
        print(f"dist/{path.name}  {path.stat().st_size / 1e6:.1f} MB")
    print(*sums, sep="\n")
    return 0


def _output(*command: str) -> str:
    return subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True).stdout


def _timed(what: str, step: Callable[[], None]) -> None:
    began = time.monotonic()
    print(f"{what} ...", flush=True)
    step()
    print(f"  {time.monotonic() - began:.0f} s", flush=True)


def _stage() -> None:
    shutil.rmtree(STAGE, ignore_errors=True)
    STAGE.mkdir(parents=True)
    data = subprocess.run(["git", "archive", "HEAD"], cwd=ROOT, check=True, capture_output=True).stdout
    subprocess.run(["tar", "-x"], cwd=STAGE, check=True, input=data)


def _build(platforms: Sequence[str]) -> None:
    shutil.rmtree(BUILT, ignore_errors=True)
    for_all = [word for name in platforms for word in ("--platform", name)]
    _harvester_build("--out", str(BUILT), *for_all)
    only = [word for name in SENSED for word in ("--only", name)]
    _harvester_build("--out", str(BUILT / "faults"), "--faults", "--fmi", "2", *only, *for_all)


def _harvester_build(*arguments: str) -> None:
    """In a process of its own, which imports the copy and not what this one has imported."""
    command = [sys.executable, "-m", "orchestrator", "build", *arguments]
    process = subprocess.Popen(
        command, cwd=STAGE, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
    )
    began = time.monotonic()
    assert process.stderr is not None
    for line in process.stderr:
        done, number = map(int, re.findall(r"\d+", line)) if line.startswith("compiling, ") else (0, 0)
        left = (time.monotonic() - began) * (number - done) / max(done, 1) / 60
        print(f"  {line.rstrip()}{f' some {left:.0f} min left' if done else ''}", flush=True)
    if process.wait():
        raise SystemExit("harvester build failed")


def _archive() -> None:
    from fmus.package_files import pack

    pack(BUILT, STAGE / "fmus" / "built.tar.xz")


def _compile(platforms: Sequence[str]) -> None:
    """Libraries under the names by which `orchestrator.base.compiler` looks for them."""
    from fmus.export.compile import WASM, select
    from orchestrator.base.compiler import COMPILED, shared_library, shipped_file
    from orchestrator.data import csv_text
    from orchestrator.engine import c_library

    COMPILED.mkdir()
    names = [name for name in select(platforms) if name != WASM]
    for arguments in (made.recipe(name) for name in names for made in (csv_text, c_library)):
        shutil.copyfile(shared_library(*arguments), shipped_file(*arguments))


def _pack() -> None:
    from hatchling.builders.sdist import SdistBuilder
    from hatchling.builders.wheel import WheelBuilder

    for builder in (WheelBuilder, SdistBuilder):
        list(builder(str(STAGE)).build(directory=str(DIST), versions=["standard"]))


def _zip() -> None:
    from orchestrator.base.files import write_zip

    (wheel,) = DIST.glob("*.whl")
    release = wheel.name.split("-")[1]
    top = f"harvester-fmus-{release}"
    members = {f"{top}/{name}": data for name, data in _members(release)}
    write_zip(DIST / f"{top}.zip", members)


def read_me(release: str) -> str:
    """The README of the zip."""
    from fmus.machine.build import HELD, UNPOWERED
    from fmus.machine.parts import FERIC
    from fmus.machine.ssp import wired_ports

    held = textwrap.fill(HELD, 110)
    wired = "\n".join(
        f"  {source}.{output} to {target}.{name}{rate and ', rate port '}{rate}"
        for source, output, target, name, rate in wired_ports(FERIC)
    )
    return READ_ME.format(version=release, connections=wired, held=held, unpowered=UNPOWERED)


def _members(release: str) -> Iterator[tuple[str, bytes]]:
    yield "README.txt", read_me(release).encode()
    yield "LICENSE.txt", (STAGE / "LICENSE").read_bytes()
    yield "NOTICES.md", (STAGE / "NOTICES.md").read_bytes()
    built = (p for p in BUILT.rglob("*") if p.is_file())
    # of two FMUs of one name the page of the healthy one, which comes later
    for path in sorted(built, key=lambda p: ("faults" not in p.parts, p)):
        relative = path.relative_to(BUILT)
        folder = "" if relative.parts[0] == "fmi3" else "fmi2/"
        yield f"{folder}{relative.as_posix()}", path.read_bytes()
        if path.suffix == ".fmu" and folder:
            with zipfile.ZipFile(path) as fmu:
                yield f"documentation/{path.stem}.html", fmu.read("documentation/index.html")


if __name__ == "__main__":
    sys.exit(main())
