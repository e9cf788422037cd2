"""The command `harvester variants`: which fidelity there is of each part, what it holds, what it costs."""

from __future__ import annotations

import shutil
import textwrap
from collections.abc import Iterator, Mapping

from fmus.contract import Subsystem, quantities
from fmus.machine.parts import FAMILIES

Costs = Mapping[tuple[str, str], float]  # (part, variant) -> time per step [us]


def names() -> list[tuple[str, str]]:
    """(part, variant) of all, the usual variant of each part first."""
    return [(part, variant) for part, variants in FAMILIES.items() for variant in variants]


def lines(costs: Costs) -> Iterator[str]:
    """The table as text; a variant that is not in `costs` shows none."""
    head = f"{'':<20}{'states':>8}{'inputs':>8}{'parameters':>12}{'us per 1 ms':>13}{'to the usual':>14}"
    for part, variants in FAMILIES.items():
        usual = next(iter(variants))
        yield f"{part:<20}{head[20:]}"
        for variant, sub in variants.items():
            label = f"  {variant}" + (" (usual)" if variant == usual else "")
            cost, base = costs.get((part, variant)), costs.get((part, usual))
            shown = "" if cost is None else f"{cost:.2f}"
            ratio = "" if cost is None or not base or base < LEAST else f"{cost / base:.2f}"
            yield f"{label:<20}{_sizes(sub)}{shown:>13}{ratio:>14}"
            for text in (sub.text, f"holds: {sub.validity}"):
                yield textwrap.fill(text, _columns(), initial_indent="    ", subsequent_indent="    ")
        yield ""


LEAST = 0.1  # us: below, a cost is that of the call


def _sizes(sub: Subsystem) -> str:
    counts = (len(quantities(group)) for group in (sub.states, sub.inputs, sub.parameters))
    return "".join(f"{n:>{width}}" for n, width in zip(counts, (8, 8, 12), strict=True))


def _columns() -> int:
    return min(110, shutil.get_terminal_size().columns)
