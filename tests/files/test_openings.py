"""What a user names is opened in one place, `base.files.Location`, which refuses devices, pipes and sizes.

A new bare `open`, `read_bytes` or reader of a library fails here, unless its place is in the table of the
places that open something else, each with the reason.
"""

import ast
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest
from check.good import XML_2
from kit.mistakes import problem
from lxml import etree

from orchestrator.fmi.description import read_description
from orchestrator.fmi.instance import FmuInstance
from orchestrator.fmi.interface import _indicator_count
from orchestrator.fmi.messages import Log

ROOT = Path(__file__).parents[2]
READERS = {
    *("open", "read_bytes", "read_text", "ZipFile", "File", "ParquetFile", "read_schema", "read_table"),
    *("fromfile", "genfromtxt", "memmap", "loadmat", "whosmat", "read_csv", "read_parquet"),
}
CALL = re.compile(rf"\b({'|'.join(READERS)}|np\.load)\(")  # most files have none, and need no parser
PLACES = tomllib.loads(Path(__file__).with_suffix(".toml").read_text("utf-8"))


def openings(tree: ast.AST, inside: str = "module") -> Iterator[str]:
    """The functions that call one of the readers, once for each call."""
    for node in ast.iter_child_nodes(tree):
        named = isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef)
        if isinstance(node, ast.Call):
            name = getattr(node.func, "attr", getattr(node.func, "id", ""))
            owner = ast.unparse(node.func).rpartition(".")[0]
            read = name in READERS and owner not in ("os", "self")
            if (read or (owner, name) == ("np", "load")) and not _of_memory(node):
                yield inside
        yield from openings(node, node.name if named else inside)


def _of_memory(call: ast.Call) -> bool:
    """Does a reader get bytes that are in memory?"""
    return bool(call.args) and ast.unparse(call.args[0]).startswith("BytesIO(")


def test_what_a_user_names_is_opened_in_one_place():
    """The places that open a file otherwise are those of the table, and no reason is without a place."""
    found = {
        f"{path.relative_to(ROOT).as_posix()} {function}"
        for package in ("orchestrator", "fmus")
        for path in sorted((ROOT / package).rglob("*.py"))
        if CALL.search(text := path.read_text("utf-8"))
        for function in openings(ast.parse(text))
    }
    allowed = {place for places in PLACES.values() for place in places}
    assert found - allowed == set(), "read a user's file by orchestrator.base.files.Location"
    assert allowed - found == set(), "remove these places from the table"


def test_an_opening_is_seen():
    """Of a path, by a library, in a method; not of bytes in memory or of a descriptor."""
    first, then = "p.read_bytes(); open(p); h5py.File(p)", "np.load(BytesIO(p)); os.open(p)"
    text = f"class A:\n def f(s, p):\n  {first}\n  {then}"
    assert [*openings(ast.parse(text))] == ["f", "f", "f"]


@pytest.mark.parametrize("size", [(1 << 31) + 1, 1 << 40, (1 << 64) - 1])
def test_an_absurd_size_of_an_fmu_is_told_before_memory_is_taken(size):
    """A state that the FMU says has this many bytes; more indicators than anybody has."""

    class Lying:
        log = Log("a")
        check_size = FmuInstance.check_size

        def call(self, _, *arguments):
            arguments[-1]._obj.value = size

    told = problem(lambda: FmuInstance.serialize(Lying(), None))
    assert told == "a: a serialised state has more than 2147 MB"
    text = XML_2.replace('EventIndicators="0"', f'EventIndicators="{size}"')
    description = read_description(etree.fromstring(text.encode()), 2)
    assert problem(lambda: _indicator_count(description)).startswith(
        "expected 0 to 1000000 event indicators, got "
    )
