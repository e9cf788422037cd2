"""Files of the project that are no code.

Tables of numbers as CSV files.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray


def shipped(name: str) -> Path | None:
    """A file by its path in a checkout, such as data/x.csv; an installed package has a copy inside."""
    package = Path(__file__).parents[1]
    return next((folder / name for folder in (package.parent, package) if (folder / name).is_file()), None)


def write_csv(path: Path, names: Sequence[str], rows: NDArray[np.float64], digits: int) -> None:
    """Columns (n, m) with a header; `digits` significant digits."""
    path.parent.mkdir(parents=True, exist_ok=True)
    body = (",".join(f"{value + 0.0:.{digits}g}" for value in row) for row in rows)
    path.write_text("\n".join([",".join(names), *body, ""]), encoding="utf-8", newline="\n")
