"""documentation/index.html of an FMU: the subsystem's README and a table of its variables."""

from __future__ import annotations

from html import escape

from markdown_it import MarkdownIt

from fmus.contract import Subsystem
from fmus.export.interface import Interface, Variable

_STYLE = "body{font-family:sans-serif;max-width:60em;margin:2em auto}td,th{padding:.1em .8em;text-align:left}"
_HEADER = ("name", "kind", "unit", "start", "meaning")


def page(sub: Subsystem, face: Interface) -> str:
    """One self-contained HTML page."""
    readme = sub.values.parent / "README.md"
    text = readme.read_text(encoding="utf-8") if readme.is_file() else f"# {sub.name}\n\n{sub.text}\n"
    body = MarkdownIt("commonmark").enable("table").render(text)
    head = "".join(f"<th>{name}</th>" for name in _HEADER)
    rows = "\n".join(_row(v) for v in face.variables)
    return (
        f'<!DOCTYPE html>\n<html lang="en">\n<head><meta charset="utf-8"><title>{escape(sub.name)}</title>'
        f"<style>{_STYLE}</style></head>\n<body>\n{body}\n<h2>Variables</h2>\n"
        f"<table>\n<tr>{head}</tr>\n{rows}\n</table>\n</body>\n</html>\n"
    )


def _row(v: Variable) -> str:
    kind = v.kind.lower().replace("_", " ")
    start = "" if v.start is None else f"{v.start:g}"
    cells = (v.name, kind, v.quantity.unit, start, v.quantity.text)
    return "<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in cells) + "</tr>"
