"""Tables of `harvester variants` and `harvester parameters`.

Variants: size, range of validity and cost of each variant of each part. Parameters: value, unit and source of
each parameter and start value.
"""

import shutil
import textwrap
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from fmus.contract import Subsystem, quantities
from fmus.controller import CONTROLLER
from fmus.machine.parts import FAMILIES, FERIC
from fmus.parameters import SOURCES, Number, complete, numbers, padded, read, row_text, row_value, rows
from fmus.valve_actuation import ACTUATION
from orchestrator.base.errors import Problem, suggest
from orchestrator.base.files import VARIANTS, Location
from orchestrator.fmi.interface import read_interface

Costs = Mapping[tuple[str, str], float]  # (part, variant) -> time per step [us]
CALL_COST = 0.1  # us: cost of the call itself; ratios to a lower cost are not printed
LEGEND = "\n".join(f"{source:<11} {meaning}" for source, meaning in SOURCES.items())


def variant_names() -> list[tuple[str, str]]:
    """(part, variant) of all variants, the default variant of each part first."""
    return [(part, variant) for part, variants in FAMILIES.items() for variant in variants]


def variant_rows(costs: Costs) -> list[dict[str, object]]:
    """The variants as data, each with its cost [us] if it is in `costs`."""
    return [
        {"part": part, "variant": variant, "text": sub.text, "validity": sub.validity}
        | {name: len(quantities(getattr(sub, name))) for name in ("states", "inputs", "parameters")}
        | {"cost": costs.get((part, variant))}
        for part, variants in FAMILIES.items()
        for variant, sub in variants.items()
    ]


def variant_lines(costs: Costs) -> Iterator[str]:
    """Lines of the table of variants; the cost is empty for a variant that is not in `costs`."""
    head = f"{'states':>8}{'inputs':>8}{'parameters':>12}"
    head += f"{'us per 1 ms':>13}{'relative':>14}" if costs else ""
    for part, variants in FAMILIES.items():
        usual = next(iter(variants))
        yield f"{part:<20}{head}"
        for variant, sub in variants.items():
            label = f"  {variant}" + (" (default)" if variant == usual else "")
            sizes = (len(quantities(group)) for group in (sub.states, sub.inputs, sub.parameters))
            counts = "".join(f"{n:>{width}}" for n, width in zip(sizes, (8, 8, 12), strict=True))
            cost, base = costs.get((part, variant)), costs.get((part, usual))
            cost_text = "" if cost is None else f"{cost:.2f}"
            ratio = "" if cost is None or not base or base < CALL_COST else f"{cost / base:.2f}"
            yield f"{label:<20}{counts}{cost_text:>13}{ratio:>14}".rstrip()
            for text in (sub.text, f"valid: {sub.validity}"):
                yield _indented(text, 110)
        yield ""


def parameter_text(name: str | None = None, source: str | None = None, folder: Path | None = None) -> str:
    """Tables of the parameters of a subsystem (default: all of the machine), optionally of one source only.

    Another name, such as `hose`, selects the parameters of all subsystems whose names contain it.

    The program of the operator is not part of the machine; its table is that of `operator_input`.

    folder   of built FMUs; values that were built into them are shown, with the shipped ones
    """
    subs, word = _chosen(name, source, folder)
    told = set[tuple[str, str]]()  # by part, as variants of a part share parameters
    tables = ["\n".join(_parameter_lines(sub, source, word, told)) for sub in subs]
    return "\n\n".join(filter(None, [*tables, LEGEND, "" if word else _count(subs, source)]))


def parameter_rows(
    name: str | None = None, source: str | None = None, folder: Path | None = None
) -> list[dict[str, object]]:
    """The same as data, in SI units."""
    subs, word = _chosen(name, source, folder)
    return [
        {"part": sub.name, "name": key, "start": section == "start"} | vars(number)
        for sub in subs
        for section, entries in complete(sub).items()
        for key, number in entries.items()
        if source in (None, number.source) and word in key
    ]


