"""The numbers of the model as a table: value, unit, source, and where each comes from."""

from __future__ import annotations

import shutil
import textwrap
from collections.abc import Iterator

from fmus.contract import ModelError, Subsystem, quantities
from fmus.machine import SUBSYSTEMS
from fmus.parameters import Number, numbers

LEGEND = """\
paper       printed in the paper: the only FERIC data
derived     follows by a named formula from such numbers or, for start values, from the model
literature  published for a comparable machine
assumed     a free choice
identified  fitted to measurements"""


def lines(sub: Subsystem) -> Iterator[str]:
    """The table of one subsystem, with its start values, as lines of text."""
    found = numbers(sub)
    declared = quantities(sub.parameters) | quantities(sub.inputs) | quantities(sub.states)
    names = [*found["parameters"], *(f"{name} (start)" for name in found["start"])]
    width = max(len(name) for name in names)
    yield f"{sub.name}: {sub.text}"
    for section, entries in found.items():
        for name, n in entries.items():
            label = f"{name} (start)" if section == "start" else name
            yield f"\n{label:<{width}}  {_value(n):>12} {n.unit:<13} {n.source}"
            for text in (declared[name].text, n.note):
                yield textwrap.fill(text, _columns(), initial_indent="    ", subsequent_indent="    ")


def _value(n: Number) -> str:
    return f"{n.value:.6g}" + (f" ± {n.sd:.2g}" if n.sd is not None else "")


def _columns() -> int:
    return min(100, shutil.get_terminal_size().columns)


def show(name: str | None = None) -> None:
    """Print the table of one subsystem, or of all; ModelError for an unknown name."""
    if name is not None and name not in SUBSYSTEMS:
        raise ModelError(f"unknown subsystem {name!r}, expected one of {', '.join(SUBSYSTEMS)}")
    for sub in SUBSYSTEMS.values():
        if name in (None, sub.name):
            print("\n".join(lines(sub)) + "\n")
    print(LEGEND)
