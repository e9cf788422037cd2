"""Marks of long tests: `make test` leaves them out, `make test-browser` runs one shard."""

from collections.abc import Collection, Iterable, Sequence
from itertools import product
from typing import Any

import pytest

SHARDS = {
    "documents": "commands, snippets and outputs of the pages as printed; the site",
    "fresh": "a clone in an empty folder: the site, and the wheel in an environment of its own",
    "tools": "OpenModelica and other programs that import FMUs",
    "platforms": "libraries for other systems, run under emulation where there is one",
    "c": "C sources by other compilers, with sanitizers, valgrind and random input",
    "browser": "pages in Chromium",
    "faults": "FMUs and files that misbehave, processes that are killed, full disks",
    "machine": "simulations and estimates that take seconds: whole work cycles, every variant",
    "targets": "each target of the Makefile, README after make demo; .ci/run has no time for it",
    "search": "products of cases, many seeds, and each property with ten times as many examples",
}
documents, fresh, tools, platforms, c, browser, faults, machine, targets, search = (
    pytest.mark.long(shard=name) for name in SHARDS
)


def few(quick: Collection[Any], cases: Iterable[Any], shard: Any) -> list[Any]:
    """Parameters of a test, values or tuples: those in `quick` for `make test`, all others in a shard."""
    all_ = list(cases)
    assert set(quick) <= set(all_), "a quick case that does not exist"
    rows = [case if isinstance(case, tuple) else (case,) for case in all_]
    return [
        pytest.param(*row, marks=[] if case in quick else shard) for case, row in zip(all_, rows, strict=True)
    ]


def thinned(one_of: int, *columns: Sequence[Any]) -> list[Any]:
    """All combinations of the columns; all but one of `one_of` in the shard `search`.

    What remains is spread evenly: if no column is shorter than `one_of`, each pair of a column's entry with
    another column's occurs about as often as any other, and each entry occurs.
    """
    cases = []
    for places in product(*(range(len(column)) for column in columns)):
        case = [column[place] for column, place in zip(columns, places, strict=True)]
        cases.append(pytest.param(*case, marks=[search] if sum(places) % one_of else []))
    return cases
