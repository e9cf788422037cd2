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
from itertools import chain, cycle
from typing import TYPE_CHECKING, Any

import numpy as np

from orchestrator.base.errors import Problem
from orchestrator.base.text import TextTable, number, percentage, short_names
from orchestrator.data.trace import Trace
from orchestrator.pages.figures import PALETTE
from orchestrator.results.report import Part, Report, Table, Text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

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
    parts: list[Part] = [Text(unreliable, "warn"), Table(table(energies))]
    verdict = "; ".join(told) or "no energy came from the engine"
    return Report("Energy", verdict, parts, {"runs": runs, "unreliable": unreliable})


def draw(energies: Mapping[str, Energy]) -> Figure:
    """Bars: what became of the engine's energy, and below of that of each function, run by run."""
    from orchestrator.pages.plotting import WIDTH, heading, legend, new_figure, style_axes

    functions = list(dict.fromkeys(f for e in energies.values() for f in e.supplied))
    runs = energies.items()
    above = {("engine", n): (e.engine, e.of_engine()) for n, e in runs}
    below = {(f, n): (e.supplied[f], e.of(f)) for f in functions for n, e in runs if f in e.supplied}
    figure = new_figure(WIDTH, 2.1 + 0.3 * (len(above) + len(below)))
    panels = figure.subplots(2, 1, height_ratios=(len(above) + 0.3, len(below) + 0.3))
    bars = {axes: _seen(of) for axes, of in zip(panels, (above, below), strict=True)}
    named = [item for of in (bars[panels[1]], bars[panels[0]]) for _, items in of.values() for item in items]
    causes = [c for c in dict.fromkeys(named) if c not in LAST and c not in functions]
    light, dark = zip(*PALETTE.pairs, strict=True)
    colours = dict(zip(causes, cycle((*PALETTE.series[:5], *light, *dark)), strict=False))
    colours |= {"load": PALETTE.ink, "stored": PALETTE.faint}
    for axes, of in bars.items():
        style_axes(axes, x="energy [kJ]")
        axes.grid(False, axis="y")
        for row, (total, items) in enumerate(of.values()):
            ends = [0.0, 0.0]  # of what is negative, and of what is positive
            for item, value in items.items():
                style = {"color": colours.get(item, PALETTE.grid), "edgecolor": "white", "linewidth": 0.5}
                axes.barh(row, value, 0.8, ends[value > 0], label=item, **style)
                if item in functions:
                    axes.text(ends[value > 0] + value / 2, row, item, ha="center", va="center", fontsize=7)
                ends[value > 0] += value
            axes.text(ends[1], row, f" {number(total, 4)}", va="center", fontsize=8, color=PALETTE.ink)
        axes.set_yticks(range(len(of)), [name if len(runs) == 1 else f"{name}, {run}" for name, run in of])
        axes.invert_yaxis()
    drawn = {c: h for axes in panels for h, c in zip(*axes.get_legend_handles_labels(), strict=True)}
    legend(figure, handles=[drawn[c] for c in colours if c in drawn], loc="outside lower left", ncols=7)
    heading(figure, ", ".join(energies))
    return figure


def _seen(bars: Mapping[tuple[str, str], tuple[float, dict[str, float]]]) -> dict[Any, Any]:
    """Bars in kJ, without what is too small to be seen."""
    least = SEEN * max(total for total, _ in bars.values())
    return {
        key: (total / 1e3, {item: v / 1e3 for item, v in items.items() if abs(v) > least})
        for key, (total, items) in bars.items()
    }
