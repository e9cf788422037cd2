"""FMUs and SSPs that are made to harm: what each of them tries, and the line that refuses it."""

import errno
import io
import os
import shutil
import struct
import tempfile
import time
import zipfile
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, nullcontext
from pathlib import Path

import pytest
from check.good import DESCRIPTION, XML_2, Archive
from files.damage import ENTITIES
from files.test_damaged_files import INNER, LONGEST, MAPPING, MOST, START, good_system, packed, peak
from kit import shards
from kit.any_fmu.models import Workshop
from kit.mistakes import entry, problem, table
from lxml import etree

from orchestrator import load, run
from orchestrator.base import files, toml
from orchestrator.base.errors import Problem
from orchestrator.base.files import MAX_DIRECTORY, MAX_NESTING, Location, extract_member, size_fault
from orchestrator.base.xml import MAX_ITEMS
from orchestrator.check.checking import check
from orchestrator.check.rules import archive as archive_rules
from orchestrator.check.subject import Subject
from orchestrator.drive.view_description import FILE, view_description
from orchestrator.fmi.description import read_description
from orchestrator.fmi.library import find_library
from orchestrator.results.validate_system import _provenance
from orchestrator.ssp.load import assemble
from orchestrator.ssp.system import open_component
from orchestrator.ssp.write import write_ssp

Members = Mapping[str, bytes]
GOOD: Members = {DESCRIPTION: XML_2.encode(), "binaries/linux64/lag.so": b"no library"}
ZEROS = bytes(150 << 20)
BOMB = 800_000_000  # bytes; above the size up to which any ratio is accepted


def archived(members: Mapping[str, bytes]) -> bytes:
    """An archive in memory."""
    return packed(io.BytesIO(), members).getvalue()


@pytest.fixture(scope="module")
def gain(fmus: Workshop) -> Path:
    """A good FMU."""
    return fmus["gain"]


def changed(
    path: Path, members: Members, name: str, changes: Sequence[tuple[str, str]], more: Members | None
) -> Path:
    """An archive with changes of the text of one member, and more members."""
    text = members[name].decode()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    path.write_bytes(archived({**members, name: text.encode(), **(more or {})}))
    return path


def fmu(path: Path, *changes: tuple[str, str], more: Members | None = None) -> Path:
    """A good FMU with changes of its description and more members."""
    return changed(path, GOOD, DESCRIPTION, changes, more)


def system(path: Path, gain: Path, *changes: tuple[str, str], more: Members | None = None) -> Path:
    """A good SSP with changes of its SystemStructure.ssd and more members."""
    return changed(path, good_system(gain), "SystemStructure.ssd", changes, more)


def in_directory(offset: int, kind: str, value: int, member: int = 0) -> Callable[[Path], None]:
    """Overwrite a number in the entry of a member in the directory of an archive."""

    def change(path: Path) -> None:
        data, at = bytearray(path.read_bytes()), -1
        for _ in range(member + 1):
            at = data.index(b"PK\x01\x02", at + 1)
        struct.pack_into(f"<{kind}", data, at + offset, value)
        path.write_bytes(data)

    return change


def with_member(name: str, data: bytes = b"", method: int = zipfile.ZIP_DEFLATED) -> Callable[[Path], None]:
    """Add a member, whatever its name."""

    def change(path: Path) -> None:
        info = zipfile.ZipInfo("x")
        info.filename, info.compress_type = name, method
        with zipfile.ZipFile(path, "a") as archive:
            archive.writestr(info, data)

    return change


def bomb(path: Path) -> None:
    """Add a member that declares much more than it has."""
    with_member("resources/bomb", b"0")(path)
    in_directory(24, "I", BOMB, member=2)(path)


def wrong_sum(path: Path) -> None:
    """Change the check sum of the library, in front of it and in the directory."""
    in_directory(16, "I", 1, member=1)(path)
    data = bytearray(path.read_bytes())
    struct.pack_into("<I", data, data.index(b"PK\x03\x04", 1) + 14, 1)
    path.write_bytes(data)


