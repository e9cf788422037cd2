"""The written part of an FMU's documentation: the subsystem's README and the sections that it links to."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from markdown_it import MarkdownIt
from markupsafe import Markup

from fmus.files import shipped

_LINK = re.compile(r"\[([^\]]*)\]\(([^)\s]+)\)")
_VARIANT = re.compile(r"^## ([a-z_]+)\n(?:(?!## ).*\n?)*", re.MULTILINE)
_HEADING = re.compile(r"^(#+) +(.*)$", re.MULTILINE)


@dataclass(frozen=True)
class Section:
    """A section of another document."""

    anchor: str
    title: str
    html: Markup

    @property
    def short(self) -> str:
        """The title without its number and what follows a comma."""
        return re.sub(r"^[\d.]+ ", "", self.title).partition(",")[0]


def prose(readme: Path, variant: str = "") -> tuple[Markup, list[Section]]:
    """A README without its title as HTML, and the sections of other documents that it links to.

    Of the sections about variants, whose headings are plain lower-case names, only that of `variant` stays.
    """
    if not readme.is_file():
        return Markup(), []
    text = re.sub(r"\A# .*\n", "", readme.read_text(encoding="utf-8"))
    text = _VARIANT.sub(lambda section: section[0] if section[1] == variant else "", text)
    sections: dict[str, str] = {}
    for _, target in _LINK.findall(text):
        file, _, anchor = target.partition("#")
        found = _section(readme, file, anchor) if file.endswith(".md") and anchor else None
        if found:
            sections[anchor] = found
    text = _LINK.sub(lambda match: _inside(match, sections), text)
    return _html(text), [_shown(anchor, section) for anchor, section in sections.items()]


def _shown(anchor: str, section: str) -> Section:
    title, body = section.split("\n", 1)
    return Section(anchor, title.lstrip("# "), _html(_LINK.sub(r"\1", body)))


def _inside(match: re.Match[str], sections: dict[str, str]) -> str:
    """A link as it works in the one page: to a section in it, to the web, else only its words."""
    words, target = match[1], match[2]
    anchor = target.partition("#")[2]
    if anchor in sections:
        return f"[{words}](#{anchor})"
    return match[0] if target.startswith(("http://", "https://")) else words


def _section(readme: Path, file: str, anchor: str) -> str | None:
    """The section of a Markdown file with this anchor, from its heading to the next of the same rank."""
    path = readme.parent / file
    if not path.is_file():  # installed without the folder of the documents
        path = shipped(file.removeprefix("../../")) or path
    text = path.read_text(encoding="utf-8") if path.is_file() else ""
    headings = list(_HEADING.finditer(text))
    for i, heading in enumerate(headings):
        if slug(heading[2]) == anchor:
            after = (h.start() for h in headings[i + 1 :] if len(h[1]) <= len(heading[1]))
            return text[heading.start() : next(after, len(text))]
    return None


def slug(heading: str) -> str:
    """The anchor that forges give a heading: "4. Swing, eq. (8)" is 4-swing-eq-8."""
    return re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-")


def _html(text: str) -> Markup:
    return Markup(MarkdownIt("commonmark").enable("table").render(text))
