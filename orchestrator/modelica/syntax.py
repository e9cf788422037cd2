"""Names and values as Modelica writes them."""

from __future__ import annotations

import math
import re

from orchestrator.fmi.description import Value

PLAIN = r"[A-Za-z_][A-Za-z0-9_]*"
# keywords, and names that the text of a package uses: a variable of such a name is written in quotes
RESERVED = frozenset(
    re.findall(
        r"\w+",
        """algorithm and annotation assert block break class connect connector constant constrainedby der
        discrete each else elseif elsewhen encapsulated end enumeration equation expandable extends
        external false final flow for function getInstanceName if import impure in initial inner input
        loop model not operator or outer output package parameter partial protected public pure record
        redeclare replaceable return stream terminal then true type when while within time pre fill sum
        Real Integer Boolean String Modelica ModelicaServices FMUs WithFlanges Systems Flanges Internal
        block_ fmu_folder fmu_instance fmu_states fmu_next""",
    )
)


def identifier(name: str) -> str:
    """The name itself, or in quotes what Modelica would not take; two names never become one."""
    if re.fullmatch(PLAIN, name) and name not in RESERVED:
        return name
    escaped = name.replace("\\", "\\\\").replace("'", "\\'")
    ascii_only = re.sub(r"[^ -~]", lambda c: f"_u{ord(c[0]):04x}", escaped)
    return f"'{ascii_only}'"


def class_name(name: str) -> str:
    """boom_stick -> BoomStick; a name that gives no identifier in this way stays as it is."""
    parts = re.split(r"[^A-Za-z0-9]+", name)
    joined = "".join(part[:1].upper() + part[1:] for part in parts)
    return joined if re.fullmatch(PLAIN, joined) and name.isascii() else name


class Scope:
    """The identifiers of one class."""

    def __init__(self) -> None:
        self.taken: set[str] = set()

    def add(self, name: str) -> str:
        """An identifier that is not taken yet: that of the name, or one with _ at its end."""
        found = identifier(name)
        while found in self.taken:
            name += "_"
            found = identifier(name)
        self.taken.add(found)
        return found


def quoted(text: str) -> str:
    """A string."""
    escaped = text.replace("\\", "\\\\").replace('"', '\\"')
    return f'"{escaped}"'


def number(value: float) -> str:
    """A real number."""
    value = float(value)
    if math.isinf(value):
        return f"{'-' if value < 0 else ''}.Modelica.Constants.inf"
    return repr(value)


def literal(value: Value) -> str:
    """A value of any type."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return quoted(value)
    return str(value) if isinstance(value, int) else number(value)
