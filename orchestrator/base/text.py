"""Text output of numbers, units and tables: ASCII for a terminal, typeset for documents and HTML pages.

A terminal shows `1.2e-13` and `m3/s`. For documents and pages, `typeset` and `pretty` convert these texts to
1.2·10⁻¹³ and m³/s.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Sequence, Sized
from dataclasses import dataclass, fields
from functools import cache
from pathlib import Path
from textwrap import shorten
from typing import Any, TypeVar

from markupsafe import Markup, escape

from orchestrator.base.units import factor_and_offset, pretty, reader_unit, superscript

Key = TypeVar("Key")
Item = TypeVar("Item")
NO_VALUE, DASH, MINUS = "-", "\N{EN DASH}", "\N{MINUS SIGN}"
ERROR_UNITS = {"m": "mm", "m/s": "mm/s"}  # unit of a quantity -> unit of its errors, which are smaller
SMALL_LENGTH = 0.1  # [m] or [m/s]; quantities whose values are all smaller are shown in mm or mm/s


def words(text: str) -> frozenset[str]:
    """The words of a text."""
    return frozenset(text.split())


MODELICA = words(  # its keywords
    """algorithm and annotation assert block break class connect connector constant constrainedby der
    discrete each else elseif elsewhen encapsulated end enumeration equation expandable extends external
    false final flow for function if import impure in initial inner input loop model not operator or
    outer output package parameter partial protected public pure record redeclare replaceable return
    stream then time true type when while within"""
)


def number(value: float | None, digits: int = 3, *, zeros: bool = False) -> str:
    """A number with a few significant digits; a dash for None and NaN. `zeros`: keep trailing zeros."""
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
    """Typeset the numbers in a text: 2.5e-13 as 2.5·10⁻¹³, +- as ±, a minus sign; a dash for no value."""
    if text == NO_VALUE:
        return DASH
    text = re.sub(r"(?<=\d)e([+-]?\d+)\b", lambda m: f"·10{superscript(str(int(m[1])))}", text)
    return re.sub(r"(?<![\w.+-])-(?=\d)", MINUS, text.replace("+-", "±"))


def percentage(value: float | None, digits: int = 3, *, zeros: bool = False) -> str:
    """A fraction in percent, such as `12 %` for 0.12."""
    text = number(None if value is None else 100 * value, digits, zeros=zeros)
    return text if text == NO_VALUE else f"{text} %"


def join_words(words: Sequence[str]) -> str:
    """Join words to a list in a sentence: `a, b and c`."""
    return " and ".join(filter(None, (", ".join(words[:-1]), *words[-1:])))


def first_names(names: Iterable[str], limit: int = 4) -> str:
    """The first names, each once, and the number of the others: `a, b, c, d and 3 more`."""
    unique = list(dict.fromkeys(names))
    more = f" and {len(unique) - limit} more" if len(unique) > limit else ""
    return f"{', '.join(unique[:limit])}{more}"


def short_names(names: Iterable[str]) -> dict[str, str]:
    """Name of each signal -> its name without component, if no other one has the same."""
    bare = {name: name.rpartition(".")[2] for name in names}
    count = Counter(bare.values())
    return {name: short if count[short] == 1 else name for name, short in bare.items()}


def grouped(items: Iterable[Item], key: Callable[[Item], Key]) -> dict[Key, list[Item]]:
    """The items by their keys, in the order in which they come first."""
    groups: dict[Key, list[Item]] = {}
    for item in items:
        groups.setdefault(key(item), []).append(item)
    return groups


def brief(record: Any) -> str:
    """A dataclass in one line of at most 500 characters, with collections by their size: for `__repr__`."""

    def shown(value: Any) -> str:
        is_collection = isinstance(value, Sized) and not isinstance(value, str)
        return f"<{len(value)} items>" if is_collection else shorten(repr(value), 60, placeholder=" ...")

    texts = (f"{entry.name}={shown(getattr(record, entry.name))}" for entry in fields(record))
    return f"{type(record).__name__}({shorten(', '.join(texts), 480, placeholder=' ...')})"


def sentences(*parts: str) -> str:
    """Join texts to sentences with capitals and full stops; empty texts are left out."""
    stripped = [part.strip().rstrip(".") for part in parts if part.strip()]
    return " ".join(f"{part[0].upper()}{part[1:]}." for part in stripped)


@dataclass(frozen=True)
class DisplayUnit:
    """The unit of a quantity and the unit in which a reader sees it; an offset between them is ignored."""

    unit: str
    display: str

    @property
    def factor(self) -> float:
        """Value in the display unit = factor * value."""
        return factor_and_offset(self.unit, self.display, "display")[0]

    @property
    def name(self) -> str:
        """The display unit, typeset; empty for a dimensionless quantity."""
        return pretty(self.display)

    def plain(self, value: float, digits: int = 3) -> str:
        """A value for a terminal, without its unit."""
        return number(self.factor * value, digits)

    def ascii(self, value: float) -> str:
        """A value for a terminal, such as `0.12 bar`."""
        return f"{self.plain(value)} {self.display}".rstrip()

    def text(self, value: float, digits: int = 3, *, with_unit: bool = True) -> str:
        """A value for a page, such as `173 bar`."""
        text = typeset(self.plain(value, digits))
        return f"{text} {self.name}".rstrip() if with_unit else text


def display_unit(unit: str, largest: float = math.inf) -> DisplayUnit:
    """Display unit of values up to `largest`, such as bar for Pa, and mm for small lengths."""
    return error_display_unit(unit) if abs(largest) < SMALL_LENGTH else DisplayUnit(unit, reader_unit(unit))


FINE = {"N": "N", "N.m": "N.m", "W": "W", "J": "J", "m": "mm", "m3": "mL", "m2/s": "mm2/s", "K": "degC"}
COARSE = {"N": "kN", "N.m": "kN.m", "W": "kW", "J": "kJ", "mm": "m", "mL": "L", "deg/s": "rpm"}
MANY = 10.0  # of the coarse unit: from there on it is used


def sized_unit(unit: str, size: float) -> str:
    """The unit in which a reader sees a value of this size in `unit`: 132 N, but 825 kN."""
    fine = FINE.get(unit) or reader_unit(unit)
    coarse = COARSE.get(fine, fine)
    return coarse if abs(size) * factor_and_offset(unit, coarse, unit)[0] >= MANY else fine


def sized(value: float, unit: str) -> str:
    """A value in `unit` with the unit of readers for its size, for a terminal: `825 kN`."""
    shown = sized_unit(unit, value)
    factor, offset = factor_and_offset(unit, shown, unit)
    return f"{number(factor * value + offset)} {shown}".removesuffix(" 1").rstrip()


def error_display_unit(unit: str) -> DisplayUnit:
    """Display unit of the errors of a quantity, such as mm for m and bar for Pa."""
    return DisplayUnit(unit, ERROR_UNITS.get(unit) or reader_unit(unit))


def name_with_unit(name: str, unit: str) -> str:
    """The name of a quantity with its unit, typeset: `flow [m³/s]`."""
    return f"{name} [{pretty(unit)}]" if pretty(unit) else name


TEXTS = 3  # left-aligned columns of a table of texts


@dataclass(frozen=True)
class TextTable:
    """A table of texts for a terminal, a document or an HTML page.

    left     indices of left-aligned columns; the others, with numbers, are right-aligned
    strong   texts of cells that are emphasised
    """

    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    left: Collection[int] = (0,)
    title: str = ""
    strong: Collection[str] = ()

    def lines(self) -> list[str]:
        """The lines of the table as plain text; a row of one cell is the heading of a group."""
        rows, columns = [self.head, *self.rows], len(self.head)
        full = zip(*(row for row in rows if len(row) == columns), strict=True)
        widths = [max(map(len, column)) for column in full]
        padded = (row if len(row) < columns else self._padded(row, widths) for row in rows)
        return ["  ".join(cells).rstrip() for cells in padded]

    def _padded(self, row: Sequence[str], widths: Sequence[int]) -> Iterable[str]:
        for i, (cell, width) in enumerate(zip(row, widths, strict=True)):
            yield cell.ljust(width) if i in self.left else cell.rjust(width)

    def markdown(self) -> str:
        """The table in Markdown."""
        bold = [[f"**{c}**" if c in self.strong else c for c in row] for row in (self.head, *self.rows)]
        lines = ["|" + "|".join(row) + "|" for row in bold]
        rule = "|" + "|".join("---" if i in self.left else "--:" for i in range(len(self.head))) + "|"
        return "\n".join([lines[0], rule, *lines[1:]])

    def html(self) -> Markup:
        """The table in HTML; cells are escaped unless they are markup. A wide table can be scrolled.

        A row of one cell is the heading of a group. A column that is empty in all rows is left out. Where the
        window is narrow, each cell of a table of texts has a line of its own, with the head of its column.
        """
        columns = range(len(self.head))
        kept = [k for k in columns if not self.rows or any(row[k] for row in self.rows if k < len(row))]
        group = Markup('<tr class="group"><th colspan="{}" scope="rowgroup">{}</th></tr>')
        rows = [Markup("<tr>{}</tr>").format(Markup("").join(self._cells("th", self.head, kept)))]
        rows += [
            group.format(len(kept), row[0])
            if len(row) == 1 < len(self.head)
            else Markup("<tr>{}</tr>").format(Markup("").join(self._cells("td", row, kept)))
            for row in self.rows
        ]
        body = Markup("\n").join(rows)
        name = self.title or self.head[0] or "numbers"
        kind, heads = "wide", ""
        if len(self.left) >= TEXTS:
            quoted = (self.head[k].replace("\\", "").replace('"', "'") for k in kept)
            kind, heads = "wide stack", ";".join(f'--h{k}:"{head}"' for k, head in enumerate(quoted, 1))
        opening = Markup('<div class="{}" style="{}" tabindex="0" role="group" aria-label="{}, table">')
        return opening.format(kind, heads, name) + Markup("<table>\n{}\n</table></div>").format(body)

    def _cells(self, tag: str, row: Sequence[str], columns: Iterable[int]) -> Iterable[Markup]:
        for k in columns:
            attribute = "" if k in self.left else ' class="n"'
            yield Markup(f"<{tag}{attribute}>") + escape(row[k]) + Markup(f"</{tag}>")


@cache
def jinja_environment(*folders: Path, escaped: bool) -> Any:
    """Jinja with the templates in some folders; escaped: values are escaped, as in XML."""
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    return Environment(
        loader=FileSystemLoader(folders),
        autoescape=escaped,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )


def rendered(template: Path, escaped: bool = False, **content: object) -> str:
    """The text of a Jinja template without its last line end; escaped: values are escaped, as in XML."""
    environment = jinja_environment(template.parent, escaped=escaped)
    return str(environment.get_template(template.name).render(**content))
