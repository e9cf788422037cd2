"""What the commands `harvester variants` and `harvester parameters` print.

Variants: which fidelity there is of each part, its range of validity, its cost. Parameters: value, unit and
source of each number of the model.
"""

from __future__ import annotations

import shutil
import textwrap
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping

from fmus.contract import Subsystem, quantities
from fmus.controller import CONTROLLER
from fmus.machine.parts import ALL, FAMILIES, SUBSYSTEMS
from fmus.parameters import SOURCES, Number, complete
from orchestrator.base.errors import Problem

Costs = Mapping[tuple[str, str], float]  # (part, variant) -> time per step [us]
LEAST = 0.1  # us: a lower cost is that of the call
LEGEND = "\n".join(f"{word:<11} {meaning}" for word, meaning in SOURCES.items())


def variant_names() -> list[tuple[str, str]]:
    """(part, variant) of all, the usual variant of each part first."""
    return [(part, variant) for part, variants in FAMILIES.items() for variant in variants]


def variant_lines(costs: Costs) -> Iterator[str]:
    """The table of variants as text; a variant that is not in `costs` shows none."""
    head = f"{'states':>8}{'inputs':>8}{'parameters':>12}{'us per 1 ms':>13}{'to the usual':>14}"
    for part, variants in FAMILIES.items():
        usual = next(iter(variants))
        yield f"{part:<20}{head}"
        for variant, sub in variants.items():
            label = f"  {variant}" + (" (usual)" if variant == usual else "")
            sizes = (len(quantities(group)) for group in (sub.states, sub.inputs, sub.parameters))
            counts = "".join(f"{n:>{width}}" for n, width in zip(sizes, (8, 8, 12), strict=True))
            cost, base = costs.get((part, variant)), costs.get((part, usual))
            shown = "" if cost is None else f"{cost:.2f}"
            ratio = "" if cost is None or not base or base < LEAST else f"{cost / base:.2f}"
            yield f"{label:<20}{counts}{shown:>13}{ratio:>14}"
            for text in (sub.text, f"holds: {sub.validity}"):
                yield _indented(text, 110)
        yield ""


def print_parameters(name: str | None = None, source: str | None = None) -> None:
    """Print the table of one subsystem, or of the machine, or what has one source.

    The operator's program is no number of the machine; it has a table of its own.
    """
    variants = [sub for family in FAMILIES.values() for sub in family.values()]
    known = {**ALL, CONTROLLER.name: CONTROLLER, **{sub.name: sub for sub in variants}}
    if name is not None and name not in known:
        raise Problem(f"unknown subsystem {name!r}, expected one of {', '.join(known)}")
    if source is not None and source not in SOURCES:
        raise Problem(f"unknown source {source!r}, expected one of {', '.join(SOURCES)}")
    subs = [known[name]] if name else list(SUBSYSTEMS.values())
    for table in filter(None, ("\n".join(_parameter_lines(sub, source)) for sub in subs)):
        print(f"{table}\n")
    print(f"{LEGEND}\n\n{_count(subs, source)}")


def _parameter_lines(sub: Subsystem, source: str | None) -> Iterator[str]:
    """The numbers of one subsystem, with its start values; or those of one source."""
    found = [
        (f"{name} (start)" if section == "start" else name, name, n)
        for section, entries in complete(sub).items()
        for name, n in entries.items()
        if source in (None, n.source)
    ]
    if not found:
        return
    declared = quantities(sub.parameters) | quantities(sub.inputs) | quantities(sub.states)
    width = max(len(label) for label, _, _ in found)
    yield f"{sub.name}: {sub.text}"
    for label, name, n in found:
        yield f"\n{label:<{width}}  {_value(n):>12} {n.unit:<13} {n.source}"
        yield from (_indented(text, 100) for text in (declared[name].text, n.note))


def _value(n: Number) -> str:
    return f"{n.value:.6g}" + (f" ± {n.sd:.2g}" if n.sd is not None else "")


def _indented(text: str, width: int) -> str:
    columns = min(width, shutil.get_terminal_size().columns)
    return textwrap.fill(text, columns, initial_indent="    ", subsequent_indent="    ")


def _count(subs: Iterable[Subsystem], source: str | None) -> str:
    """How many numbers come from where, start values included: `11 of 90 numbers: paper`."""
    found = Counter(n.source for sub in subs for entries in complete(sub).values() for n in entries.values())
    if source is not None:
        return f"{found[source]} of {found.total()} numbers: {source}"
    return f"{found.total()} numbers: " + ", ".join(f"{found[s]} {s}" for s in SOURCES if found[s])
