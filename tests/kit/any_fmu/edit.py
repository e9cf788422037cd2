"""Copies of FMUs with changes in their model descriptions."""

import re
import zipfile
from pathlib import Path

Change = tuple[str, str]  # pattern, replacement


def edited(fmu: Path, target: Path, *changes: Change) -> Path:
    """A copy of an FMU with changes, each of which must change something."""
    with zipfile.ZipFile(fmu) as old, zipfile.ZipFile(target, "w") as new:
        for member in old.namelist():
            content = old.read(member)
            if member == "modelDescription.xml":
                text = content.decode()
                for pattern, replacement in changes:
                    text, count = re.subn(pattern, replacement, text, flags=re.DOTALL)
                    assert count, pattern
                content = text.encode()
            new.writestr(member, content)
    return target


def renamed(port: str, name: str = "other") -> Change:
    """A change that takes a port away by giving it another name."""
    return f'name="{port}" valueReference', f'name="{name}" valueReference'


def caused(port: str, causality: str) -> Change:
    """A change of the causality of a port."""
    variability = "fixed" if causality == "parameter" else "continuous"
    pattern = rf'(name="{port}" [^>]*causality=)"\w+" variability="\w+"'
    return pattern, rf'\1"{causality}" variability="{variability}"'