def _chosen(name: str | None, source: str | None, folder: Path | None) -> tuple[list[Subsystem], str]:
    """The subsystems, and the part of the names of their parameters."""
    variants = [sub for family in FAMILIES.values() for sub in family.values()]
    by_name = {sub.name: sub for sub in (*FERIC.components.values(), ACTUATION, CONTROLLER, *variants)}
    if source is not None and source not in SOURCES:
        hint = suggest(source, SOURCES) or f", expected one of {', '.join(SOURCES)}"
        raise Problem(f"unknown source {source!r}{hint}")
    word = "" if name is None or name in by_name else name
    subs = [by_name[name]] if name and not word else list((by_name if word else FERIC.subsystems).values())
    known = {p for sub in subs for section in complete(sub).values() for p in section} if word else {""}
    if not any(word in parameter for parameter in known):
        words = sorted(known | {part for p in known for part in p.split("_") if len(part) > 3})
        hint = suggest(word, [*by_name, *words]) or f", expected one of {', '.join(by_name)}"
        raise Problem(f"unknown subsystem or parameter {name!r}{hint}")
    if folder is not None:
        subs = [_as_built(sub, folder) for sub in subs]
    return subs, word


def _parameter_lines(
    sub: Subsystem, source: str | None, word: str, told: set[tuple[str, str]]
) -> Iterator[str]:
    """Table of parameter and start values of one subsystem, optionally of one source.

    word, told   only parameters with this word, and not those of its part that were told already
    """
    part = next((p for p in FAMILIES if sub.name.startswith(p)), sub.name)
    shown = [
        (f"{name} (start)" if section == "start" else name, name, row)
        for section, entries in complete(sub).items()
        for name, row in rows(entries).items()
        if source in (None, row[0].source) and word in name and not (word and (part, name) in told)
    ]
    told.update((part, name) for _, name, _ in shown)
    if not shown:
        return
    declared = quantities(sub.parameters) | quantities(sub.inputs) | quantities(sub.states)
    width = max(len(label) for label, _, _ in shown)
    yield f"{sub.name}: {sub.text}"
    for label, name, row in shown:
        n, value = row[0], row_value(name, row, _value)
        yield f"\n{label:<{width}}  {value:>12} {n.unit:<13} {n.source}{_not_shipped(name, row)}"
        yield from (_indented(text, 100) for text in (row_text(name, declared), n.note))


def _as_built(sub: Subsystem, folder: Path) -> Subsystem:
    """The subsystem with the values of its FMU in a folder, if that was built with other values."""
    files = [folder / f"{sub.name}.fmu", folder / VARIANTS / f"{sub.name}.fmu"]
    file = next((Location(f) for f in files if f.is_file()), None)
    sets = read_interface(file).model.parameter_sets if file else ()
    if file is None or not sets:
        return sub
    content = file.member("resources/parameters.toml").read()
    tables = numbers(sub)
    shipped = tables["parameters"]
    built = padded(read(Path(str(file)), content)["parameters"], shipped)
    replaced = {}
    for s in sets:
        lists = {shipped[n].listed for n in s.shipped if n in shipped} - {""}  # shown in one row
        for n in (n for n in shipped if n in built and (n in s.shipped or shipped[n].listed in lists)):
            replaced[n] = replace(built[n], shipped=shipped[n].value, file=(s.file, s.sha256))
    return replace(sub, numbers={**tables, "parameters": {**tables["parameters"], **replaced}})


def _not_shipped(name: str, row: Sequence[Number]) -> str:
    """The file that a built value comes from, and the shipped value; empty for shipped values."""
    file = next((n.file[0] for n in row if n.shipped is not None), "")
    shipped = [replace(n, value=n.value if n.shipped is None else n.shipped, sd=None) for n in row]
    return f"; built with {file}, shipped: {row_value(name, shipped, _value)}" if file else ""


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
