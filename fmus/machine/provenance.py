"""The numbers of the model as a table: value, unit, source, and where each comes from."""

from __future__ import annotations

import shutil
import textwrap
from collections import Counter
from collections.abc import Iterable, Iterator

from fmus.contract import Subsystem, quantities
from fmus.controller import CONTROLLER
from fmus.machine.parts import ALL, FAMILIES, SUBSYSTEMS
from fmus.parameters import SOURCES, Number, numbers
from orchestrator.base.errors import Problem

LEGEND = "\n".join(f"{word:<11} {meaning}" for word, meaning in SOURCES.items())


def lines(sub: Subsystem, source: str | None = None) -> Iterator[str]:
    """The table of one subsystem, with its start values, as lines of text; or the numbers of one source."""
    found = {
        section: {name: n for name, n in entries.items() if source in (None, n.source)}
        for section, entries in numbers(sub).items()
    }
    declared = quantities(sub.parameters) | quantities(sub.inputs) | quantities(sub.states)
    names = [*found["parameters"], *(f"{name} (start)" for name in found["start"])]
    if not names:
        return
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


def count(subs: Iterable[Subsystem], source: str | None = None) -> str:
    """How many numbers come from where, start values included: `11 of 90 numbers: paper`."""
    found = Counter(n.source for sub in subs for entries in numbers(sub).values() for n in entries.values())
    if source is not None:
        return f"{found[source]} of {found.total()} numbers: {source}"
    return f"{found.total()} numbers: " + ", ".join(f"{found[s]} {s}" for s in SOURCES if found[s])


def show(name: str | None = None, source: str | None = None) -> None:
    """Print the table of one subsystem, or of the machine, or what has one source.

    The operator's program is no number of the machine; it has a table of its own.
    """
    known = {
        **ALL,
        CONTROLLER.name: CONTROLLER,
        **{sub.name: sub for variants in FAMILIES.values() for sub in variants.values()},
    }
    if name is not None and name not in known:
        raise Problem(f"unknown subsystem {name!r}, expected one of {', '.join(known)}")
    if source is not None and source not in SOURCES:
        raise Problem(f"unknown source {source!r}, expected one of {', '.join(SOURCES)}")
    subs = [known[name]] if name else list(SUBSYSTEMS.values())
    for table in filter(None, ("\n".join(lines(sub, source)) for sub in subs)):
        print(f"{table}\n")
    print(f"{LEGEND}\n\n{count(subs, source)}")
