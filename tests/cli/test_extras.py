"""The base installation: what works without the extras, and what a command says without its extra."""

import os
import re
import subprocess
import sys
import tarfile
import tomllib
from ast import literal_eval
from functools import cache
from importlib.metadata import PackageNotFoundError, packages_distributions
from pathlib import Path

import fmpy
import pytest
from diagnosis.test_diagnose import resting, written
from kit import shards
from kit.mistakes import entry

import orchestrator
from fmus import package_files
from orchestrator import read_recording, read_study, run
from orchestrator.__main__ import main
from orchestrator.base import compiler, files
from orchestrator.base.extras import EXTRAS, NEEDED_BY
from orchestrator.check.rules import identity
from orchestrator.cli import COMMANDS

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
# a finder that refuses modules, as if their packages were not installed; then the code of a test
HIDE = """
import sys

class Refusing:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {hidden!r}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)

sys.meta_path.insert(0, Refusing())
{code}
"""
packages = cache(packages_distributions)  # it reads the metadata of all packages: half a second
EVERY = sorted({module for modules in EXTRAS.values() for module in modules})


def without(hidden, code, folder):
    """Run code in a process that cannot import the modules."""
    script = HIDE.format(hidden=tuple(hidden), code=code)
    environment = os.environ | {"PYTHONPATH": str(ROOT), "PYTHONWARNINGS": "error"}
    command = [sys.executable, "-c", script]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, env=environment)


def package_of(module):
    """The package that brings a module."""
    (package,) = packages()[module]
    return package.lower().replace("_", "-")


def test_the_extras_are_those_of_the_project_file():
    """The messages name extras that exist, and each package is in the extra that they name."""
    declared = PROJECT["optional-dependencies"]
    for extra, modules in EXTRAS.items():
        named = {re.match(r"[\w-]+", requirement)[0].lower() for requirement in declared[extra]}
        assert named == {package_of(module) for module in modules}, extra
    assert declared["all"] == [f"harvester-cosim[{','.join(EXTRAS)}]"]


def test_the_base_has_no_package_of_an_extra():
    """Else a command could need a package that its extra does not bring."""
    base = {re.match(r"[\w-]+", requirement)[0].lower() for requirement in PROJECT["dependencies"]}
    assert not base & {package_of(module) for module in EVERY}


def test_each_command_is_tried_as_the_table_in_readme_promises():
    """Those that the table names with their extra, all others without any."""
    promised = set[tuple[str, str, str]]()
    for extra, text in NEEDED_BY.items():
        named = re.findall(r"`(?:harvester )?(\w+)([\w -]*)`", text.partition(";")[0])
        promised |= {(name, extra, option) for name, option in named if name in COMMANDS}
    tried = {(name, extra) for extra, _, _, name in entry(__file__, "commands")}
    assert tried == {(name, extra) for name, extra, _ in promised}
    always = {name for name, _, option in promised if not option}
    assert {words[0] for words in entry(__file__, "base")} == {*COMMANDS} - always


# the commands one after the other: what each prints, and its exit status
EACH = """
import io
from contextlib import redirect_stderr, redirect_stdout
from orchestrator.__main__ import main
for words in {commands!r}:
    with redirect_stdout(io.StringIO()) as out, redirect_stderr(io.StringIO()) as err:
        status = main(words)
    print(repr((status, out.getvalue(), err.getvalue())))
"""


# extra -> what needs it, in the message, where it is not the command
NEEDING = {"reference": "the reference solution", "rating": "the rating of ISO/TS 18571"}


def test_a_command_without_its_extra_says_what_to_install(fmu_dir, tmp_path):
    """One line with the packages and the command, and the exit status of a mistake; nothing is written."""
    rows, system = entry(__file__, "commands"), fmu_dir / "harvester.ssp"
    commands = [[name, *(w.format(system=system) for w in words)] for _, words, _, name in rows]
    done = without(EVERY, EACH.format(commands=commands), tmp_path)
    assert len(done.stdout.splitlines()) == len(rows), done.stderr
    for (extra, _, modules, name), line in zip(rows, done.stdout.splitlines(), strict=True):
        status, out, told = literal_eval(line)
        install = re.escape(f'; install with: pip install "harvester-cosim[{extra}]"\n')
        who = NEEDING.get(extra, f"harvester {name}")
        assert re.fullmatch(f"harvester: {who} needs the packages? [\\w, ]+{install}", told), told
        assert all(module in told for module in modules or EXTRAS[extra]), told
        assert (status, out) == (2, ""), name
    assert not any(path.is_file() for path in tmp_path.rglob("*"))


