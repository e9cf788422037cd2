"""Docstrings in two columns, names on the left, as NumPy sections, from which the reference makes tables.

step            communication step [s]            Parameters
start, stop     [s]; default: as the        ->    ----------
                system suggests                   step :
                                                      communication step [s]
"""

from __future__ import annotations

import ast
import re
from typing import Any

import griffe

ROW = re.compile(r"(\w+(?:, \w+)*)(?: {2,}|(?<=\w, \w) +)(\S.*)")


class Columns(griffe.Extension):
    """Rewrites the docstrings of functions and classes before they are read."""

    def on_function_instance(self, *, node: Any, func: griffe.Function, **_: Any) -> None:
        """The names are parameters."""
        rewrite(func, node, "Parameters", {p.name for p in func.parameters})

    def on_class_members(self, *, node: Any, cls: griffe.Class, **_: Any) -> None:
        """The names are attributes."""
        rewrite(cls, node, "Attributes", set(cls.members))


def rewrite(thing: griffe.Object, node: Any, section: str, known: set[str]) -> None:
    """Turn the rows of a docstring into a section, where their names are known.

    The text is taken as it was written: cleaned, it would lose the indentation of equations, if they are all
    that follows the first line.
    """
    if thing.docstring and isinstance(node, ast.FunctionDef | ast.ClassDef):
        margin = " " * node.body[0].col_offset
        first, *rest = (ast.get_docstring(node, clean=False) or "").splitlines()
        text = "\n".join([first, *(line.removeprefix(margin) for line in rest)]).rstrip()
        thing.docstring.value = sectioned(text, section, known)


def sectioned(text: str, section: str, known: set[str]) -> str:
    """The docstring with its rows moved into a section at its end."""
    kept: list[str] = []
    rows: list[str] = []
    inside = False
    for line in text.splitlines():
        found = ROW.fullmatch(line)
        if found and set(found[1].split(", ")) <= known:
            rows += [f"{found[1]} :", f"    {found[2]}"]
            inside = True
        elif inside and line.startswith("  "):
            rows.append(f"    {line.strip()}")
        else:
            inside = False
            kept.append(line)
    return "\n".join([*kept, "", section, "-" * len(section), *rows]) if rows else text