LZMA = with_member("a", b"b", zipfile.ZIP_LZMA)
ARCHIVES: list[tuple[Callable[[Path], None], str, str]] = [  # change, message of a run, rule of a check
    (wrong_sum, "cannot be unpacked into .*Bad CRC-32", "archive.zip"),
    (in_directory(8, "H", 1), "is encrypted, expected no encryption", "archive.method"),
    (in_directory(10, "H", 99), "compressed with 99, expected deflate or store", "archive.method"),
    (LZMA, "compressed with lzma, .* pack it again", "archive.method"),
    (in_directory(42, "I", 0, member=1), "expected separate members", "archive.zip"),
    (bomb, "expected at most 200 times its size", "archive.size"),
    (in_directory(24, "I", 0xFFFFFFF0), "MB unpacked, got 4295 MB", "archive.size"),
    (with_member("../evil"), "has '..' in its path", "archive.name"),
    (with_member("/outside/evil"), "expected a relative path", "archive.name"),
    (with_member("C:/evil"), "expected a relative path", "archive.name"),
    (with_member("..\\evil"), "has '..' in its path", "archive.name"),
    (with_member("\\\\host\\evil"), "expected a relative path", "archive.name"),
    (with_member("evil\0.txt"), "has a control character", "archive.name"),
    (with_member("d/" * 3000 + "x"), "has 6001 characters, expected at most 1000", "archive.name"),
    (with_member(f"{DESCRIPTION}/x"), "cannot be unpacked into", "archive.zip"),
]


@pytest.mark.parametrize(("change", "message", "rule"), ARCHIVES)
def test_an_archive_is_refused(change, message, rule, tmp_path, monkeypatch):
    """In a run by one line with the name of the file, in a check by a rule; nothing is left."""
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(temporary))
    path = fmu(tmp_path / "x.fmu")
    change(path)
    before = peak()
    assert str(path) in problem(Location(path).unpacked().__enter__, message)
    report = check(path, run=False)
    assert rule in {f.rule for f in report.findings if f.severity == "error"}
    assert change is not wrong_sum or "binaries/linux64/lag.so" in report.text()
    assert not list(temporary.iterdir())
    assert peak() - before < MOST / 10  # less than the bomb


def test_a_member_is_read_up_to_the_size_it_declares(tmp_path):
    """150 MB that declare 100 bytes take no memory."""
    path = fmu(tmp_path / "x.fmu", more={"resources/big": ZEROS})
    in_directory(24, "I", 100, member=2)(path)
    before = peak()
    problem(Location(path).member("resources/big").read, "resources/big: cannot be unpacked: Bad CRC-32")
    assert peak() - before < len(ZEROS) / 2


