"""The connected machine in every tool, with the rate ports wired and open."""

from __future__ import annotations

import zipfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from lxml import etree

from benchmarks.matrix.cells import percent, remark, two
from benchmarks.matrix.present import PARTS, Master, Tool
from benchmarks.matrix.running import Outcome, Rows, carried_out
from fmus.machine.build import data
from fmus.machine.machine import Connections
from fmus.machine.parts import FERIC

STEP, CYCLE = 1e-3, 42.0  # s
WIRES = FERIC.connections + FERIC.operator_wires + FERIC.supply_wires
RATES = ("_rate", "_acceleration")
OPEN_WIRES: Connections = tuple(wire for wire in WIRES if not wire[1].endswith(RATES))
JOINTS = ("swing", "boom", "stick")
SIGNALS = (
    *(f"manipulator.{j}_{kind}" for kind in ("speed", "angle") for j in JOINTS),
    *("swing.swing_pressure_a", "swing.swing_pressure_b"),
    *(f"boom_stick.{a}_{side}_pressure" for a in ("boom", "stick") for side in ("head", "rod")),
)
KINDS = ("speed", "angle", "pressure")
LOST = 1.0  # an error as large as the range of the signal: nothing is left to compare
DIVERGES = "diverges"
WIRED, OPEN = "wired", "open"
HEAD = (
    "tool",
    "FMI",
    "master",
    "rate ports",
    "joint speed [%]",
    "joint angle [%]",
    "pressure [%]",
    "times real time, or what happens",
)
RATE_HEAD = ("tool", "master", "rate ports connected [%]", "rate ports open [%]", "advice")


@dataclass(frozen=True)
class Row:
    """One system in one tool: the errors by kind of signal, or why there are none."""

    tool: str
    fmi: int
    master: str
    rates: str
    remark: str
    errors: Mapping[str, float] | None = None

    @property
    def cells(self) -> tuple[str, ...]:
        """For the table."""
        shown = [percent(self.errors[kind]) if self.errors else "" for kind in KINDS]
        return (self.tool, f"{self.fmi}.0", self.master, self.rates, *shown, self.remark)

    @property
    def speed(self) -> str:
        """The error of the joint speeds, or what happens."""
        return percent(self.errors["speed"]) if self.errors else self.remark


# ---- rate ports


def held(system: Path, folder: Path) -> Path:
    """A copy of an SSP without the connections to rate ports."""
    target = folder / "held" / system.name
    target.parent.mkdir(exist_ok=True)
    with zipfile.ZipFile(system) as old, zipfile.ZipFile(target, "w") as new:
        for name in old.namelist():
            content = old.read(name)
            new.writestr(name, without_rates(content) if name == "SystemStructure.ssd" else content)
    return target


def without_rates(structure: bytes) -> bytes:
    """An SSD without the connections to rate ports; there must be as many as the machine has."""
    root = etree.fromstring(structure)
    found = [c for c in root.iter("{*}Connection") if c.get("endConnector", "").endswith(RATES)]
    expected = len(WIRES) - len(OPEN_WIRES)
    if len(found) != expected:
        raise ValueError(f"{len(found)} connections to rate ports, expected {expected}")
    for connection in found:
        connection.getparent().remove(connection)
    return bytes(etree.tostring(root, xml_declaration=True, encoding="UTF-8"))


# ---- accuracy


@cache
def reference() -> Rows:
    """The work cycle of the monolithic solution."""
    with data("reference/work_cycle.csv").open(encoding="utf-8") as file:
        names = file.readline().strip().split(",")
        return dict(zip(names, np.loadtxt(file, delimiter=",").T, strict=True))


def errors(rows: Rows) -> dict[str, float]:
    """Worst NRMSE over the range of the reference by kind of signal, as far as the rows are finite."""
    truth, found = reference(), dict.fromkeys(KINDS, 0.0)
    finite = np.logical_and.accumulate(np.all([np.isfinite(c) for c in rows.values()], axis=0))
    time = rows["time"][finite]
    if not time.size:
        return found
    on = (truth["time"] >= time[0] - 1e-9) & (truth["time"] <= time[-1] + 1e-9)
    for name in SIGNALS if on.any() else ():
        exact = truth[name]
        with np.errstate(over="ignore"):
            square = np.mean((np.interp(truth["time"][on], time, rows[name][finite]) - exact[on]) ** 2)
        kind = next(k for k in KINDS if k in name)
        found[kind] = max(found[kind], float(np.sqrt(square) / np.ptp(exact)))
    return found


def judged(found: Outcome, stop: float = CYCLE) -> tuple[str, Mapping[str, float] | None]:
    """The speed and the errors of a run; or what happened, and no errors."""
    if found.problem:
        return remark(found.problem), None
    worst = errors(found.rows)
    if max(worst.values()) > LOST:
        return DIVERGES, None
    problem = found.until(stop).problem
    return (remark(problem), None) if problem else (two(stop / found.wall), worst)


# ---- tables


def systems(tools: Sequence[Tool], build: Path, folder: Path) -> Iterator[Row]:
    """Every tool with every master; in FMI 3.0, which gives the same, neither rates open nor orders of the FMUs."""
    for tool in tools:
        for fmi in tool.systems:
            for master in (m for m in tool.masters if fmi == 2 or not m.order):
                for rates in (WIRED, OPEN) if fmi == 2 and master.method else (WIRED,):
                    said, worst = judged(_run(tool, build, folder, fmi, master, rates))
                    yield Row(tool.name, fmi, master.name, rates if master.method else "", said, worst)


def _run(tool: Tool, build: Path, folder: Path, fmi: int, master: Master, rates: str) -> Outcome:
    """One system in one tool."""
    source = build / ("fmi3" if fmi == 3 else "") / "harvester.ssp"
    try:
        path = source if rates == WIRED else held(source, folder)
    except (OSError, zipfile.BadZipFile, etree.XMLSyntaxError, ValueError) as problem:
        return Outcome({}, 0.0, f"{source.name}: {problem}")
    return carried_out(
        tool,
        folder,
        path=str(path),
        parts={n: str(source.parent / f"{n}.fmu") for n in master.order or PARTS},
        wires=WIRES if rates == WIRED else OPEN_WIRES,
        master=master.method,
        ordered=bool(master.order),
        **{"fmi": fmi, "stop": CYCLE, "step": STEP, "record": SIGNALS},
    )


def by_tool(rows: Sequence[Row]) -> list[tuple[str, ...]]:
    """Error of the joint speeds with and without rate ports, FMI 2.0, and what follows."""
    found: dict[tuple[str, str], dict[str, Row]] = {}
    for row in rows:
        if row.fmi == 2 and row.rates:
            found.setdefault((row.tool, row.master), {})[row.rates] = row
    return [(*key, *_compared(pair.get(WIRED), pair.get(OPEN))) for key, pair in found.items()]


def _compared(wired: Row | None, open_: Row | None) -> tuple[str, ...]:
    """Both cells, and which is better, if both were measured."""
    shown = tuple(row.speed if row else "" for row in (wired, open_))
    known = [row for row in (wired, open_) if row and (row.errors or row.remark == DIVERGES)]
    if len(known) < 2:
        return (*shown, "not measured")
    if shown[0] == shown[1]:
        return (*shown, "neither works" if shown[0] == DIVERGES else "no difference")
    first, second = (row.errors["speed"] if row.errors else np.inf for row in known)
    return (*shown, "connect" if first < second else "leave open")