# a call, and the Problem that tells what to install
CALLS = {
    "orchestrator.read_recording('a.parquet')": ("a.parquet: a .*", "pyarrow", "files"),
    "orchestrator.read_recording('a.mat')": ("a.mat: a .*", "h5py", "files"),
    "orchestrator.Linear.to_control(None)": (".*", "control", "control"),
    "orchestrator.Trace.to_pandas(None)": (".*", "pandas", "files"),
}


def test_a_call_that_needs_a_package_says_so(tmp_path):
    """As a Problem, whose message names the file, the package and what to install."""
    (tmp_path / "a.parquet").write_bytes(b"PAR1")
    (tmp_path / "a.mat").write_bytes(b"\0" * 512 + b"\x89HDF\r\n\x1a\n")
    (tmp_path / "a.toml").write_text('[signals."manipulator.boom_angle"]\nunit = "rad"\n', encoding="utf-8")
    each = "try: {}\nexcept orchestrator.Problem as problem: print(problem)\n"
    done = without(EVERY, "import orchestrator\n" + "".join(map(each.format, CALLS)), tmp_path)
    assert len(done.stdout.splitlines()) == len(CALLS), done
    for line, (begin, package, extra) in zip(done.stdout.splitlines(), CALLS.values(), strict=True):
        install = rf'install with: pip install "harvester-cosim\[{extra}\]"'
        assert re.fullmatch(rf"{begin} the package {package}; {install}", line)


def test_any_other_import_of_an_extra_is_one_line_too(tmp_path):
    """Where no check was made in advance: no traceback."""
    imported = "m.application = lambda *_: lambda **_: __import__('starlette')"
    code = f"import orchestrator.__main__ as m\n{imported}\nsys.exit(m.main([]))"
    done = without(EVERY, code, tmp_path)
    install = 'install with: pip install "harvester-cosim[view]"'
    told = f"harvester: the package starlette is not installed; {install}\n"
    assert (done.returncode, done.stderr) == (2, told)


def test_a_command_of_the_base_needs_no_extra(fmu_dir, diagnosis_fmu, tmp_path):
    """It runs although no package of any extra can be imported; a short recording cannot be diagnosed."""
    for name in ("a", "b"):
        (tmp_path / f"{name}.csv").write_text("time,part.speed\n0,0\n1,1\n2,0\n", encoding="utf-8")
    written(tmp_path, resting(2.0), "today.csv")
    names = {"system": fmu_dir / "harvester.ssp", "fmu": fmu_dir / "supply.fmu", "diagnosis": diagnosis_fmu}
    commands = [[argument.format(**names) for argument in arguments] for arguments in entry(__file__, "base")]
    code = "from orchestrator.__main__ import main\n"
    code += f"for words in {commands!r}:\n    status = main(words)\n"
    code += "    assert status == 3 * (words[0] == 'diagnose'), (words, status)"
    done = without(EVERY, code, tmp_path)
    assert done.returncode == 0, done.stderr
    assert "harvester: " not in done.stderr


@pytest.mark.parametrize("path", sorted(identity.FOLDER.rglob("*.xsd")), ids=lambda path: path.name)
def test_the_schemas_are_those_of_the_standard(path):
    """As FMPy contains them, too."""
    theirs = Path(fmpy.__file__).parent / "schema" / path.relative_to(identity.FOLDER)
    assert theirs.read_bytes() == path.read_bytes()


# one system and two variants; all files together take long to compress
SOME = ("harvester.ssp", "[bmos]*.fmu", "variants/swing_lumped.fmu", "variants/*_detailed.fmu")