def test_sparse_data_are_no_bomb():
    """150 MB of zeros pack to 150 kB."""
    member = zipfile.ZipInfo("resources/map.bin")
    member.file_size = len(ZEROS)
    assert size_fault([member], len(ZEROS) // 1000) == ""
    member.file_size = BOMB
    assert "at most 200 times" in size_fault([member], BOMB // 1000)


def test_a_large_member_is_not_unpacked_to_be_refused(tmp_path, monkeypatch):
    """The size that it declares is above the limit of the reader."""
    path = fmu(tmp_path / "x.fmu")
    monkeypatch.setattr(zipfile.ZipFile, "open", lambda *_: pytest.fail("unpacked"))
    member = Location(path).member(DESCRIPTION)
    problem(lambda: member.read(100), rf"x\.fmu/{DESCRIPTION}: expected at most 0 MB")


def test_a_long_list_of_members_is_refused(tmp_path):
    """Before it is read: by its size in the last record of the archive."""
    path = fmu(tmp_path / "x.fmu")
    data = bytearray(path.read_bytes())
    struct.pack_into("<I", data, len(data) - 10, MAX_DIRECTORY + 1)
    path.write_bytes(data)
    message = "a list of members of at most 10 MB"
    problem(lambda: load(path), message)
    assert any(message in f.text for f in check(path, run=False).findings if f.rule == "archive.zip")


def test_the_name_in_an_extra_field_is_checked(tmp_path, monkeypatch):
    """Newer versions of Python unpack under this name (Info-ZIP 0x7075); it may only add letters."""
    names = {
        "resources/a": ("../evil", "has '..' in its path"),
        "resources/b": ("resources/c", "name 'resources/c' in an extra field"),
        "resources/├╝": ("resources/ü", ""),
    }

    def decode(member: zipfile.ZipInfo, *_: object) -> None:
        member.filename = names.get(member.filename, (member.filename,))[0]

    monkeypatch.setattr(zipfile.ZipInfo, "_decodeExtra", decode)
    for written, (other, message) in names.items():
        path = fmu(tmp_path / "x.fmu", more={written: b""})
        faults = {f.text for f in check(path, run=False).findings if f.rule == "archive.name"}
        if not message:
            with Location(path).unpacked() as folder:
                assert (folder / other).is_file()
            assert not faults
            continue
        problem(Location(path).unpacked().__enter__, message)
        assert any(message in text for text in faults)
        with zipfile.ZipFile(path) as archive, pytest.raises(zipfile.BadZipFile, match=message):
            extract_member(archive, archive.infolist()[-1], tmp_path / "folder")
    assert not (tmp_path / "evil").exists()


def test_members_can_stay_packed(gain):
    """Those of the named folders; all others are unpacked."""
    with Location(gain).unpacked(("binaries/",)) as folder:
        found = {p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file()}
    assert found == {n for n in Location(gain).names() if not n.startswith("binaries/")}


def test_many_components_of_one_fmu_share_its_library(gain, tmp_path, monkeypatch):
    """The members of their SSP are listed once in loading it, and once for checksums and run."""
    names = [f"part_{i}" for i in range(8)]
    system = write_ssp(assemble(dict.fromkeys(names, gain)), tmp_path / "many.ssp")
    fmus = [Location(system, (f"resources/{name}.fmu",)) for name in names]
    with ExitStack() as stack:
        (folder,) = {stack.enter_context(fmu.unpacked()) for fmu in fmus}
        stack.enter_context(Location(gain).unpacked(("binaries/",)))
        assert (folder / "binaries").is_dir()
    files._remove_unused(-1.0)
    assert not folder.exists()
    sizes = []
    monkeypatch.setattr(files, "overlap", lambda members: sizes.append(len(members)) or "")
    run(system, step=0.1, stop=0.1, isolate=False)
    assert sizes.count(len(Location(system).names())) == 3  # once more for this line


@pytest.mark.parametrize("folder", ["sources", "documentation"])
def test_a_run_unpacks_no_sources_and_no_documentation(gain, tmp_path, folder):
    """A member there that cannot be unpacked does not prevent a run; one in resources does."""
    for place, told in ((folder, None), ("resources", "is compressed with")):
        fmu = Path(shutil.copy(gain, tmp_path / f"{place}.fmu"))
        with zipfile.ZipFile(fmu, "a", zipfile.ZIP_BZIP2) as archive:
            archive.writestr(f"{place}/odd.txt", "x" * 1000)
        with pytest.raises(Problem, match=told) if told else nullcontext():
            run(fmu, step=0.1, stop=0.1)


def test_backslashes_in_names_are_slashes(gain, tmp_path):
    """Old packers on Windows write them; a check reports them."""
    path = tmp_path / "x.fmu"
    with zipfile.ZipFile(gain) as good:
        members = {n: good.read(n) for n in good.namelist()}
    path.write_bytes(archived({n.replace("/", "\\"): data for n, data in members.items()}))
    with Location(path).unpacked() as folder:
        assert {p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file()} == set(members)
    assert set(Location(path).names()) == set(members)
    assert all(Location(path).member(n).read() == data for n, data in members.items())
    assert "archive.name" in {f.rule for f in check(path, run=False).findings}


@pytest.mark.parametrize("name", ["全\u3000部", "a\u00a0b", "\u0645\u06cc\u200c\u062e", "a\u200db"])
def test_names_of_all_scripts_are_read(name, gain, tmp_path):
    """Only control characters of ASCII are refused: Japanese, French and Persian need other ones."""
    file = f"resources/{name}.fmu"
    change = ('name="a" source="resources/gain.fmu"', f'name="a" source="{file}"')
    assert "a" in load(system(tmp_path / "x.ssp", gain, change, more={file: gain.read_bytes()})).components
    problem(lambda: Location(tmp_path / "x.ssp").member("a\x7f"), "control character")


def test_a_rule_searches_all_files_within_one_limit(tmp_path, monkeypatch):
    """So that many large files do not take many times as long."""
    monkeypatch.setattr(archive_rules, "MAX_SEARCHED", 100)
    texts = {f"{n}.txt": f"/home/{n}/x".encode().ljust(80) for n in "abc"}
    for name, data in texts.items():
        (tmp_path / name).write_bytes(data)
    searched = list(archive_rules._searched(Subject(tmp_path, tmp_path), texts))
    assert searched == [("a.txt", texts["a.txt"]), ("b.txt", texts["b.txt"][:20])]


def test_a_large_description_of_constant_text_is_read(tmp_path):
    """The ratio counts only for large archives: regular descriptions of good FMUs pack well."""
    path = fmu(tmp_path / "x.fmu", ('license="MIT"', f'license="{" " * 9_000_000}"'))
    assert path.stat().st_size < 50_000
    assert open_component("x", Location(path)).interface.identifier == "lag"


def test_a_bomb_in_a_system_is_refused(gain, tmp_path):
    """Also if the archive of the system itself is small unpacked, and if it contains itself many times."""
    file = fmu(tmp_path / "bomb.fmu")
    bomb(file)
    bad = system(tmp_path / "x.ssp", gain, more={"resources/gain.fmu": file.read_bytes()})
    problem(lambda: load(bad), r"x\.ssp/resources/gain\.fmu: expected at most 200 times its size")
    text = INNER.replace("resources/gain.fmu", "x.ssp")
    text = text.replace('name="g"', 'name="g" type="application/x-ssp-package"')
    data = archived({"SystemStructure.ssd": text.encode()})
    for _ in range(MAX_NESTING + 2):
        data = archived({"SystemStructure.ssd": text.encode(), "x.ssp": data})
    (tmp_path / "nested.ssp").write_bytes(data)
    problem(lambda: load(tmp_path / "nested.ssp"), "expected at most 8 archives inside each other")


def test_a_symbolic_link_becomes_a_file(tmp_path):
    """A link would let later members be written anywhere."""
    path, link = fmu(tmp_path / "x.fmu"), zipfile.ZipInfo("resources")
    link.external_attr = 0o120777 << 16
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr(link, str(tmp_path))
    with Location(path).unpacked() as folder:
        assert not (folder / "resources").is_symlink()
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr("resources/evil", "")
    problem(Location(path).unpacked().__enter__, "cannot be unpacked")
    assert not (tmp_path / "evil").exists()


def test_a_full_temporary_folder_is_told(tmp_path, monkeypatch):
    """With the names of FMU and folder; the part that was unpacked is removed. It is no fault of the FMU."""
    path, temporary = fmu(tmp_path / "x.fmu"), tmp_path / "temporary"
    temporary.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(temporary))

    def full(*_: object) -> None:
        assert any(temporary.rglob("*"))
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(shutil, "copyfileobj", full)
    line = rf"x\.fmu: cannot be unpacked into {temporary}/\S+: .*No space left on device"
    problem(Location(path).unpacked().__enter__, line)
    problem(lambda: check(path, run=False), line)
    assert not list(temporary.iterdir())
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "missing"))
    problem(Location(path).unpacked().__enter__, r"x\.fmu: no temporary folder")
    problem(lambda: check(path, run=False), r"x\.fmu: no temporary folder")


