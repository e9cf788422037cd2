"""Numbers, units and tables as a reader sees them: in a terminal, in a document, on a page.

A terminal gets ASCII: `1.2e-13`, `m3/s`. Print and pages get what `typeset` and `pretty` make of that:
1.2·10⁻¹³, m³/s.
"""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from markupsafe import Markup, escape

from orchestrator.base.units import factor_and_offset, pretty, reader_unit, superscript

if TYPE_CHECKING:
    from rich.console import Console

NO_VALUE, DASH, MINUS = "-", "\N{EN DASH}", "\N{MINUS SIGN}"
# Errors are smaller than what they are errors of.
ERROR_UNITS = {"m": "mm", "m/s": "mm/s"}
SMALL_LENGTH = 0.1  # [m, m/s]: where all numbers of a quantity are below, they are shown in mm or mm/s


def number(value: float | None, digits: int = 3, *, zeros: bool = False) -> str:
    """A number with a few significant digits, `zeros` at its end among them; a dash where there is none."""
    if value is None or not math.isfinite(value):
        return NO_VALUE
    if value == 0:
        return "0"
    text = f"{value:{'#' if zeros else ''}.{digits}g}".rstrip(".")
    power = int(text.partition("e")[2] or 0)
    if 0 < power < 6:  # digits instead of a power of ten
        return f"{float(text) if zeros else value:.0f}"
    return text


def typeset(text: str) -> str:
    """Numbers in a text as print has them: 2.5e-13 as 2.5·10⁻¹³, +- as ±, a minus sign; a dash for none."""
    if text == NO_VALUE:
        return DASH
    text = re.sub(r"(?<=\d)e([+-]?\d+)\b", lambda m: f"·10{superscript(str(int(m[1])))}", text)
    return re.sub(r"(?<![\w.+-])-(?=\d)", MINUS, text.replace("+-", "±"))


def percentage(value: float | None, digits: int = 3, *, zeros: bool = False) -> str:
    """A pure number as percent."""
    found = number(None if value is None else 100 * value, digits, zeros=zeros)
    return found if found == NO_VALUE else f"{found} %"


def join_words(words: Sequence[str]) -> str:
    """Words as a list in a sentence: `a, b and c`."""
    return " and ".join(filter(None, (", ".join(words[:-1]), *words[-1:])))


def sentences(*parts: str) -> str:
    """Parts as sentences, empty ones left out."""
    found = [part.strip().rstrip(".") for part in parts if part.strip()]
    return " ".join(f"{part[0].upper()}{part[1:]}." for part in found)


@dataclass(frozen=True)
class DisplayUnit:
    """The unit of a quantity, and the one that a reader sees; an offset between them does not count."""

    unit: str
    display: str

    @property
    def factor(self) -> float:
        """Value in the display unit = factor * value."""
        return factor_and_offset(self.unit, self.display, "display")[0]

    @property
    def name(self) -> str:
        """The display unit as print has it, nothing for pure numbers."""
        return pretty(self.display)

    def plain(self, value: float, digits: int = 3) -> str:
        """A value for a terminal, without its unit."""
        return number(self.factor * value, digits)

    def ascii(self, value: float, digits: int = 3) -> str:
        """A value for a terminal, such as `0.12 bar`."""
        return f"{self.plain(value, digits)} {self.display}".rstrip()

    def text(self, value: float, digits: int = 3, *, with_unit: bool = True) -> str:
        """A value for a page, such as `173 bar`."""
        text = typeset(self.plain(value, digits))
        return f"{text} {self.name}".rstrip() if with_unit else text


def display_unit(unit: str, largest: float = math.inf) -> DisplayUnit:
    """The unit to show numbers in, of which `largest` is the largest: bar for Pa, mm for small lengths."""
    return error_display_unit(unit) if abs(largest) < SMALL_LENGTH else DisplayUnit(unit, reader_unit(unit))


def error_display_unit(unit: str) -> DisplayUnit:
    """The unit to show errors of a quantity in: mm for m, bar for Pa."""
    return DisplayUnit(unit, ERROR_UNITS.get(unit) or reader_unit(unit))


def name_with_unit(name: str, unit: str) -> str:
    """A quantity with its unit, as print has it: `flow [m³/s]`."""
    return f"{name} [{pretty(unit)}]" if pretty(unit) else name


@dataclass(frozen=True)
class TextTable:
    """A table of texts for a terminal, a document or a page.

    left     columns whose cells begin below each other; in the others, of numbers, they end below each other
    strong   cells that stand out
    """

    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    left: Collection[int] = (0,)
    title: str = ""
    strong: Collection[str] = ()

    def lines(self) -> list[str]:
        """As plain text, a string for each line."""
        every = [self.head, *self.rows]
        widths = [max(map(len, column)) for column in zip(*every, strict=True)]
        return ["  ".join(self._padded(row, widths)).rstrip() for row in every]

    def _padded(self, row: Sequence[str], widths: Sequence[int]) -> Iterable[str]:
        for i, (cell, width) in enumerate(zip(row, widths, strict=True)):
            yield cell.ljust(width) if i in self.left else cell.rjust(width)

    def print(self, console: Console) -> None:
        """Print with the title above; a narrow terminal breaks lines, but no cell is cut."""
        from rich.box import SIMPLE_HEAD
        from rich.measure import Measurement
        from rich.table import Table as RichTable
        from rich.text import Text

        table = RichTable(box=SIMPLE_HEAD)
        for i, heading in enumerate(self.head):
            table.add_column(Text(heading), justify="left" if i in self.left else "right", no_wrap=True)
        for row in self.rows:
            table.add_row(*(Text(cell, "red" if cell in self.strong else "") for cell in row))
        widest = Measurement.get(console, console.options.update(max_width=400), table).maximum
        console.width = max(console.width, widest)
        console.print(Text(self.title, "bold"), table, sep="\n")

    def markdown(self) -> str:
        """For a document."""
        bold = [[f"**{c}**" if c in self.strong else c for c in row] for row in (self.head, *self.rows)]
        lines = ["| " + " | ".join(row) + " |" for row in bold]
        rule = "|" + "|".join("---" if i in self.left else "--:" for i in range(len(self.head))) + "|"
        return "\n".join([lines[0], rule, *lines[1:]])

    def html(self) -> Markup:
        """For a page; cells are escaped unless they are markup, a wide table scrolls."""
        lines = [Markup("").join(self._cells("th", self.head))]
        lines += [Markup("").join(self._cells("td", row)) for row in self.rows]
        body = Markup("\n").join(Markup("<tr>{}</tr>").format(line) for line in lines)
        return Markup('<div class="wide"><table>\n{}\n</table></div>').format(body)

    def _cells(self, tag: str, row: Sequence[str]) -> Iterable[Markup]:
        for i, cell in enumerate(row):
            kind = "" if i in self.left else ' class="n"'
            yield Markup(f"<{tag}{kind}>") + escape(cell) + Markup(f"</{tag}>")
