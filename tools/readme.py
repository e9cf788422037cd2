"""The long description of the package: README.md without links and pictures that only work in the repository.

Hatchling calls this when it makes a wheel, an sdist or an editable installation.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from hatchling.metadata.plugin.interface import MetadataHookInterface

LINK = re.compile(r"(!?)\[([^\]]*)\]\((?!https?://)([^)\s]+)\)")
NOTE = "*Paths such as docs/run.md are those of the source distribution, which contains the documentation.*"


class ReadmeHook(MetadataHookInterface):
    """Sets `readme` of the project."""

    def update(self, metadata: dict[str, Any]) -> None:
        """Called by Hatchling with the table [project] of pyproject.toml."""
        text = Path(self.root, "README.md").read_text(encoding="utf-8")
        metadata["readme"] = {"content-type": "text/markdown", "text": described(text)}


def described(text: str) -> str:
    """README.md with paths in place of links to files, and without pictures."""
    title, _, rest = LINK.sub(_plain, text).partition("\n")
    return re.sub("\n{3,}", "\n\n", f"{title}\n\n{NOTE}\n{rest}")


def _plain(link: re.Match[str]) -> str:
    picture, words, target = link.groups()
    path = target.partition("#")[0].removeprefix("./")
    if picture:
        return ""
    return words if path in ("", words.strip("`")) else f"{words} (`{path}`)"