def test_a_disk_that_is_full_at_the_last_block_is_told(tmp_path, monkeypatch):
    """With the name of the file that is read."""

    class Full(tempfile.SpooledTemporaryFile):  # type: ignore[type-arg]  # not generic at run time before 3.12
        def flush(self) -> None:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    path = fmu(tmp_path / "x.fmu")
    monkeypatch.setattr(tempfile, "SpooledTemporaryFile", Full)
    read = Location(path).member(DESCRIPTION).read
    problem(read, rf"x\.fmu/{DESCRIPTION}: cannot be unpacked: No space left")


CO = "<CoSimulation modelIdentifier="
DESCRIPTIONS = [
    ('name="der_x"', f'name="{"x" * 20_000}"', "expected names of at most 10000 characters"),
    ('license="MIT"', f'license="{"x" * 20_000_000}"', "cannot be read as XML: .*limit"),
    ("<LogCategories>", "<a>" * 150 + "</a>" * 150 + "<LogCategories>", "at most 100 levels"),
    ("<LogCategories>", "<a>" * 90_000, "cannot be read as XML: Excessive depth"),
    ("<LogCategories>", "<LogCategories>" + "<a/>" * MAX_ITEMS, "a limit of this tool"),
    *entry(__file__, "descriptions"),
]


