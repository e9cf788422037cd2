"""Files of the project that are no code."""

from __future__ import annotations

from pathlib import Path


def shipped(name: str) -> Path | None:
    """A file by its path in a checkout, such as data/x.csv; an installed package has a copy inside."""
    package = Path(__file__).parent
    return next((folder / name for folder in (package.parent, package) if (folder / name).is_file()), None)
