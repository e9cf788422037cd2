"""How numbers and messages look in the tables."""

from __future__ import annotations

import re
from collections.abc import Sequence

LONGEST = 110  # characters of a message
NOISE = r"^[\w.]*(?:Error|Exception|Problem): |\[FMU\]\[\w+\]\[FMU status:\w+\] "
PATH = r"(?<![\w/.:])(/[\w.+-]+)+/"  # of this machine, up to the name of the file


def percent(share: float) -> str:
    """Two digits, and no power of ten for what is 100 % and more."""
    value = 100 * share
    return f"{value:.2g}" if value < 99.5 else f"{value:.0f}"


def two(value: float) -> str:
    """Two digits, without a power of ten."""
    return f"{float(f'{value:.2g}'):.10g}"


def remark(problem: str) -> str:
    """A message in one cell: one line, no paths of this machine."""
    text = re.sub(f"{NOISE}|{PATH}", "", " ".join(problem.split())).replace("|", "/")
    return text if len(text) <= LONGEST else f"{text[: LONGEST - 3]}..."


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Markdown."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"|{'|'.join(line)}|" for line in lines)
