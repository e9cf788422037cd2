"""Damaged files of samples and of TOML: one line or a regular result, in bounded memory and time."""

import os
import random
from collections.abc import Callable
from datetime import date
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import scipy.io
from kit import shards
from kit.mistakes import problem
from kit.mistakes import table as table_of
from kit.needs import needs

from fmus import parameters
from fmus.identification.recordings.describe import describe
from orchestrator import Problem, Trace, read_recording, read_trace, write_trace
from orchestrator.data import matlab, table
from orchestrator.data.description import Description, Origin, SignalDescription, write_description
from orchestrator.data.table import TextFormat, read_columns
from orchestrator.studies.study import read as read_study

# seconds of a test; only a reader that does not end reaches them: usual files take milliseconds
pytestmark = pytest.mark.timeout(120)
MEMORY = 1 << 30  # bytes
SEEDS = range(400)  # for each of the eight kinds of files

TOKENS = (  # what a text file gets in the place of a piece
    *(b'"', b'""', b",", b";", b"\t", b"\n", b"\r", b"\n\n", b"\x00", b"\x1b[2J", b"\xff", b"\xe2\x80\xae"),
    *(b"nan", b"inf", b"-1e999", b"1e-400", b"0x1p3", b"1_0", b"-0", b"9" * 400, b"9" * 5000, b"1" * 200_000),
    *(b"[" * 3000, b"{a=" * 3000, b"a." * 3000 + b"b=1", b"=", b"[[x]]", b"'''", b"true", b"1979-05-27"),
    *(b".", b"x" * 200_000, b'"' * 9999, b"," * 9999, b"m^" * 999, b"(" * 999),
    *(b"../../x", b"/etc/passwd", b"#"),
)
SIZES = (0, 1, 0x7F, 0xFF, 0x7FFF, 0xFFFF, 0x7FFFFFFF, 0xFFFFFFFF, 1 << 36, 1 << 62, (1 << 64) - 1)

STUDY = Path(__file__).parents[1] / "sweep" / "gain.toml"


def damaged(draw: random.Random, data: bytes, text: bool) -> bytes:
    """The bytes with one to four damages: flipped, cut, repeated, moved, or replaced by hostile ones."""
    piece = bytearray(data)
    for _ in range(draw.choice((1, 1, 2, 4))):
        at, end = sorted(draw.randrange(len(piece) + 1) for _ in range(2))
        end = min(end, at + draw.choice((1, 4, 8, 64, 4096)))
        action = draw.randrange(5)
        if action == 0 and at < len(piece):
            piece[at] ^= 1 << draw.randrange(8)
        elif action == 1:
            del piece[at : end if draw.random() < 0.7 else None]
        elif action == 2:
            piece[at:at] = piece[at:end] * draw.choice((1, 2, 50))
        elif action == 3 or text:
            piece[at:end] = draw.choice(TOKENS)
        else:
            size = draw.choice(SIZES).to_bytes(8, "little")[: draw.choice((2, 4, 8))]
            piece[at : at + len(size)] = size
    return bytes(piece)