@pytest.mark.parametrize("element", ["fmiModelDescription", "CoSimulation", "ScalarVariable", "Unit"])
def test_an_element_may_have_many_attributes(element, tmp_path):
    """The effort grows with their number: by its square it would be a hundred times the limit."""
    many = " ".join(f'a{i}="1"' for i in range(100_000))
    path = fmu(tmp_path / "x.fmu", (f"<{element} ", f"<{element} {many} "))
    start = time.process_time()
    load(path)
    assert time.process_time() - start < LONGEST


@pytest.mark.parametrize(("old", "new", "message"), DESCRIPTIONS, ids=[d[-1][:50] for d in DESCRIPTIONS])
def test_a_description_is_refused(old, new, message, tmp_path):
    """By one line without control characters, in bounded time; a check finds something wrong, too."""
    path = fmu(tmp_path / "x.fmu", (old, new))
    start = time.process_time()
    if message:
        line = problem(lambda: load(path), message)
        assert line.isprintable()
        assert len(line) < 3000
    report = check(path, run=False)
    assert report.failed
    assert all(line.isprintable() for line in report.text().split("\n"))
    assert time.process_time() - start < LONGEST
    assert find_library(tmp_path, "../../x/evil", 2) is None


def test_a_long_identifier_names_no_library(tmp_path):
    """Names of files have at most 255 characters."""
    path = fmu(tmp_path / "x.fmu", (f'{CO}"lag"', f'{CO}"{"x" * 260}"'))
    with Location(path).unpacked() as folder:
        for system in ("linux64", "win64", "darwin64"):
            (folder / "binaries" / system).mkdir(exist_ok=True)
        assert find_library(folder, "x" * 260, 2) is None
    assert load(path).components["x"].interface.identifier == "x" * 260


def test_other_files_of_an_fmu_are_read_up_to_their_limit(tmp_path, monkeypatch):
    """A description of the view and the origin of parameters: TOML, at most 4 MB."""
    limits, read = list[int](), Location.read
    monkeypatch.setattr(Location, "read", lambda self, limit: limits.append(limit) or read(self, limit))
    view = {f"resources/{FILE}": b"gauges = []\ncharts = []\nfull_pressure = 1e7"}
    loaded = load(fmu(tmp_path / "x.fmu", more=view))
    limits.clear()
    assert view_description(loaded).full_pressure == 1e7
    assert _provenance(loaded.components["x"]) == {}
    assert limits == [toml.MAX_BYTES] * 2


@pytest.mark.parametrize("entities", [ENTITIES.decode(), '<!ENTITY a9 SYSTEM "file:///etc/passwd">'])
@pytest.mark.parametrize("place", ['description="A', "<LogCategories>"])
def test_entities_are_not_expanded(entities, place, tmp_path):
    """Neither in attributes nor in the content, neither a billion of them nor those of other files."""
    text = XML_2.replace("<fmiModelDescription", f"<!DOCTYPE a [{entities}]><fmiModelDescription")
    path = tmp_path / "x.fmu"
    path.write_bytes(archived({**GOOD, DESCRIPTION: text.replace(place, f"{place}&a9;", 1).encode()}))
    start, before = time.process_time(), peak()
    assert "root:" not in problem(lambda: load(path), r"cannot be read as XML|got the entity &a9;")
    assert "xml.syntax" in {f.rule for f in check(path, run=False).findings if f.severity == "error"}
    assert time.process_time() - start < LONGEST
    assert peak() - before < MOST / 10


@pytest.mark.parametrize("encoding", ["utf-16", "utf-8-sig", "iso-8859-1"])
def test_other_encodings_are_read(encoding, tmp_path):
    """A description in another encoding is the same, if it says so or has a mark."""
    named = {"utf-8-sig": "UTF-8"}.get(encoding, encoding)
    text = XML_2.replace("UTF-8", named).replace("first-order lag", "lag é")
    path = Archive(2, {**GOOD, DESCRIPTION: text.encode(encoding)}).write(tmp_path / "x.fmu")
    assert open_component("x", Location(path)).interface.model.get("description") == "A lag é"


