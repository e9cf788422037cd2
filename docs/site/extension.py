"""What the site adds to Sphinx: navigation, tables from the program, MathML, docstrings as written here."""

from __future__ import annotations

import importlib
import inspect
import json
import re
from pathlib import Path
from typing import Any

import tables
from docutils import nodes
from pygments.lexers import TextLexer
from sphinx.addnodes import desc_signature
from sphinx.application import Sphinx
from sphinx.errors import ExtensionError
from sphinx.util.osutil import relative_uri

from fmus.export.documentation import mathml

ROOT = Path(__file__).parents[2]
OBJECT = re.compile(r"^::: (\S+)$", re.MULTILINE)
TITLED = re.compile(r'^```(\w+) title="([^"]+)"$', re.MULTILINE)
ROW = re.compile(r"(\w+(?:, \w+)*)(?: {2,}|(?<=\w, \w) +)(\S.*)")


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the parts of this extension."""
    app.add_lexer("csv", TextLexer)
    app.connect("source-read", read_source)
    app.connect("autodoc-process-docstring", process_docstring)
    app.connect("doctree-read", share_anchors)
    app.add_config_value("machine_system", "build/harvester.ssp", "html")
    app.connect("html-page-context", insert_machine)
    app.connect("build-finished", finish_pages)
    renderer: Any = app.add_html_math_renderer
    renderer("mathml", (visit_math, None), (visit_math_block, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}


# ---- pages


def read_source(app: Sphinx, page: str, source: list[str]) -> None:
    """Fill in tables and Python objects, show titles of programs; the home page gets the navigation."""
    if Path(app.env.doc2path(page)).suffix == ".ipynb":
        source[0] = notebook(source[0])
    text = OBJECT.sub(lambda found: documented(found[1]), tables.filled(source[0]))
    text = TITLED.sub(r"```{code-block} \1\n:caption: \2\n", text)
    if page == app.config.root_doc:
        text += "".join(toctree(caption, pages) for caption, pages in navigation(app).items())
    source[0] = text


def notebook(text: str) -> str:
    """The cells of a Jupyter notebook as Markdown."""
    cells = [(cell["cell_type"], "".join(cell["source"])) for cell in json.loads(text)["cells"]]
    return "\n\n".join(f"```python\n{cell}\n```" if kind == "code" else cell for kind, cell in cells)


def navigation(app: Sphinx) -> dict[str, list[str]]:
    """Captions and pages of the sidebar, from docs/conf.py."""
    return dict(app.config._raw_config["NAVIGATION"])


def toctree(caption: str, pages: list[str]) -> str:
    """A part of the sidebar."""
    rooted = (re.sub(r"([^<\s]+)(>?)$", r"/\1\2", page) for page in pages)
    names = "\n".join(re.sub(r"(\S+)\.(?:md|ipynb)(>?)$", r"\1\2", page) for page in rooted)
    return f"\n```{{toctree}}\n:hidden:\n:caption: {caption}\n:titlesonly:\n\n{names}\n```\n"


def documented(path: str) -> str:
    """The directive that documents a Python module, class or function from its docstrings."""
    options = ""
    try:
        lazy = hasattr(importlib.import_module(path), "__getattr__")  # its names are on other pages
        kind, heading, options = "module", f"## `{path}`\n\n", "   :no-members:\n" * lazy
    except ModuleNotFoundError as missing:
        if missing.name != path:  # a package that the module needs
            raise
        module, name = path.rsplit(".", 1)
        found = getattr(importlib.import_module(module), name)
        heading = ""
        kind = "class" if inspect.isclass(found) else "function" if inspect.isroutine(found) else "data"
        kind = "exception" if inspect.isclass(found) and issubclass(found, BaseException) else kind
        if kind == "data" or found.__module__ == "typing":  # its text is on the page
            return f"```{{eval-rst}}\n.. py:data:: {name}\n   :module: {module}\n```\n"
    return f"{heading}```{{eval-rst}}\n.. auto{kind}:: {path}\n{options}```\n"


def share_anchors(_app: Sphinx, page: nodes.document) -> None:
    """Links to an object, and to its members, have its public name, as running.html#orchestrator.run."""
    for node in page.findall(desc_signature):
        for place in [*node["ids"]]:
            names = [
                n + place[len(p) :]
                for p, of in tables.public_names().items()
                for n in of
                if f"{place}.".startswith(f"{p}.")
            ]
            node["ids"] = [*(name for name in names if name not in node["ids"]), *node["ids"]]


MACHINE = '<div id="machine"></div>'


