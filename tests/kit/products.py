"""Products of cases: some combinations in `make test`, all of them in a search."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import Any

import pytest

from kit import shards


def thinned(one_of: int, *columns: Sequence[Any]) -> list[Any]:
    """All combinations of the columns; all but one of `one_of` in the shard `search`.

    What remains is spread evenly: if no column is shorter than `one_of`, each pair of a column's entry with
    another column's occurs about as often as any other, and each entry occurs.
    """
    cases = []
    for places in product(*(range(len(column)) for column in columns)):
        case = [column[place] for column, place in zip(columns, places, strict=True)]
        cases.append(pytest.param(*case, marks=[shards.search] if sum(places) % one_of else []))
    return cases
