"""`make matrix`: runs everything, and writes the tables into docs/other-tools.md between their marks.

Tools are looked for among the packages of this Python and on the search path: OMSimulator, fmusim, fmuCheck,
omc, MasterSimulator, and, where a tool has a Python of its own, `pyfmi-python` and `cofmupy-python`.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks.matrix import single, systems
from benchmarks.matrix.cells import table
from benchmarks.matrix.present import TOOLS, Tool, versions
from benchmarks.matrix.running import ROOT

PAGE = ROOT / "docs" / "other-tools.md"
Table = tuple[Sequence[str], Callable[[Sequence[Tool], Path, Path], Iterable[Any]]]
TABLES: Mapping[str, Table] = {
    "versions": (("tool", "version"), lambda *_: versions()),
    "systems": (systems.HEAD, systems.systems),
    "strokes": (single.STROKES_HEAD, single.strokes),
    "alone": (single.ALONE_HEAD, single.alone),
}

TIMES = {"systems": 7, "strokes": 5, "alone": 4}  # column of the time


def main() -> None:
    """Run what is asked for."""
    asked = _asked()
    build, chosen = asked.build.resolve(), [t for t in TOOLS if not asked.tool or t.key in asked.tool]
    if not any(build.glob("*.fmu")):
        raise SystemExit(f"{asked.build}: no FMU there; `harvester build` makes them")
    here = [t for t in chosen if t.presence().version]
    for tool in chosen if asked.tool else ():
        if tool not in here:
            print(f"{tool.name}: not run: {tool.presence().problem}", file=sys.stderr)
    page = None if asked.tool else asked.page
    for key in asked.table or TABLES if page else ():
        _check(page, key)
    with tempfile.TemporaryDirectory() as name:
        for key in asked.table or TABLES:
            _made(key, here, build, Path(name), page)


def _asked() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.matrix", description=__doc__)
    parser.add_argument("--build", type=Path, default=ROOT / "build", help="folder of the FMUs")
    parser.add_argument("--page", type=Path, default=PAGE, help="the page that has the tables")
    parser.add_argument("--table", action="append", choices=list(TABLES), help="only these; default: all")
    parser.add_argument(
        "--tool", action="append", choices=[t.key for t in TOOLS], help="only these, printed only"
    )
    return parser.parse_args()


def _made(key: str, tools: Sequence[Tool], build: Path, folder: Path, page: Path | None) -> None:
    """One table: printed row by row, and written to the page if there is one."""
    head, rows = TABLES[key]
    found = []
    for row in rows(tools, build, folder):
        found.append(row)
        print(" | ".join(_cells(row)), flush=True)
    if page:
        write(page, key, table(head, on_page([_cells(row) for row in found], TIMES.get(key))))
    if page and key == "systems":
        write(_rates(page), "rates", table(systems.RATE_HEAD, systems.by_tool(found)))


def on_page(rows: Sequence[tuple[str, ...]], time: int | None) -> list[tuple[str, ...]]:
    """The rows that the page shows.

    Systems that diverge have no numbers; docs/rate-ports.md lists them by tool. Rows that differ only in the
    version of FMI, the first word of the second cell, and in the time are one row, with the time of the first.
    """
    if time is None:
        return list(rows)
    merged: dict[tuple[str, ...], tuple[str, ...]] = {}
    for row in (row for row in rows if row[time] != systems.DIVERGES):
        version, _, side = row[1].partition(" ")
        same = [cell for i, cell in enumerate(row) if i > 1 and (i != time or "" in row[2:time])]
        key = (row[0], side, *same)  # with the message of a run without numbers
        first = merged.setdefault(key, row)
        if first is not row:
            merged[key] = (first[0], f"{first[1].split(' ')[0]}, {version} {side}".rstrip(), *first[2:])
    return list(merged.values())


def _cells(row: systems.Row | tuple[str, ...]) -> tuple[str, ...]:
    return row.cells if isinstance(row, systems.Row) else row


def _check(page: Path, key: str) -> None:
    """Can a table be written? That is asked before minutes are spent on it."""
    _parts(page, key)
    if key == "systems":
        _parts(_rates(page), "rates")


def _rates(page: Path) -> Path:
    return page.with_name("rate-ports.md")


def write(page: Path, key: str, text: str) -> None:
    """Put a table between its marks."""
    before, after = _parts(page, key)
    page.write_text(f"{before}{text}\n{after}", encoding="utf-8")


def _parts(page: Path, key: str) -> tuple[str, str]:
    """A page up to the begin mark of a table, and from its end mark on."""
    begin, end = f"<!-- matrix: {key} -->\n", f"<!-- end: {key} -->"
    try:
        text = page.read_text(encoding="utf-8")
    except OSError as problem:
        raise SystemExit(f"{page}: {problem.strerror}") from None
    before, _, rest = text.partition(begin)
    _, mark, after = rest.partition(end)
    if not mark:
        raise SystemExit(f"{page}: expected the marks {begin.strip()} and {end}")
    return before + begin, mark + after


if __name__ == "__main__":
    main()
