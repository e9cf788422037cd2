"""Tables of numbers as CSV files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray


def write_csv(path: Path, names: Sequence[str], rows: NDArray[np.float64], digits: int) -> None:
    """Columns (n, m) with a header; `digits` significant digits."""
    path.parent.mkdir(parents=True, exist_ok=True)
    body = (",".join(f"{value + 0.0:.{digits}g}" for value in row) for row in rows)
    path.write_text("\n".join([",".join(names), *body, ""]), encoding="utf-8", newline="\n")