@table(__file__, "systems", "old, new, message")
def test_a_system_is_refused(old, new, message, gain, tmp_path):
    """By one line, also if the file that it refers to exists."""
    shutil.copy(gain, tmp_path / "gain.fmu")
    (tmp_path / "start.ssv").write_text(START)
    problem(lambda: load(system(tmp_path / "x.ssp", gain, (old, new))), message)


def test_a_mapping_with_another_attribute_is_told(gain, tmp_path):
    """As in a file of OMSimulator's tests: line, element, expected and got."""
    mapping = MAPPING.replace(" target=", " destination=", 1).encode()
    told = r"line \d+: MappingEntry: expected an attribute target, got source, destination$"
    problem(lambda: load(system(tmp_path / "x.ssp", gain, more={"resources/names.ssm": mapping})), told)


def test_an_unpacked_system_may_refer_to_files_beside_it(gain, tmp_path):
    """Not to devices and pipes, which never end."""
    folder = tmp_path / "system"
    folder.mkdir()
    shutil.copy(gain, tmp_path / "gain.fmu")
    for source in ("../gain.fmu", f"file://{tmp_path}/gain.fmu"):
        (folder / "x.ssd").write_text(INNER.replace("resources/gain.fmu", source))
        assert list(load(folder / "x.ssd").components) == ["g"]
    (folder / "x.ssd").write_text(INNER.replace("resources/gain.fmu", "/dev/zero"))
    problem(lambda: load(folder / "x.ssd"), "expected a file, got a device or a pipe")


@pytest.mark.parametrize(
    ("copies", "count", "most", "message"),
    [
        (1, 90, None, "50 systems inside each other"),
        (2, 7, 100, "100 components"),
        pytest.param(2, 14, None, "10000 components", marks=shards.search),
    ],
)
def test_files_that_include_files_have_an_end(copies, count, most, message, gain, tmp_path, monkeypatch):
    """A chain of 90 files; 7 or 14 files of which each includes the next one twice, with `most` parts."""
    if most:
        monkeypatch.setattr("orchestrator.ssp.system_structure.MAX_PARTS", most)
    files, only = {}, '<ssd:Component name="g" source="resources/gain.fmu"/>'
    part = '<ssd:Component name="g{}" type="application/x-ssp-definition" source="{}.ssd"/>'
    for n in range(count):
        parts = "".join(part.format(copy, n + 1) for copy in range(copies))
        files[f"{n}.ssd"] = INNER.replace(only, parts).encode()
    files[f"{count}.ssd"] = INNER.encode()
    made = system(tmp_path / "x.ssp", gain, ('source="other.ssd"', 'source="0.ssd"'), more=files)
    problem(lambda: load(made), f"expected at most {message}")


def variables(count: int) -> str:
    """Local variables as XML."""
    one = '<ScalarVariable name="body.part[{}].x" valueReference="{}" description="More"><Real unit="Pa"/>'
    return "".join(f"{one.format(n, n + 100)}</ScalarVariable>\n" for n in range(count))


def test_a_check_runs_an_fmu_without_its_local_variables():
    """Of 3000 only the first 100 are sent to child processes, and states and derivatives."""
    text = XML_2.replace("</ModelVariables>", f"{variables(3000)}</ModelVariables>")
    model = read_description(etree.fromstring(text.encode()), 2)
    reduced = model.for_run()
    # 6 variables; of the first 100 local ones two are state and derivative, which are among the 6
    assert len(reduced.variables) == 6 + 98
    assert {v.name for v in reduced.states} == {"x"}
    assert set(reduced.by_key) >= {1, 2, 3, 4, 5, 6}


@shards.search
def test_200_000_variables_are_checked(tmp_path):
    """In bounded time and memory, by rules that are linear in the number of variables: 6 s, else hours."""
    path = fmu(tmp_path / "x.fmu", ("</ModelVariables>", f"{variables(200_000)}</ModelVariables>"))
    start, before = time.process_time(), peak()
    check(path)
    assert time.process_time() - start < 20 * LONGEST
    assert peak() - before < MOST