@pytest.fixture(scope="module")
def good(tmp_path_factory) -> dict[str, tuple[bytes, str, Callable[[Path], Any]]]:
    """Kind -> content, suffix and reader of a good file."""
    folder = tmp_path_factory.mktemp("good")
    time = np.arange(40) * 0.01
    trace = Trace(time, {"a.y": np.sin(time), "b, x": time**2}, {"a.y": "Pa"})
    for suffix in (".csv", ".parquet"):
        write_trace(trace, folder / f"trace{suffix}")
    struct = {"run": {"y": np.sin(time), "cell": np.array([1, "a"], dtype=object)}, "text": "words"}
    for packed in (False, True):
        name = folder / f"mat5{packed}.mat"
        scipy.io.savemat(name, {"time": time, "y": np.sin(time), **struct}, do_compression=packed)
    with h5py.File(folder / "mat73.mat", "w") as file:
        file["time"] = time[None]
        file.create_dataset("y", data=np.sin(time)[None], chunks=(1, 8), compression="gzip")
        file["run/y"] = np.sin(time)[None]
        file["text"] = np.frombuffer("words".encode("utf-16-le"), np.uint16)[None]
        file["text"].attrs["MATLAB_class"] = np.bytes_("char")
    signals = {"y": SignalDescription("bar", span=(0.0, 4.0), sensor="a"), "z": SignalDescription("m/s")}
    origin = Origin("title", date=date(2026, 1, 2))
    write_description(folder / "described.toml", Description(signals, origin, {"procedure": "valve"}))
    shipped = Path(parameters.__file__).parent / "supply" / "parameters.toml"
    csv = "time,y,z\n" + "".join(f"{t},{t},{t}\n" for t in time)

    def described(path: Path) -> Any:
        path.with_suffix(".csv").write_text(csv, encoding="utf-8")
        return read_recording(path)

    def mat(path: Path) -> Any:
        return read_columns(path, {"time", "y"})

    return {
        "CSV": ((folder / "trace.csv").read_bytes(), ".csv", read_trace),
        "Parquet": ((folder / "trace.parquet").read_bytes(), ".parquet", read_trace),
        "MAT 5": ((folder / "mat5False.mat").read_bytes(), ".mat", mat),
        "MAT 5, compressed": ((folder / "mat5True.mat").read_bytes(), ".mat", mat),
        "MAT 7.3": ((folder / "mat73.mat").read_bytes(), ".mat", mat),
        "description": ((folder / "described.toml").read_bytes(), ".toml", described),
        "study": (STUDY.read_bytes(), ".toml", read_study),
        "parameters": (shipped.read_bytes(), ".toml", parameters.read),
    }


KINDS = ("CSV", "Parquet", "MAT 5", "MAT 5, compressed", "MAT 7.3", "description", "study", "parameters")


def peak() -> int:
    """The largest resident memory of this process [bytes] since `reset_peak`; 0 where it is not known."""
    status = Path("/proc/self/status")
    lines = status.read_text().splitlines() if status.exists() else []
    return next((int(line.split()[1]) << 10 for line in lines if line.startswith("VmHWM")), 0)


def reset_peak() -> None:
    if os.access("/proc/self/clear_refs", os.W_OK):
        Path("/proc/self/clear_refs").write_text("5")


def check(read: Callable[[Path], Any], path: Path) -> Problem | None:
    """Read a file: a regular result or one line that names it, in bounded memory."""
    reset_peak()
    before, problem = peak(), None
    try:
        read(path)
    except Problem as refusal:
        problem = refusal
    assert peak() - before < MEMORY
    if problem is not None:
        assert path.stem in str(problem)
        assert str(problem).isprintable()
        assert len(str(problem)) < 3000
    return problem


@pytest.mark.parametrize("seeds", [SEEDS[:20], pytest.param(SEEDS[20:], marks=shards.search)], ids=len)
@pytest.mark.parametrize("kind", KINDS)
def test_damaged_files_are_one_line_or_a_result(good, kind, seeds, tmp_path):
    """Whatever is damaged: no other exception than a Problem."""
    data, suffix, read = good[kind]
    path, refused = tmp_path / f"damaged{suffix}", 0
    path.write_bytes(data)
    assert check(read, path) is None  # the good file is read
    for seed in seeds:
        path.write_bytes(damaged(random.Random(f"{kind} {seed}"), data, text=suffix in (".csv", ".toml")))
        try:
            refused += check(read, path) is not None
        except Exception as error:
            raise AssertionError(f"{kind}, seed {seed}: {error!r}") from error
    assert refused > len(seeds) / 4  # the damage is noticed often enough to test the refusals


# ---- damage of one kind


def refused(path: Path, message: str, read: Callable[[Path], Any] | None = None) -> None:
    problem = check(read or (lambda p: read_columns(p, {"time", "x"})), path)
    assert problem is not None
    assert message in str(problem)


