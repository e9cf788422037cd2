"""Identifiers and literals of Modelica."""

import math
import re

from orchestrator.base.text import MODELICA, words
from orchestrator.fmi.description import Value

PLAIN = r"[A-Za-z_][A-Za-z0-9_]*"
# keywords, and names that the code of a package uses; variables with these names are quoted
RESERVED = MODELICA | words(
    """getInstanceName terminal pre fill sum Real Integer Boolean String Modelica ModelicaServices FMUs
    WithFlanges Systems Flanges Internal block_ fmu_folder fmu_instance fmu_states fmu_next"""
)


def identifier(name: str) -> str:
    """A name as an identifier, quoted if it is not one; different names get different identifiers."""
    if re.fullmatch(PLAIN, name) and name not in RESERVED:
        return name
    escaped = name.replace("\\", "\\\\").replace("'", "\\'")
    ascii_only = re.sub(r"[^ -~]", lambda c: f"_u{ord(c[0]):04x}", escaped)
    return f"'{ascii_only}'"


def class_name(name: str) -> str:
    """boom_stick -> BoomStick; the name itself if this does not give an identifier."""
    parts = re.split(r"[^A-Za-z0-9]+", name)
    joined = "".join(part[:1].upper() + part[1:] for part in parts)
    return joined if re.fullmatch(PLAIN, joined) and name.isascii() else name


class Scope:
    """The identifiers of one class."""

    def __init__(self) -> None:
        self.identifiers: set[str] = set()

    def add(self, name: str) -> str:
        """A new identifier: that of the name, with _ at its end if it exists already."""
        while (result := identifier(name)) in self.identifiers:
            name += "_"
        self.identifiers.add(result)
        return result


def quoted(text: str) -> str:
    """A string literal."""
    escaped = text.replace("\\", "\\\\").replace('"', '\\"')
    return f'"{escaped}"'


def number(value: float) -> str:
    """A real literal."""
    value = float(value)
    if math.isinf(value):
        return f"{'-' if value < 0 else ''}.Modelica.Constants.inf"
    return repr(value)


def literal(value: Value) -> str:
    """A literal of any type."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return quoted(value)
    return str(value) if isinstance(value, int) else number(value)
