"""The ground room: errors, units, texts and files."""

from collections.abc import Callable, Mapping
from pathlib import Path

# Of each package with files that a user may name, such as systems and scenarios: a function of a name and the
# wanted suffixes, which returns the files by their paths in a checkout.
SHIPPED: list[Callable[[str, tuple[str, ...]], Mapping[str, Path]]] = []
