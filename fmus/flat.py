"""Flat names for the variables of several subsystems that become one.

A variable keeps its name where no other component shows the same, else it gets its component in front.
Parameters that several components declare alike, down to the text (but for the heading), and to which they
give the same value, are one thing and have one name; so have the outputs of which the sum is shown.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping
from dataclasses import replace

from fmus.contract import ModelError, Quantity, Subsystem, quantities
from fmus.parameters import Tables

Names = Mapping[str, str]  # `component.variable` -> name


def declared(subsystems: Mapping[str, Subsystem], group: str) -> dict[str, Quantity]:
    """All variables of one group, by `component.variable`."""
    return {
        f"{component}.{name}": quantity
        for component, sub in subsystems.items()
        for name, quantity in quantities(getattr(sub, group)).items()
    }


def flat_names(
    subsystems: Mapping[str, Subsystem],
    tables: Mapping[str, Tables],
    taken: Collection[str],
    totals: Collection[str],
    hidden: Collection[str],
) -> Names:
    """Names of parameters, states and outputs, but `hidden` ones; those in `taken` belong to others."""
    parameters, states, outputs = (declared(subsystems, g) for g in ("parameters", "states", "outputs"))
    unknown = set(hidden) - set(outputs)
    if unknown:
        raise ModelError(f"{min(unknown)} is hidden, expected an output of {', '.join(subsystems)}")
    visible = [v for v in outputs if v not in hidden]
    own = {v: v.partition(".")[2] for v in [*parameters, *states, *visible]}
    merged = _common(parameters, tables) | {v for v in visible if own[v] in totals}
    single = [v for v in own if v not in merged]
    others = [*taken, *{own[v] for v in merged}]
    seen = Counter([*others, *(own[v] for v in single)])
    names = own | {v: v.replace(".", "_") for v in single if seen[own[v]] > 1}
    seen = Counter([*others, *(names[v] for v in single)])
    twice = sorted(name for name, count in seen.items() if count > 1)
    if twice:
        raise ModelError(f"{', '.join(subsystems)}: {twice[0]} would name two variables of the whole")
    return names


def _common(parameters: Mapping[str, Quantity], tables: Mapping[str, Tables]) -> set[str]:
    """Parameters that stand for the same thing in several components."""
    alike: dict[str, list[str]] = {}
    for v in parameters:
        alike.setdefault(v.partition(".")[2], []).append(v)

    def meaning(v: str) -> tuple[Quantity, float]:
        component, _, name = v.partition(".")
        return replace(parameters[v], group=""), tables[component]["parameters"][name].value

    return {
        v for group in alike.values() if len(group) > 1 and len({*map(meaning, group)}) == 1 for v in group
    }
