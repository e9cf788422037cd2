"""A report of a command: text for a terminal, a page and JSON of the same parts.

    report = Report("Latency", "pass: 2 of 3 ms used", [Table(table), Figure(figure, "Latency")], data)
    print(report.text())
    report.write(Path("latency.html"))  # and latency.json

The JSON of every command has `title`, `verdict` and `passed` (null: not judged), then what the command found.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeAlias

from markupsafe import Markup, escape

from orchestrator.base.files import write_whole
from orchestrator.base.text import DASH, TextTable, number, typeset
from orchestrator.pages import html_page
from orchestrator.pages.figures import TEMPLATES, TraceFigure, plot

TEMPLATE = TEMPLATES / "report.html.j2"
PAGE, TERMINAL = "page", "terminal"


@dataclass(frozen=True)
class Text:
    """Paragraphs. kind: a class of the page, such as soft or warn; only: PAGE or TERMINAL."""

    lines: Sequence[str]
    kind: str = ""
    only: str = ""

    def __bool__(self) -> bool:
        return bool(self.lines)

    def text(self) -> str:
        """For a terminal."""
        return "\n".join(self.lines)

    def html(self) -> Markup:
        """For a page: each line a sentence; of the kind pre as in a terminal."""
        if self.kind == "pre":
            return Markup("<pre>{}</pre>").format(self.text())
        tag = Markup(f'<p class="{self.kind}">') if self.kind else Markup("<p>")
        return Markup("\n").join(tag + html_page.sentence(line) + Markup("</p>") for line in self.lines)


@dataclass(frozen=True)
class Table:
    """A table with lines below it."""

    table: TextTable
    below: Sequence[str] = ()
    only: str = ""

    def __bool__(self) -> bool:
        return bool(self.table.rows or self.below)

    def text(self) -> str:
        """For a terminal."""
        title = [self.table.title] if self.table.title else []
        rows = self.table.lines() if self.table.rows else []
        return "\n".join([*title, *rows, *self.below])

    def html(self) -> Markup:
        """For a page, with numbers and units as on paper."""
        title = Markup("<h3>{}</h3>").format(self.table.title) if self.table.title else Markup()
        rows = html_page.typeset_table(self.table).html() if self.table.rows else Markup()
        return title + rows + Text(self.below, "soft").html()


@dataclass(frozen=True)
class Figure:
    """Signals over time, or a figure as markup; on pages only. heading: above it, of those in the head."""

    figure: TraceFigure | Markup
    name: str
    caption: str = ""
    heading: str = ""
    only: str = PAGE

    def html(self) -> Markup:
        """The figure with its caption."""
        drawn = self.figure if isinstance(self.figure, Markup) else plot(self.figure, self.name)
        caption = Markup("<figcaption>{}</figcaption>").format(self.caption) if self.caption else Markup()
        heading = (
            Markup("<h2>{}</h2>").format(html_page.breakable(self.heading)) if self.heading else Markup()
        )
        return heading + Markup("<figure>{}{}</figure>").format(drawn, caption)


@dataclass(frozen=True)
class Columns:
    """Figures and tables beside each other where the page is wide enough; on pages only."""

    figures: Sequence[Figure | Table]
    only: str = PAGE

    def __bool__(self) -> bool:
        return any(self.figures)

    def html(self) -> Markup:
        """All of them."""
        inside = Markup().join(Markup("<div>{}</div>").format(part.html()) for part in self.figures if part)
        return Markup('<div class="figures">{}</div>').format(inside)


@dataclass(frozen=True)
class Machine:
    """The machine that replays a run and can be driven; on pages only."""

    markup: Markup
    only: str = PAGE

    def __bool__(self) -> bool:
        return bool(self.markup)

    def html(self) -> Markup:
        """As it is."""
        return Markup('<div id="motion">{}</div>').format(self.markup)


@dataclass(frozen=True)
class Facts:
    """Names with values, which may be mappings of names to values; on pages only."""

    values: Mapping[str, Any]
    only: str = PAGE

    def __bool__(self) -> bool:
        return bool(self.values)

    def html(self) -> Markup:
        """A table of two columns."""
        row = Markup("<tr><th>{}</th><td>{}</td></tr>")
        rows = (row.format(name.replace("_", " "), _fact(value)) for name, value in self.values.items())
        return Markup('<table class="facts">{}</table>').format(Markup("\n").join(rows))


def _fact(value: Any) -> Markup:
    if isinstance(value, Mapping):
        return Markup("<br>").join(Markup("{}: {}").format(name, _fact(v)) for name, v in value.items())
    if isinstance(value, bool) or value is None:
        return escape({True: "yes", False: "no", None: DASH}[value])
    return escape(typeset(number(value, 6)) if isinstance(value, float) else value)


@dataclass(frozen=True)
class Section:
    """Parts under a heading; folded: the page shows the heading until a reader opens it."""

    title: str
    parts: Sequence[Part]
    folded: bool = False
    only: str = PAGE

    def __bool__(self) -> bool:
        return any(self.parts)

    @property
    def id(self) -> str:
        """Its address in the page."""
        return "".join(c if c.isalnum() else "-" for c in self.title.partition(" (")[0].lower())

    def text(self) -> str:
        """For a terminal, without the heading."""
        return _joined(self.parts)

    def html(self) -> Markup:
        """The parts; those that are sections have a heading of the next level, or are folded."""
        folded = Markup("<details><summary>{}</summary>{}</details>")
        inner = {True: folded, False: Markup("<h3>{}</h3>{}")}
        return Markup("\n").join(
            inner[part.folded].format(part.title, part.html()) if isinstance(part, Section) else part.html()
            for part in self.parts
            if part and part.only != TERMINAL
        )


Part: TypeAlias = Text | Table | Figure | Columns | Machine | Facts | Section


def _joined(parts: Sequence[Part]) -> str:
    texts = (part for part in parts if isinstance(part, Text | Table | Section) and part.only != PAGE)
    shown = (part.text() for part in texts)
    return "\n\n".join(text for text in shown if text)


@dataclass(frozen=True)
class Report:
    """What a command found.

    verdict   the answer in a sentence, the last line in a terminal and the first one of a page
    parts     what else it tells, those that are empty are left out; a page has a section for each `Section`,
              and the others in its head, figures and machine beside each other
    data      for programs, besides title, verdict and passed
    passed    whether all is within its limits; None: there are none
    lead      short paragraphs of a page below the verdict
    states    words of `passed` on a page
    """

    title: str
    verdict: str
    parts: Sequence[Part]
    data: Mapping[str, Any] = field(default_factory=dict)
    passed: bool | None = None
    lead: Sequence[str] = ()
    states: tuple[str, str] = ("pass", "fail")

    def text(self, verdict: bool = True) -> str:
        """For a terminal; the verdict is the last line, unless the parts contain it."""
        return "\n\n".join(filter(None, (_joined(self.parts), self.verdict if verdict else "")))

    def html(self) -> str:
        """The page, one file without requests."""
        shown = [part for part in self.parts if part and part.only != TERMINAL]
        sections = [part for part in shown if isinstance(part, Section)]
        first = [part for part in shown if isinstance(part, Figure | Columns | Machine)]
        above = [part for part in shown if not isinstance(part, Section) and part not in first]
        good, bad = self.states
        state = {True: ("pass", f"✓ {good}"), False: ("fail", f"✗ {bad}"), None: ("", "")}[self.passed]
        content = {"report": self, "above": above, "first": first, "sections": sections, "state": state}
        return html_page.render(TEMPLATE, title=self.title, **content)

    def values(self) -> dict[str, Any]:
        """The report for programs."""
        return {"title": self.title, "verdict": self.verdict, "passed": self.passed, **self.data}

    def json(self) -> str:
        """The same as JSON."""
        values = html_page.json_values(self.values())
        return json.dumps(values, indent=1, allow_nan=False, ensure_ascii=False)

    def write(self, page: Path, numbers: Path | None = None) -> tuple[Path, Path]:
        """Write the page, and the JSON, by default of the same name; returns both."""
        write_whole(page, self.html())
        return page, write_whole(numbers or page.with_suffix(".json"), self.json() + "\n")