def mat73(path: Path, change: Callable[[h5py.File], object]) -> Path:
    """A MAT 7.3 file with `time` and `x`, which a change may make otherwise."""
    with h5py.File(path, "w") as file:
        file["time"] = np.arange(10.0)[None]
        change(file)
        if file.get("x", getlink=True) is None:
            file["x"] = np.arange(10.0)[None]
    return path


def dataset(*shape: int, **options: Any) -> Callable[[h5py.File], object]:
    return lambda file: file.create_dataset("x", shape=shape, dtype="f8", **options)


def link(target: h5py.ExternalLink | h5py.SoftLink) -> Callable[[h5py.File], object]:
    return lambda file: file.__setitem__("x", target)


def virtual(file: h5py.File) -> None:
    layout = h5py.VirtualLayout(shape=(1, 10), dtype="f8")
    layout[:] = h5py.VirtualSource("other.mat", "x", shape=(1, 10))
    file.create_virtual_dataset("x", layout)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (link(h5py.ExternalLink("other.mat", "/x")), "'x': expected numbers, got a link to other.mat"),
        (link(h5py.SoftLink("/time")), "'x': expected numbers, got a link to /time"),
        (dataset(1, 10, external=[("other.bin", 0, 80)]), "'x': expected numbers, got values in another"),
        (virtual, "'x': expected numbers, got values in another file"),
        (dataset(1, 10**10, chunks=(1, 1000)), "GiB of samples, got variables up to 'x' of 74.5 GiB"),
        (dataset(1, 10**8, chunks=(1, 1000)), "at most 0.488 GiB of samples, got variables up to 'x'"),
        (lambda f: f.__setitem__("a/b", f.create_group("a")), "/a/b: expected a struct, got one that"),
        (lambda f: f.create_group("a/" * 2000), "maximum recursion depth"),
    ],
)
def test_a_mat_file_is_read_only_itself(tmp_path, change, message):
    """Values in other files, values that are only declared and endless structs are refused before reading."""
    (tmp_path / "other.bin").write_bytes(np.arange(10.0).tobytes())
    mat73(tmp_path / "other.mat", lambda file: None)  # noqa: ARG005  unchanged
    refused(mat73(tmp_path / "a.mat", change), message)


def test_other_content_of_a_mat_file_does_no_harm(tmp_path):
    """Empty and compound variables, types, numbers marked as text, cells with structs: not columns."""

    def change(file: h5py.File) -> None:
        file["empty"], file["type"] = h5py.Empty("f8"), np.dtype("f8")
        file["pairs"], file["char"] = np.zeros(3, dtype=[("a", "f8")]), np.array([[1.5]])
        file["char"].attrs["MATLAB_class"] = np.bytes_("char")

    assert check(lambda p: read_columns(p, {"time", "x"}), mat73(tmp_path / "a.mat", change)) is None
    cell = np.array([{"a": 1}, np.arange(3), np.arange(2)], dtype=object)
    scipy.io.savemat(tmp_path / "b.mat", {"time": np.arange(3.0), "x": np.arange(3.0), "cell": cell})
    assert read_columns(tmp_path / "b.mat", {"time", "x"}).values["x"].tolist() == [0, 1, 2]


def test_a_file_beyond_any_memory_is_refused_by_its_size(tmp_path):
    """A file of 74 GiB, nearly all of it a hole, is not opened."""
    path = tmp_path / "a.csv"
    path.touch()
    os.truncate(path, 74 << 30)
    refused(path, "a.csv: expected at most 8590 MB, got 79457 MB")


def packed_mat(path: Path, **variables: Any) -> Path:
    scipy.io.savemat(path, {"time": np.arange(10.0), **variables}, do_compression=True)
    return path


def packed_mat73(path: Path, **variables: Any) -> Path:
    options = {"compression": "gzip", "chunks": (1, 100_000)}
    return mat73(path, lambda f: [f.create_dataset(n, data=v, **options) for n, v in variables.items()])


