"""The C in an FMU as its users compile it: all files in one project, and two FMUs in one program."""

import subprocess
from pathlib import Path

import fmpy
import fmu_manipulation_toolbox
import pytest
from kit import shards
from kit.compile import HEADERS, compiled
from kit.fmu import Fmu
from native.bench import needs_gcc

from fmus.machine.one_block import HARVESTER
from fmus.machine.parts import FERIC
from orchestrator.base.compiler import PLATFORMS, host

PROGRAM = Path(__file__).with_name("two_fmus.c")
# the standard's own header of FMI 2, and that of FMPy, which ignores the prefix
STANDARD = Path(fmu_manipulation_toolbox.__file__).parent / "resources" / "fmi"
WINDOWS = "x86_64-windows"
pytestmark = shards.c  # compilers
WARNINGS = (
    *("-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wshadow"),
    *("-Wmissing-prototypes", "-Wredundant-decls", "-Werror"),
)


def project(fmu: Path) -> tuple[list[Path], list[Path]]:
    """Of an unpacked FMU: what a project compiles that has all of its .c files, and the other files."""
    files = sorted((fmu / "sources").iterdir())
    code = [path for path in files if path.suffix == ".c"]
    return code, [path for path in files if path not in code]


@pytest.fixture
def folder(unpacked, request, tmp_path):
    """folder(2, "swing"): an unpacked FMU, of a toy or of the machine."""

    def find(version: int, name: str) -> Path:
        if (version, name) in unpacked:
            return unpacked[version, name]
        fmu = request.getfixturevalue("fmu_dir" if version == 2 else "fmi3_dir") / f"{name}.fmu"
        return Path(fmpy.extract(str(fmu), str(tmp_path / name)))

    return find


# without parameters, states or inputs no array has length zero
LACKING = ("path", "gain", "blowup")


@pytest.mark.parametrize("platform", [host(), WINDOWS, pytest.param("gcc", marks=needs_gcc)])
@pytest.mark.parametrize("name", [*LACKING, *FERIC.components, HARVESTER.name])
@pytest.mark.parametrize("version", [2, 3])
def test_all_c_files_in_one_project_compile_without_a_warning(folder, version, name, platform):
    """Adding sources/*.c to a project makes the library: nothing is there twice or lacks its context."""
    code, others = project(folder(version, name))
    if platform == "gcc":
        flags = ("-O2", "-shared", "-fPIC", *WARNINGS, f"-isystem{HEADERS}")
        command = ["gcc", *flags, *code, "-o", "/dev/null"]
        run = subprocess.run(command, capture_output=True, text=True, check=False)
        assert (run.returncode, run.stderr) == (0, "")
        return
    own = PLATFORMS[platform]
    flags = ("-O0", "-fno-sanitize=undefined", "-shared", *WARNINGS, "-isystem", str(HEADERS))
    flags += ("-fPIC",) if platform == host() else ()
    library = compiled(f"{name}{own.suffix}", code, *flags, included=others, target=own.target)
    assert b"fmi2DoStep" in library.read_bytes() or version == 3
    assert b"fmi3DoStep" in library.read_bytes() or version == 2


TOYS = ("decay", "target", "mixed"), ("vanderpol", "force", "x")
MACHINE = ("swing", "swing_speed", "swing_torque"), ("manipulator", "swing_torque", "swing_speed")


@pytest.mark.parametrize(("parts", "command"), [(TOYS, ("rate", 3.0)), (MACHINE, ("swing_command", 6.0))])
@pytest.mark.parametrize(("version", "headers"), [(2, HEADERS), (2, STANDARD), (3, HEADERS)])
def test_two_fmus_in_one_program(folder, version, headers, parts, command):
    """With a prefix for each, two FMUs link into one program and step as they do in their own libraries."""
    libraries, objects, arguments = [], [], []
    flags = ("-O1", "-isystem", str(headers))
    for name, taken, given in parts:
        path = folder(version, name)
        code, others = project(path)
        prefix = f"-DFMI{version}_FUNCTION_PREFIX={name}_"
        objects.append(compiled(f"{name}.o", code, "-c", prefix, *flags, *WARNINGS, included=others))
        libraries.append(Fmu(path))
        references = libraries[-1].references
        arguments += [libraries[-1].description.guid, references[taken], references[given]]
    names = [f"-D{place}={part[0]}_" for place, part in zip(("FIRST", "SECOND"), parts, strict=True)]
    flags = (f"-DVERSION={version}", *names, *flags, "-std=c99")
    program = compiled("two_fmus.exe", [PROGRAM, *objects], *flags)
    arguments += [libraries[0].references[command[0]], command[1]]
    run = subprocess.run([program, *map(str, arguments)], capture_output=True, text=True, check=True)

    first, second = libraries
    first.start(), second.start()
    first.set(**dict([command]))
    for _ in range(100):
        a, b = first[parts[0][2]], second[parts[1][2]]
        first.set(**{parts[0][1]: b}).step(1e-3)
        second.set(**{parts[1][1]: a}).step(1e-3)
    expected = [first[parts[0][2]], second[parts[1][2]]]
    first.close(), second.close()
    assert all(expected)
    # other optimisation: rounding, amplified by the step control of the solver to its tolerance, 1e-6
    assert [float(value) for value in run.stdout.split()] == pytest.approx(expected, rel=1e-6)