@pytest.fixture(scope="module")
def archives(built, tmp_path_factory):
    """The archive of the FMUs that match some patterns, as in the wheel but compressed less, made once."""

    @cache
    def packed(*patterns):
        folder = tmp_path_factory.mktemp("package")
        for pattern in (*patterns, *(f"fmi3/{pattern}" for pattern in patterns)):
            for file in built.glob(pattern):
                (folder / file.relative_to(built)).parent.mkdir(parents=True, exist_ok=True)
                (folder / file.relative_to(built)).symlink_to(file)
        (folder / "faults").mkdir()  # two that are there already stand for others
        (folder / "faults" / "diagnosis.fmu").symlink_to(built / "supply.fmu")
        (folder / "faults" / "swing.fmu").symlink_to(built / "manipulator.fmu")
        package_files.pack(folder, folder / "built.tar.xz", preset=0)
        return folder / "built.tar.xz"

    return packed


@pytest.fixture
def wheel(archives, tmp_path_factory, tmp_path, monkeypatch):
    """The cache of a user with an empty working folder, and with a package that contains built FMUs."""
    cache = tmp_path_factory.mktemp("cache")
    monkeypatch.setattr(package_files, "BUILT", archives(*SOME))
    monkeypatch.setattr(compiler, "cache_folder", lambda: cache)
    for module in (files, package_files):
        monkeypatch.setattr(module, "CHECKOUT", Path("none"))
    monkeypatch.chdir(tmp_path)
    return cache


@pytest.mark.parametrize("some", [SOME, pytest.param(("*.*", "variants/*"), marks=shards.documents)])
def test_the_archive_restores_the_files(some, archives):
    """The same files with the same bytes; without FMI 3.0 those of FMI 2.0."""
    archive = archives(*some)
    folder = archive.parent
    names = [p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.suffix in (".fmu", ".ssp")]
    files = {name: (folder / name).read_bytes() for name in names}
    assert dict(package_files.unpack(archive)) == files
    second = {name: data for name, data in files.items() if not name.startswith("fmi3/")}
    assert dict(package_files.unpack(archive, fmi3=False)) == second


def test_the_archive_has_each_fmu_once(archives):
    """Those in systems and the default variants are links."""
    with tarfile.open(archives(*SOME)) as opened:
        entries = {entry.name: entry for entry in opened}
    assert entries["harvester.ssp/resources/swing.fmu"].linkname == "swing.fmu"
    assert entries["variants/swing_lumped.fmu"].linkname == "swing.fmu"
    assert entries["fmi3/harvester.ssp/resources/swing.fmu"].linkname == "fmi3/swing.fmu"
    assert not any(entry.isfile() for name, entry in entries.items() if name.endswith(".fmu"))


def test_without_a_built_system_commands_take_the_one_in_the_package(wheel, capsys):
    """They say so, and their results are in the working folder."""
    assert main(["run", "--stop", "0.01", "--swap", "boom_stick=detailed"]) == 0
    told = f"{Path('build/harvester.ssp')} does not exist; using the one in the package: {wheel}"
    assert told in capsys.readouterr().err
    assert Path("build/trace.csv").is_file()
    assert main(["run", "none/harvester.ssp"]) == 2  # a system that the user names is never replaced
    assert capsys.readouterr().err.startswith(f"harvester: {Path('none/harvester.ssp')}: no such file; did")


@pytest.mark.usefixtures("wheel")
def test_what_is_shipped_has_names(capsys, monkeypatch):
    """In commands and in Python, from an empty folder; a path of a checkout does, too, and is told once."""
    monkeypatch.setattr(files, "_told", set())
    options = {"stop": 0.01, "record": ["swing.swing_pressure_a"]}
    heavy = run("harvester", "boom_up", **options)
    assert "does not exist" not in capsys.readouterr().err  # a slow machine tells that it unpacks
    for _ in range(2):
        same = run("build/harvester.ssp", "data/scenarios/boom_up.csv", **options)
    assert same.provenance.files == heavy.provenance.files
    told = "build/harvester.ssp does not exist", "data/scenarios/boom_up.csv does not exist"
    assert [line[: line.index(";")] for line in capsys.readouterr().err.splitlines()] == list(told)
    assert main(["check", "swing", "--static"]) == 0
    assert main(["check", "build/variants/swing_detailed.fmu", "--static"]) == 0
    assert read_study("examples/swing_peaks/small.toml").system_file.name == "harvester.ssp"
    assert read_recording("data/reference/work_cycle.csv").heading == read_recording("work_cycle").heading
    with pytest.raises(AttributeError, match=r"no attribute 'runn'; did you mean run"):
        orchestrator.runn  # noqa: B018