ZEROS = np.zeros((1, 1_000_000), np.int8)
PACKED = {
    "one variable": lambda path: packed_mat(path, y=np.tile(ZEROS, 4)),
    "four variables": lambda path: packed_mat(path, **dict.fromkeys("abcd", ZEROS)),
    "numbers of a byte": lambda path: packed_mat(path, y=ZEROS[:, :300_000]),
    "version 7.3": lambda path: packed_mat73(path, **dict.fromkeys("ab", ZEROS[:, :200_000])),
}


@pytest.mark.parametrize("name", PACKED)
def test_a_small_mat_file_takes_no_memory(name, tmp_path, monkeypatch):
    """Constant bytes are packed to a thousandth; unpacked, each becomes a number of eight bytes."""
    monkeypatch.setattr(matlab, "ANY_RATIO", 2_000_000)
    path = PACKED[name](tmp_path / "a.mat")
    assert path.stat().st_size < 10_000
    refused(path, "a.mat: expected at most 0.00186 GiB of samples, got ")
    monkeypatch.setattr(matlab, "ANY_RATIO", 500 << 20)
    assert {*read_columns(path, {"time"}).values} == {"time"}


@pytest.mark.parametrize(
    "text", ["time," + "a," * 5000, "time,x\n0,1\n" + "1," * 5000 + "\n2,3\n", "9" * 9000]
)
def test_a_line_that_does_not_end_is_refused(text, tmp_path, monkeypatch):
    """Before it is split into cells, each of which takes memory; many lines of usual length are read."""
    monkeypatch.setattr(table, "MAX_LINE", 4000)
    (tmp_path / "a.csv").write_text(text, encoding="utf-8")
    refused(tmp_path / "a.csv", "a.csv: expected lines of at most 0 MB, got one of 0 MB")
    (tmp_path / "a.csv").write_text("time,x\n" + "".join(f"{k},1\n" for k in range(9000)), encoding="utf-8")
    assert len(read_trace(tmp_path / "a.csv").time) == 9000


@needs("POSIX", "Windows has no such files")
def test_a_pipe_is_no_file(tmp_path):
    """Nor is a device, as samples or as their description: it may have no end, or never begin."""
    os.mkfifo(tmp_path / "a.toml")
    for path in (tmp_path / "a.toml", Path("/dev/zero")):
        problem(lambda path=path: read_recording(path), "no such file|a device or a pipe")
        problem(lambda path=path: describe(path), "no such file|a device or a pipe")
    for suffix in (".csv", ".mat", ".parquet", ".mf4"):
        os.mkfifo(path := tmp_path / f"b{suffix}")
        problem(lambda path=path: read_trace(path), "expected a file, got a device or a pipe")


CELLS = [  # the csv module refuses more than 131 072 characters by an exception of its own
    ("time,x\n0," + "1" * 200_000 + "\n1,2\n", "line 2: column 'x': expected a finite number, got inf"),
    ('time,x\n0,"' + "y" * 200_000 + '"\n1,2\n', "line 2: field larger than field limit (131072)"),
    ('time,"' + "y" * 200_000 + "\n0,1\n1,2\n", "expected a column 'x', got time, \"yyyyyyyyyy"),
    ("time," + '"' * 5_000_000 + "\n0,1\n1,2\n", "expected a column 'x', got time, "),
]
TOML = [
    ("x = " + "[" * 100_000, "nested too deeply"),
    ("signals." + ".".join("a" * 20_000) + " = 1", "nested too deeply"),
    ("\n".join(f"a{i}.{'.'.join('b' * 999)} = 1" for i in range(999)), "nested too deeply"),
    ("x = " + "9" * 5000, "expected TOML, got Exceeds the limit"),
    ("[a]\nmass = 1\nmass = 2\n", "Cannot overwrite a value (at line 3, column 9): key mass"),
    ('"a b" = 1\nb = ["c=d"]\n"a b" = [\n"e=f",\n]\n', '(at line 5, column 2): key "a b"'),
    ("a.b = 1\n# a.c = 1\na.b = 2", "(at end of document): key a.b"),
    ("[signals.x]\nunit = 'm'\nfactor = " + "9" * 400, "signals.x: factor: expected a number, got 9999"),
    ("[signals.x]\nunit = " + "[" * 200 + "]" * 200, "signals.x: unit: expected a text, got [[[[["),
    ("[signals.x]\nunit = 'm'\n[file]\ncsv = 'a/b.csv'", "file: csv: expected the name of a file in"),
    ("#" * (5 << 20), "expected at most 4 MB, got 5 MB"),
]


