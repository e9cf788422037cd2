"""Where the energy of a run went: from the engine over pumps and functions to the load.

The ends of the names of signals tell what they are; a function is an axis of a drive:

    FUNCTION_hydraulic_power, FUNCTION_mechanical_power   [W] into a function, and on its load
    FUNCTION_CAUSE_heat, CAUSE_heat                       [W] heat of a function, and of a supply
    engine_power                                          [W] into a supply
    stored_energy, convected_power                        [J] and [W] of oil, in components with the above

Powers are integrated over the samples by the trapezoidal rule.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import chain, repeat
from typing import Any

import numpy as np

from orchestrator.base.errors import Problem
from orchestrator.base.text import TextTable, number, percentage, short_names
from orchestrator.data.trace import Trace
from orchestrator.pages.figures import PALETTE, TraceFigure, TracePanel, bars
from orchestrator.results.report import Figure, Part, Report, Section, Table, Text

TAKEN, GIVEN, HEAT, ENGINE = "_hydraulic_power", "_mechanical_power", "_heat", "engine_power"
SEEN = 1e-3  # of the longest bar
LAST = {"load": 1, "stored": 2, "remainder": 3}  # after the heat


@dataclass(frozen=True)
class Energy:
    """Energies of a run [J].

    engine           into the supplies; without a supply, into the functions
    supplied, load   by function: from the supply line less that into the return line; to the load
    heat             by function or supply, then by cause
    stored           more in oil, rotation and tank at the end, less what oil took along into the cylinders
    """

    engine: float
    supplied: Mapping[str, float]
    load: Mapping[str, float]
    heat: Mapping[str, Mapping[str, float]]
    stored: float

    @property
    def remainder(self) -> float:
        """What is left of the engine's energy: errors of the coupling and of the integration."""
        return self.engine - sum(self.load.values()) - self.all_heat - self.stored

    @property
    def all_heat(self) -> float:
        """Heat of supplies and functions."""
        return sum(sum(causes.values()) for causes in self.heat.values())

    def of(self, function: str) -> dict[str, float]:
        """What became of the energy into a function."""
        found = dict(self.heat.get(function, {})) | {"load": self.load[function]}
        return found | {"stored": self.supplied[function] - sum(found.values())}

    def of_engine(self) -> dict[str, float]:
        """What became of the engine's energy: heat of supplies, then energy into functions."""
        of_supplies = [causes for owner, causes in self.heat.items() if owner not in self.supplied]
        heat = {cause: sum(c.get(cause, 0.0) for c in of_supplies) for c in of_supplies for cause in c}
        return heat | dict(self.supplied)


def energy(trace: Trace, name: str) -> Energy:
    """The energies of a trace; name: in messages."""

    def integral(signal: str) -> float:
        found = float(np.trapezoid(trace[signal], trace.time))
        if not math.isfinite(found):
            raise Problem(f"{name}: {signal}: expected finite values, got {found}")
        return found

    functions = [n.removesuffix(TAKEN) for n in trace if n.endswith(TAKEN)]
    engines = [n for n in trace if n.rpartition(".")[2] == ENGINE]
    components = {n.rpartition(".")[0]: n for n in (*functions, *engines)}
    heats = [n for n in trace if n.endswith(HEAT) and n.rpartition(".")[0] in components]
    if not functions or not heats:
        expected = f"signals NAME{TAKEN}, NAME{GIVEN} and NAME{HEAT} of drives"
        raise Problem(f"{name}: expected {expected}, got none; run again with FMUs of now and all outputs")
    labels, heat = short_names(functions), dict[str, dict[str, float]]()
    for n in heats:
        component, _, cause = n.rpartition(".")
        of = max((f for f in functions if n.startswith(f"{f}_")), key=len, default="")
        owner, cause = (labels[of], n[len(of) + 1 :]) if of else (component, cause)
        heat.setdefault(owner, {})[cause.removesuffix(HEAT).replace("_", " ")] = integral(n)
    supplied = {labels[f]: integral(f + TAKEN) for f in functions}
    stored = [trace[n] for c in components if (n := f"{c}.stored_energy") in trace]
    convected = [integral(n) for c in components if (n := f"{c}.convected_power") in trace]
    return Energy(
        engine=sum(map(integral, engines)) if engines else sum(supplied.values()),
        supplied=supplied,
        load={labels[f]: integral(f + GIVEN) for f in functions},
        heat=heat,
        stored=float(sum(e[-1] - e[0] for e in stored)) - sum(convected),
    )


def _rows(e: Energy) -> Iterator[tuple[tuple[str, str], float]]:
    """Owner and item, and its energy [J]."""
    yield ("engine", ""), e.engine
    for owner in (*e.heat, *(f for f in e.supplied if f not in e.heat)):
        items = e.of(owner) if owner in e.supplied else e.heat[owner]
        yield (owner, "supplied" if owner in e.supplied else "heat"), sum(items.values())
        yield from (((owner, item), value) for item, value in items.items())
    total = {"heat": e.all_heat, "load": sum(e.load.values()), "stored": e.stored, "remainder": e.remainder}
    yield from ((("total", item), value) for item, value in total.items())


