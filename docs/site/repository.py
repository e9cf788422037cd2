"""Where each file of the project stands in the site, and where its links lead there.

Documents stay beside what they describe, with links that work on a git server. The site has those of docs/
at its top, the others at their path; a linked program becomes a page that shows it.
"""

from __future__ import annotations

import posixpath
import re
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]
DOCS = "docs/"
ROOMS = ("fmus/README.md", "fmus/*/README.md", "fmus/machine/*/README.md", "orchestrator/README.md")
ROOMS += ("examples/*/README.md",)
TOP = {"README.md": "overview.md", "CONTRIBUTING.md": "contributing.md", "CHANGELOG.md": "changelog.md"}
SHOWN = {".py": "python", ".toml": "toml", ".m": "matlab", ".mo": "modelica", ".mos": "modelica", ".c": "c"}
LINK = re.compile(r"(?<=\]\()[^)\s#]+(?=[)#\s])")


def rooms() -> list[str]:
    """The documents outside docs/ that belong to the site."""
    found = (path for pattern in ROOMS for path in sorted(ROOT.glob(pattern)))
    return [*TOP, *(path.relative_to(ROOT).as_posix() for path in found)]


def place(path: str) -> str:
    """The place in the site of a file of the project, named from the project's folder."""
    if path in TOP:
        return TOP[path]
    if Path(path).suffix in SHOWN:
        return f"source/{path}.md"
    return path.removeprefix(DOCS)


def origin(place: str) -> str:
    """The file of the project that stands at a place in the site."""
    back = {there: path for path, there in TOP.items()}
    if place in back:
        return back[place]
    return place if (ROOT / place).is_file() else DOCS + place


def target(link: str, document: str) -> str | None:
    """The file of the project that a link in a document leads to, if it does."""
    path = posixpath.normpath(posixpath.join(posixpath.dirname(document), link))
    return path if not path.startswith("..") and (ROOT / path).is_file() else None


def linked(documents: list[str]) -> Iterator[str]:
    """The files that the documents link to."""
    for document in documents:
        for link in LINK.findall((ROOT / document).read_text(encoding="utf-8")):
            if (path := target(link, document)) is not None:
                yield path


def rewritten(markdown: str, at: str) -> str:
    """The text of the page at a place, with links that lead to places."""
    document = origin(at)

    def new(link: re.Match[str]) -> str:
        path = target(link[0], document)
        return link[0] if path is None else posixpath.relpath(place(path), posixpath.dirname(at))

    return LINK.sub(new, markdown.replace("<details>", '<details markdown="1">'))


def shown(path: str) -> str:
    """The page that shows a program."""
    text = (ROOT / path).read_text(encoding="utf-8")
    return f"---\nsearch:\n  exclude: true\n---\n# `{path}`\n\n````{SHOWN[Path(path).suffix]}\n{text}````\n"
