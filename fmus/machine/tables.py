"""Tables of `harvester variants` and `harvester parameters`.

Variants: size, range of validity and cost of each variant of each part. Parameters: value, unit and source of
each parameter and start value.
"""

from __future__ import annotations

import shutil
import textwrap
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping

from fmus.contract import Subsystem, quantities
from fmus.controller import CONTROLLER
from fmus.machine.parts import ALL, FAMILIES, SUBSYSTEMS
from fmus.parameters import SOURCES, Number, complete, row_text, row_value, rows
from orchestrator.base.errors import Problem

Costs = Mapping[tuple[str, str], float]  # (part, variant) -> time per step [us]
CALL_COST = 0.1  # us: cost of the call itself; ratios to a lower cost are not printed
LEGEND = "\n".join(f"{source:<11} {meaning}" for source, meaning in SOURCES.items())


def variant_names() -> list[tuple[str, str]]:
    """(part, variant) of all variants, the default variant of each part first."""
    return [(part, variant) for part, variants in FAMILIES.items() for variant in variants]


def variant_lines(costs: Costs) -> Iterator[str]:
    """Lines of the table of variants; the cost is empty for a variant that is not in `costs`."""
    head = f"{'states':>8}{'inputs':>8}{'parameters':>12}{'us per 1 ms':>13}{'to the usual':>14}"
    for part, variants in FAMILIES.items():
        usual = next(iter(variants))
        yield f"{part:<20}{head}"
        for variant, sub in variants.items():
            label = f"  {variant}" + (" (usual)" if variant == usual else "")
            sizes = (len(quantities(group)) for group in (sub.states, sub.inputs, sub.parameters))
            counts = "".join(f"{n:>{width}}" for n, width in zip(sizes, (8, 8, 12), strict=True))
            cost, base = costs.get((part, variant)), costs.get((part, usual))
            cost_text = "" if cost is None else f"{cost:.2f}"
            ratio = "" if cost is None or not base or base < CALL_COST else f"{cost / base:.2f}"
            yield f"{label:<20}{counts}{cost_text:>13}{ratio:>14}"
            for text in (sub.text, f"holds: {sub.validity}"):
                yield _indented(text, 110)
        yield ""


def print_parameters(name: str | None = None, source: str | None = None) -> None:
    """Print the parameters of a subsystem (default: all of the machine), optionally of one source only.

    The program of the operator is not part of the machine; its table is that of `operator_input`.
    """
    variants = [sub for family in FAMILIES.values() for sub in family.values()]
    by_name = {**ALL, CONTROLLER.name: CONTROLLER, **{sub.name: sub for sub in variants}}
    if name is not None and name not in by_name:
        raise Problem(f"unknown subsystem {name!r}, expected one of {', '.join(by_name)}")
    if source is not None and source not in SOURCES:
        raise Problem(f"unknown source {source!r}, expected one of {', '.join(SOURCES)}")
    subs = [by_name[name]] if name else list(SUBSYSTEMS.values())
    for table in filter(None, ("\n".join(_parameter_lines(sub, source)) for sub in subs)):
        print(f"{table}\n")
    print(f"{LEGEND}\n\n{_count(subs, source)}")


def _parameter_lines(sub: Subsystem, source: str | None) -> Iterator[str]:
    """Table of parameter and start values of one subsystem, optionally of one source only."""
    shown = [
        (f"{name} (start)" if section == "start" else name, name, row)
        for section, entries in complete(sub).items()
        for name, row in rows(entries).items()
        if source in (None, row[0].source)
    ]
    if not shown:
        return
    declared = quantities(sub.parameters) | quantities(sub.inputs) | quantities(sub.states)
    width = max(len(label) for label, _, _ in shown)
    yield f"{sub.name}: {sub.text}"
    for label, name, row in shown:
        n, value = row[0], row_value(name, row, _value)
        yield f"\n{label:<{width}}  {value:>12} {n.unit:<13} {n.source}"
        yield from (_indented(text, 100) for text in (row_text(name, declared), n.note))


def _value(n: Number) -> str:
    return f"{n.value:.6g}" + (f" ± {n.sd:.2g}" if n.sd is not None else "")


def _indented(text: str, width: int) -> str:
    columns = min(width, shutil.get_terminal_size().columns)
    return textwrap.fill(text, columns, initial_indent="    ", subsequent_indent="    ")


def _count(subs: Iterable[Subsystem], source: str | None) -> str:
    """Numbers of parameter and start values by source, for example `11 of 90 numbers: paper`."""
    tables = [entries for sub in subs for entries in complete(sub).values()]
    counts = Counter(row[0].source for entries in tables for row in rows(entries).values())
    if source is not None:
        return f"{counts[source]} of {counts.total()} numbers: {source}"
    return f"{counts.total()} numbers: " + ", ".join(f"{counts[s]} {s}" for s in SOURCES if counts[s])