def table(energies: Mapping[str, Energy]) -> TextTable:
    """Energies of runs side by side, their shares of the engine's, and differences from the first run.

    Rows that are zero in all runs to the digits of the table are left out.
    """
    found, runs = [dict(_rows(e)) for e in energies.values()], list(energies.values())
    functions, largest = {f for e in runs for f in e.supplied}, max(abs(e.engine) for e in runs) or 1.0
    digits = max(0, 5 - math.ceil(math.log10(largest / 1e3)))

    def place(key: tuple[str, str]) -> tuple[int, int, int]:
        """Supplies before functions; what every function has after its heat."""
        kind = {"engine": 0, "total": 3}.get(key[0], 1 + (key[0] in functions))
        return kind, [owner for owner, _ in keys].index(key[0]), LAST.get(key[1], 0)

    def text(joule: float) -> str:
        return f"{joule / 1e3:z.{digits}f}"

    keys = list(dict.fromkeys(chain(*found)))
    rows, above = list[list[str]](), ""
    for key in sorted(keys, key=place):
        values = [of.get(key, 0.0) for of in found]
        if key[1] != "remainder" and not any(float(text(v)) for v in values):
            continue
        row = ["" if key[0] == above else key[0], key[1]]
        for e, of, v in zip(runs, found, values, strict=True):
            share = number(100 * v / (e.engine or math.nan), 3)
            row += (
                [number(v / 1e3, 2) if key[1] == "remainder" else text(v), share] if key in of else ["-"] * 2
            )
        rows.append(row + [text(v - values[0]) for v in values[1:]])
        above = key[0]
    first, *others = energies
    head = ["", "", *chain(*((f"{label} [kJ]", "[%]") for label in energies))]
    return TextTable([*head, *(f"{other} - {first}" for other in others)], rows, left=(0, 1))


def report(energies: Mapping[str, Energy], unreliable: Sequence[str] = ()) -> Report:
    """Where the energy of each run went; unreliable: why runs are not reliable."""
    to_load = {n: sum(e.load.values()) / e.engine for n, e in energies.items() if e.engine}
    kilojoules = {n: number(energies[n].engine / 1e3, 4) for n in to_load}
    told = [f"{n}: {kilojoules[n]} kJ, {percentage(share)} to the load" for n, share in to_load.items()]
    runs = {label: asdict(e) | {"remainder": e.remainder} for label, e in energies.items()}
    drawn = [Figure(figure(energies), "Energy")] if told else []
    parts: list[Part] = [
        Text(unreliable, "warn"),
        *drawn,
        Section("Numbers", [Table(table(energies))], only=""),
    ]
    verdict = "; ".join(told) or "no energy came from the engine"
    return Report("Energy", verdict, parts, {"runs": runs, "unreliable": unreliable})


def figure(energies: Mapping[str, Energy]) -> TraceFigure:
    """Bars: what became of the engine's energy, and below of that of each function, run by run."""
    functions = list(dict.fromkeys(f for e in energies.values() for f in e.supplied))
    runs = energies.items()
    of_engine = {("engine", n): (e.engine, e.of_engine()) for n, e in runs}
    of_functions = {(f, n): (e.supplied[f], e.of(f)) for f in functions for n, e in runs if f in e.supplied}
    shown = {"engine": _seen(of_engine), "functions": _seen(of_functions)}
    every = chain(*(items.items() for of in shown.values() for _, items in of.values()))
    ranked = dict.fromkeys(item for item, _ in sorted(every, key=lambda pair: -abs(pair[1])))
    light, dark = zip(*PALETTE.pairs, strict=True)
    free = chain((*PALETTE.series[:5], *light, *dark), repeat(PALETTE.soft))  # the smallest ones are grey
    colours = {item: next(free) for item in ranked if item not in LAST}
    colours |= {"load": PALETTE.ink, "stored": PALETTE.faint, "remainder": PALETTE.grid}
    panels = []
    for title, of in shown.items():
        spans, words = dict[str, list[tuple[float, float, float]]](), dict[float, str]()
        for row, ((name, run), (total, items)) in enumerate(of.items()):
            words[-row] = f"{name if len(energies) == 1 else f'{name}, {run}'}: {number(total, 4)}"
            ends = [0.0, 0.0]  # of what is negative, and of what is positive
            for item, value in items.items():
                begin = ends[value > 0]
                ends[value > 0] += value
                spans.setdefault(item, []).append((-row, begin, begin + value))
        lines = [bars(of_item, 0.4, colours[item], item) for item, of_item in spans.items()]
        panels.append(TracePanel("", lines, title, heights=(0.7 * len(of) + 0.6, 0.0), words=words))
    return TraceFigure(panels, title=", ".join(energies), axis="energy [kJ]")


def _seen(bars: Mapping[tuple[str, str], tuple[float, dict[str, float]]]) -> dict[Any, Any]:
    """Bars in kJ, without what is too small to be seen."""
    least = SEEN * max(total for total, _ in bars.values())
    return {
        key: (total / 1e3, {item: v / 1e3 for item, v in items.items() if abs(v) > least})
        for key, (total, items) in bars.items()
    }