def insert_machine(app: Sphinx, page: str, _template: str, context: dict[str, Any], _tree: Any) -> None:
    """Put the machine itself on the page that has a place for it."""
    if MACHINE not in context.get("body", ""):
        return
    from orchestrator.drive.page import fragment

    system = ROOT / app.config.machine_system
    if not system.is_file():
        raise ExtensionError(f"{page}: {system} does not exist; run harvester build first")
    if not (section := fragment(system, autostart=True)):
        raise ExtensionError(f"{page}: expected FMI 3.0 FMUs beside {system}, which a page can run")
    context["body"] = context["body"].replace(MACHINE, section)


# what the theme leaves out for screen readers and for the keyboard
ACCESSIBLE = {
    'class="caption" role="heading"': 'class="caption" role="heading" aria-level="2"',
    '<aside class="sidebar-drawer"': '<aside class="sidebar-drawer" aria-label="Pages"',
    '<aside class="toc-drawer"': '<aside class="toc-drawer" aria-label="This page"',
    '<div class="table-wrapper': '<div tabindex="0" class="table-wrapper',
    "<pre>": '<pre tabindex="0">',
    '<th class="head"><p></p></th>': '<td class="head"></td>',
    '<div id="search-results">': '<h1>Search</h1><div id="search-results">',
}


def finish_pages(app: Sphinx, error: Exception | None) -> None:
    """Make the pages accessible; index.html at the top of the site leads to the home page."""
    if error is not None or app.builder.format != "html":
        return
    for path in Path(app.outdir).rglob("*.html"):
        page = text = path.read_text(encoding="utf-8")
        for old, new in ACCESSIBLE.items():
            text = text.replace(new, old).replace(old, new)
        if text != page:
            path.write_text(text, encoding="utf-8")
    home = relative_uri("", app.builder.get_target_uri(app.config.root_doc))
    refresh = f'<meta charset="utf-8"><meta http-equiv="refresh" content="0; url={home}">'
    page = f'<!doctype html>\n<html lang="en"><head>{refresh}<title>harvester-cosim</title></head>'
    page += f'<body><main><h1><a href="{home}">harvester-cosim</a></h1></main></body></html>\n'
    (Path(app.outdir) / "index.html").write_text(page, encoding="utf-8")


# ---- equations


def visit_math(translator: Any, node: nodes.math) -> None:
    """An equation within a line."""
    translator.body.append(mathml(node.astext(), file=translator.builder.current_docname))
    raise nodes.SkipNode


def visit_math_block(translator: Any, node: nodes.math_block) -> None:
    """An equation on lines of its own, which scrolls if it is wider than the page."""
    formula = mathml(node.astext(), True, translator.builder.current_docname)
    translator.body.append(f'<div class="equation" tabindex="0">{formula}</div>\n')
    raise nodes.SkipNode


# ---- docstrings


def process_docstring(*arguments: Any) -> None:
    """Rewrite a docstring in place; Sphinx gives its lines as the last argument."""
    lines = arguments[-1]
    lines[:] = restructured("\n".join(lines)).splitlines()


def restructured(text: str) -> str:
    """The docstring in reStructuredText.

    Rows of two columns, names on the left, become a table of names and meanings. Other indented lines, which
    are equations or programs, become literal blocks.
    """
    kept: list[str] = []
    rows: list[list[str]] = []
    where = "text"
    for line in text.splitlines():
        found = ROW.fullmatch(line)
        if found:
            where = "rows"
            rows.append([found[1], found[2]])
        elif where == "rows" and line.startswith("  "):
            rows[-1][1] += f" {line.strip()}"
        else:
            if rows:
                kept += [*fields(rows), ""]
                rows = []
            if line.startswith("  ") and where != "literal":
                kept += ["", "::", ""]
                where = "literal"
            elif line.strip() and not line.startswith(" "):
                if where == "literal":
                    kept.append("")
                where = "text"
            kept.append(line if where == "literal" else escaped(line))
    return "\n".join([*kept, "", *fields(rows), ""])


def fields(rows: list[list[str]]) -> list[str]:
    """A definition list of names and meanings."""
    if not rows:
        return []
    lines = ["", ".. list-table::", "   :class: columns", "   :widths: auto", ""]
    for names, meaning in rows:
        literal = ", ".join(f"``{name}``" for name in names.split(", "))
        lines += [f"   * - {literal}", f"     - {escaped(meaning)}"]
    return [*lines, ""]


def escaped(line: str) -> str:
    """A line of Markdown as reStructuredText: code between backticks, all else literal."""
    parts = re.split(r"`+([^`]+)`+", line)
    plain = [re.sub(r"([*_|\\])", r"\\\1", part) for part in parts[::2]]
    code = [f"``{part}``" for part in parts[1::2]]
    code = [c + "\\ " * after[:1].isalnum() for c, after in zip(code, plain[1:], strict=True)]
    return "".join(part for pair in zip(plain, [*code, ""], strict=True) for part in pair)