@pytest.mark.parametrize(
    ("name", "text", "message"), [*(("a.csv", *row) for row in CELLS), *(("a.toml", *row) for row in TOML)]
)
def test_hostile_text_is_refused(tmp_path, name, text, message):
    """Long cells, shortened in the message; nesting, thousands of digits, other folders, sheer size."""
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    refused(path, message, read_recording if name == "a.toml" else None)


@pytest.mark.timeout(40)  # of which it takes 2; with the square of 100 000 columns a reader takes a minute
def test_many_columns_and_a_long_description_are_read(tmp_path):
    """100 000 columns, an effort that grows with their number; 10 000 described signals."""
    path, count = tmp_path / "a.csv", 100_000
    names = ",".join(f"c{i}" for i in range(count))
    path.write_text(f"time,{names}\n" + "".join(f"{k}{',1.5' * count}\n" for k in range(2)), encoding="utf-8")
    assert check(read_trace, path) is None
    refused(path, "expected a column 'x', got time, c0, c1")
    tables = "\n".join(f"[signals.s{i}]\nunit = 'm'" for i in range(10_000))
    path = tmp_path / "a.toml"
    path.write_text(tables, encoding="utf-8")
    path.with_suffix(".csv").write_text("time\n0\n1\n", encoding="utf-8")
    refused(path.with_suffix(".csv"), "expected a column 's0', got time", read_recording)


def test_links_inside_a_mat_file_are_no_obstacle(tmp_path):
    """A second hard link is a second name; soft and external links count only if they are asked for."""

    def change(file: h5py.File) -> None:
        group = file.create_group("run")
        group["y"] = np.arange(10.0)[None]
        file["again"], file["soft"] = group, h5py.SoftLink("/run")
        file["outside"] = h5py.ExternalLink("other.mat", "/x")

    names = {"time", "run.y", "again.y"}
    columns = read_columns(mat73(tmp_path / "a.mat", change), names).values
    assert set(columns) == names
    assert columns["again.y"].tolist() == list(range(10))
    soft, told = {"time", "soft.y"}, r"column 'soft\.y': expected numbers, got a link to /run"
    problem(lambda: read_columns(tmp_path / "a.mat", soft), told)


@table_of(__file__, "quotes", "text, expected")
def test_quotes_follow_rfc_4180_and_never_join_rows(tmp_path, text, expected):
    """A quoted cell may have delimiters, doubled quotes and line breaks, but not whole rows."""
    path, form = tmp_path / "a.csv", TextFormat(delimiter=";" if ";" in text else None)
    path.write_bytes(text.encode())
    if isinstance(expected, str):
        problem(lambda: read_columns(path, {"y"}, form), rf"a\.csv: {expected}$")
    else:
        np.testing.assert_array_equal(read_columns(path, {"y"}, form).values["y"], expected)


def test_a_quote_is_no_delimiter(tmp_path):
    """It has a meaning of its own."""
    (tmp_path / "a.csv").write_text("time,a\n0,1\n1,2\n", encoding="utf-8")
    for key in ("delimiter", "decimal"):
        (tmp_path / "a.toml").write_text(f"[file]\n{key} = '\"'\n", encoding="utf-8")
        problem(lambda: read_trace(tmp_path / "a.csv"), rf"a\.toml: file: {key}: expected .*, got '\"'")