def test_the_fmus_that_diagnose_are_in_the_package(wheel, capsys):
    """`diagnose` takes that of its default path; a plain name is a healthy part."""
    written(Path(), resting(0.1), "today.csv")
    assert main(["diagnose", "today.csv"]) == 2  # this one has other inputs
    place = Path("build/faults/diagnosis.fmu")
    told, problem = capsys.readouterr().err.splitlines()[-2:]
    assert told.startswith(f"{place} does not exist; using the one in the package: {wheel}")
    assert problem.startswith("harvester: today.csv: no column has the name of an input of diagnosis.fmu: ")
    assert files.find("swing", files.FMUS).parent.name != "faults"
    assert main(["build", "--shipped", "--fmi", "2"]) == 0
    assert place.is_file()


@pytest.mark.usefixtures("wheel")
def test_a_built_system_goes_before_the_one_in_the_package(fmu_dir, capsys):
    """Also for `--version`, which says where the FMUs are."""
    assert main(["--version"]) == 0
    assert f"FMUs: those in the package, {package_files.BUILT}\n" in capsys.readouterr().out
    Path("build").mkdir()
    Path("build/harvester.ssp").write_bytes((fmu_dir / "harvester.ssp").read_bytes())
    assert main(["run", "--stop", "0.01"]) == 0
    assert capsys.readouterr().err == ""
    assert main(["--version"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("harvester-cosim ")
    assert lines[-1] == f"FMUs: built, in {Path('build').resolve()}"


@pytest.mark.usefixtures("wheel")
def test_the_fmus_in_the_package_can_be_copied(fmu_dir, capsys, monkeypatch):
    """Without a compiler, to the same places where a build puts them; in a checkout there are none."""
    assert main(["build", "--shipped", "--fmi", "2"]) == 0
    copied = {p.relative_to("build").as_posix() for p in Path("build").rglob("*") if p.is_file()}
    assert {"harvester.ssp", "swing.fmu", "variants/swing_detailed.fmu"} <= copied
    healthy = [name for name in copied if not name.startswith("faults/")]
    assert all((Path("build") / name).read_bytes() == (fmu_dir / name).read_bytes() for name in healthy)
    assert main(["build", "--shipped", "--platform", "all"]) == 2
    monkeypatch.setattr(package_files, "BUILT", Path("none"))
    assert main(["build", "--shipped"]) == 2
    assert "only the wheel of harvester-cosim contains built FMUs" in capsys.readouterr().err


def test_a_library_in_the_package_needs_no_compiler(tmp_path, monkeypatch):
    """It is taken if sources and arguments are the same, else the line says what to install."""

    def missing(name):
        raise PackageNotFoundError(name)

    monkeypatch.setattr(compiler, "COMPILED", tmp_path)
    monkeypatch.setattr(compiler, "version", missing)
    recipe = "one.so", {"one.c": b"int one(void) { return 1; }"}, ["-shared", "one.c"]
    compiler.shipped_file(*recipe).write_bytes(b"a library")
    assert compiler.shared_library(*recipe) == compiler.shipped_file(*recipe)
    moved = *recipe[:2], [*recipe[2], str(tmp_path)]  # a folder of headers is elsewhere on each computer
    assert compiler.shipped_file(*moved) == compiler.shipped_file(*recipe)
    other = "one.so", {"one.c": b"int one(void) { return 2; }"}, ["-shared", "one.c"]
    install = re.escape('install with: pip install "harvester-cosim[build]"')
    with pytest.raises(compiler.CompilerError, match=install):
        compiler.shared_library(*other)
