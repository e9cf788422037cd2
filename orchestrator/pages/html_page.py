"""Self-contained HTML pages from templates, and JSON files: styles, scripts and figures are in the page."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup, escape

from orchestrator.base.text import TextTable, jinja_environment, typeset
from orchestrator.base.units import pretty
from orchestrator.pages.figures import TEMPLATES, plot_scripts

QUANTITY = re.compile(r"(?<![\w.])(-?\d[\d.e+-]*) ([A-Za-z][\w./]*)")  # a number and its unit


def render(template: Path, *, title: str, **content: object) -> str:
    """Render a template that extends `page.html.j2`, with the CSS file of the same name if there is one.

    template   path of the template
    content    variables of the template, besides `title` and `style`

    Templates can use the filter `sentence`. A page with figures of `figures.plot` gets their scripts.
    """
    environment = jinja_environment(template.parent, TEMPLATES, escaped=True)
    environment.filters["sentence"] = sentence
    styles = (TEMPLATES / "page.css", template.with_name(template.name.replace(".html.j2", ".css")))
    texts = (path.read_text(encoding="utf-8") for path in styles if path.is_file())
    style = Markup("\n".join(re.sub(r"^ +|/\*.*?\*/", "", text, flags=re.MULTILINE) for text in texts))
    page = environment.get_template(template.name)
    return str(page.render(title=title, style=style, plot_scripts=plot_scripts, **content))


def typeset_code(text: str) -> Markup:
    """A text with numbers as on paper, and what is between backticks as code."""
    return Markup(re.sub(r"`([^`]+)`", r"<code>\1</code>", str(escape(typeset(text)))))


def breakable(name: str) -> Markup:
    """A name that may break after its dots and underscores."""
    return Markup(re.sub(r"([._])(?=\w)", r"\1<wbr>", str(escape(name))))


def upper_first(text: str) -> str:
    """The text with a capital, unless it begins with the name of a file or a signal."""
    return text if "." in text.partition(" ")[0] else f"{text[:1].upper()}{text[1:]}"


def sentence(text: str) -> Markup:
    """The text as a sentence of a page; markup, and what ends as a sentence, as it is."""
    if isinstance(text, Markup):
        return text
    return typeset_code(text if text.endswith((".", "!", "?", ":")) else f"{upper_first(text)}.")


def typeset_table(table: TextTable) -> TextTable:
    """The table with numbers and units as on paper: 1.7e-05 m3 is 1.7·10⁻⁵ m³."""

    def cell(text: str) -> str:
        if isinstance(text, Markup):
            return text
        return typeset(re.sub(QUANTITY, lambda m: f"{m[1]} {pretty(m[2])}", text))

    return replace(table, rows=[[cell(text) for text in row] for row in table.rows])


def json_values(values: Any) -> Any:
    """Convert dataclasses, mappings, sequences and NumPy numbers to JSON types; NaN and infinity to null."""
    if is_dataclass(values) and not isinstance(values, type):
        return {field.name: json_values(getattr(values, field.name)) for field in fields(values)}
    if isinstance(values, Mapping):
        return {str(key): json_values(value) for key, value in values.items()}
    if isinstance(values, str | bool | int) or values is None:
        return values
    if isinstance(values, np.generic):
        return json_values(values.item())
    if isinstance(values, float):
        return values if math.isfinite(values) else None
    if isinstance(values, Iterable):
        return [json_values(value) for value in values]
    return str(values)
