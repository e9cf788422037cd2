"""What MkDocs calls while it builds the site."""

from __future__ import annotations

from typing import Any

import repository
import tables
from mkdocs.structure.files import File, Files

FRONT = "index.md"


def on_files(files: Files, config: Any) -> Files:
    """Add documents, pictures and programs that stand outside docs/."""
    rooms = repository.rooms()
    documents = rooms + [f"docs/{f.src_uri}" for f in files.documentation_pages()]
    for path in dict.fromkeys([*rooms, *repository.linked(documents)]):
        place = repository.place(path)
        if files.get_file_from_path(place) is None:
            files.append(added(config, path, place))
    return files


def added(config: Any, path: str, place: str) -> File:
    """A file of the project at its place in the site."""
    if place.startswith("source/"):
        return File.generated(config, place, content=repository.shown(path))
    return File.generated(config, place, abs_src_path=str(repository.ROOT / path))


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Fill in the tables, turn the links round."""
    place = page.file.src_uri
    if place == FRONT:
        page.meta["hide"] = ["navigation", "toc"]
    return markdown if place.startswith("source/") else repository.rewritten(tables.filled(markdown), place)
