"""TOML files that people write: what cannot be read and what is not known is refused by name."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from fmus.contract import ModelError


def load(path: Path) -> dict[str, Any]:
    """The tables of a TOML file."""
    try:
        return tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except FileNotFoundError:
        raise ModelError(
            f"{path}: expected a TOML file that describes the columns, found no such file"
        ) from None
    except OSError as error:
        raise ModelError(f"{path}: expected a TOML file, found {error.strerror}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ModelError(f"{path}: cannot be read as TOML: {error}") from None


def keys(table: Any, known: Mapping[str, Any], where: str) -> None:
    """Refuse what is not a table, an unknown key and a value of the wrong type."""
    if not isinstance(table, dict):
        raise ModelError(f"{where}: expected a table, found {table!r}")
    for key, value in table.items():
        if key not in known:
            raise ModelError(f"{where}: unknown key {key!r}, expected one of {', '.join(known)}")
        if not isinstance(value, known[key]) or isinstance(value, bool):
            kinds = known[key] if isinstance(known[key], tuple) else (known[key],)
            wanted = " or ".join(kind.__name__ for kind in kinds)
            raise ModelError(f"{where}: {key} is {value!r}, expected {wanted}")
