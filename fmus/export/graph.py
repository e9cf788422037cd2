"""The linear graph of a circuit as SVG, with the symbols of the paper's Figs. 2 and 3.

The supply line is on top, the return line at the bottom. Between them is a column of nodes for each neighbour
of the supply line, by their distance from it. What leads to the return line from further up is further
outside. The atmosphere has a mark wherever a branch leads to it. Branches between two columns are arcs. A
two-port has its mechanical side next to it. Places are complex numbers [px], the imaginary part downwards.
"""

import cmath
import math
import re
from itertools import combinations, pairwise, product
from typing import Any

from fmus.components.circuit import GROUND, SUPPLY, TANK, Branch, Circuit, Kind
from fmus.contract import Subsystem, symbols
from fmus.export.c_code import TEMPLATES
from orchestrator.base.text import rendered

Item = tuple[str, Branch]
TOP = (SUPPLY, "supply_pressure")  # the lines, in drives and in supplies
BOTTOM = ("reservoir_pressure", TANK, "tank_pressure")
# heights of a row, a short branch, a piston; the nearest lane, half the space of an actuator, between arcs
ROW, SHORT, PISTON, LANE, HALF, ARC = 100.0, 66.0, 98.0, 55.0, 160.0, 30.0
_PART = re.compile(r"([^_\s,]+)(?:_([^\s]*[^\s,]))?|([\s,]+)")  # symbol, its index, separator


def graphs(sub: Subsystem) -> dict[str, str]:
    """The graphs of a subsystem by the names of its circuits."""
    circuits = sub.circuits(symbols(sub.states), symbols(sub.inputs), symbols(sub.parameters))
    return {name: svg(circuit, f"Linear graph: {name}, {sub.variant}") for name, circuit in circuits.items()}


def svg(circuit: Circuit, title: str) -> str:
    """The graph with its legend; it needs no other file and follows the colour scheme of the page."""
    graph = _Graph(circuit)
    graph.draw()
    return rendered(TEMPLATES / "graph.svg.j2", escaped=True, title=title, split=_PART.findall, **vars(graph))


def _width(item: Item) -> float:
    """Width [px] of the label of a branch, at most."""
    parts = _PART.findall(item[1].symbol or item[0])
    return sum(9.0 * len(base) + 6.5 * len(index) + 4.5 * len(rest) for base, index, rest in parts)


def _xy(at: complex) -> str:
    return f"{at.real:g} {at.imag:g}"


class _Graph:
    """A circuit, the places of its nodes, and what is drawn so far."""

    def __init__(self, circuit: Circuit) -> None:
        self.circuit = circuit
        self.top, self.bottom = (next((n for n in of if n in circuit.nodes), "") for of in (TOP, BOTTOM))
        self.columns = self._columns()
        self.driven = any(b.mechanics for b in circuit.branches.values())
        self.rows = [50 + ROW * r for r in range(max(map(len, self.columns), default=0) + 1)]
        self.rows.append(self.rows[-1] + ROW * (1.5 if self.driven else 1))
        self.right = 100.0
        self.at: dict[str, complex] = {}
        self.off: dict[str, float] = {}  # of branches to the return line, from their column
        for k, column in enumerate(self.columns):
            self._place(k, column)
        self.branches: list[dict[str, Any]] = []
        self.dots, self.grounds, self.lines, self.motors, self.cylinders = (list[Any]() for _ in range(5))

    def between(self, a: str, b: str) -> list[Item]:
        """The branches that join two nodes, two-ports first."""
        found = [(n, v) for n, v in self.circuit.branches.items() if {v.start, v.end} == {a, b}]
        return sorted(found, key=lambda item: not item[1].mechanics)

    def _columns(self) -> list[list[str]]:
        """Nodes by column, from the supply line on."""
        placed, columns = {self.bottom, GROUND}, list[list[str]]()
        for first in (self.top, *self.circuit.nodes):
            queue = [(first, list[str]())]
            for n, column in queue:  # grows meanwhile
                if n not in placed:
                    placed.add(n)
                    if n != self.top:
                        columns += [] if column else [column]
                        column.append(n)
                    ends = [(b.start, b.end) for b in self.circuit.branches.values() if n in (b.start, b.end)]
                    queue += [(e, [] if n == self.top else column) for pair in ends for e in pair]
        return columns

    def _place(self, k: int, column: list[str]) -> None:
        """A column to the right of those before; the outside of the first one is at its left."""
        own = [i for i in self.circuit.branches.items() if {i[1].start, i[1].end} & {*column}]
        inside = max(HALF * self.driven, LANE + 24 + max(map(_width, own), default=0))
        outside = LANE + 24 + max(_width(self._stored(n)) for n in column)
        for node in reversed(column):
            for j, item in enumerate(self.between(node, self.bottom)):
                straight = j == 0 and node == column[-1]
                self.off[item[0]] = 0 if straight else outside
                outside += 0 if straight else max(40, _width(item) + 24)
        left, right = (inside, outside) if k else (outside, inside)
        self.at |= {n: complex(self.right + left, self.rows[r]) for r, n in enumerate(column, 1)}
        self.right += left + right

    def _stored(self, name: str) -> Item:
        """The branch from a node to the atmosphere that its oil is, or its given pressure."""
        node = self.circuit.nodes[name]
        kind = Kind.GIVEN if node.capacitance is None else Kind.CAPACITANCE
        return name, Branch(name, GROUND, kind, 0, node.symbol)

    def branch(self, item: Item, path: str, head: complex, way: complex, label: complex, side: int) -> None:
        """A branch, its head at a place in a direction, its label right (1), left (-1) or above."""
        name, b = item
        text = (*_xy(label).split(), ("middle", "start", "end")[side], b.symbol or name)
        turn = (*_xy(head).split(), f"{math.degrees(cmath.phase(way)):g}")
        self.branches.append({"name": name, "kind": b.kind.value, "path": path, "head": turn, "text": text})

    def lane(self, item: Item, of: str, a: complex, b: complex, side: int) -> None:
        """From node `of` at a with a bend straight to b, the label on this side."""
        s, short = math.copysign(1, (b - a).imag), abs((b - a).imag) < ROW
        bend, at = f"Q{b.real:g} {a.imag + s * 20:g} {b.real:g} {a.imag + s * 40:g}", 52.0 if short else 82.0
        if a.real == b.real:
            bend, at = "", abs(b - a) / 2 if short else abs(b - a) - 24
        head, way = complex(b.real, a.imag + s * at), 1j * s * (1 if item[1].start == of else -1)
        self.branch(item, f"M{_xy(a)}{bend}L{_xy(b)}", head, way, head + 10 * side + 5j, side)
        if GROUND in (item[1].start, item[1].end):
            self.grounds.append(_xy(b))

    def arc(self, item: Item, of: str, a: complex, b: complex, bulge: float, side: int) -> str:
        """From node `of` at a to b, its middle `bulge` to the left of that way. The middle."""
        left, t = -1j * (b - a) / abs(b - a), 0.5 if side else 0.35
        middle, c = (a + b) / 2 + bulge * left, (a + b) / 2 + 2 * bulge * left
        head, way = (1 - t) ** 2 * a + 2 * t * (1 - t) * c + t**2 * b, (1 - t) * (c - a) + t * (b - c)
        way *= 1 if item[1].start == of else -1
        self.branch(
            item, f"M{_xy(a)}Q{_xy(c)} {_xy(b)}", head, way, middle + (10 * side + 5j if side else -8j), side
        )
        return _xy(middle)

    def draw(self) -> None:
        """Columns, what joins them, lines."""
        for k, column in enumerate(self.columns):
            self.column(column, 1 if k else -1)
        for a, b in (pair for sides in combinations(self.columns, 2) for pair in product(*sides)):
            for k, item in enumerate(self.between(a, b)):
                middle = self.arc(item, a, self.at[a], self.at[b], ARC * k, 0)
                self.motors += [(middle, *item[1].mechanics)] if item[1].mechanics else []
        pistons = [(n, i[1]) for n in self.at for i in self.between(GROUND, n) if i[1].mechanics]
        for (a, branch), (b, _) in pairwise(pistons):
            half = (self.at[b] - self.at[a]) / 2
            self.cylinders.append((_xy(self.at[a] + half), half.real - LANE, *branch.mechanics))
        for a, b in ((self.top, self.bottom), (self.top, GROUND), (self.bottom, GROUND)):
            for item in self.between(a, b):
                at = complex(self.right + 20, self.rows[0 if a == self.top else -1])
                to = complex(at.real, at.imag + SHORT if b == GROUND else self.rows[-1])
                self.lane(item, a, at, to, 1)
                self.right += max(40, _width(item) + 24)
        for name, y in ((self.top, self.rows[0]), (self.bottom, self.rows[-1])):
            self.lines.append((name.replace("_", " "), f"{y:g}"))
            if name and self.circuit.nodes[name].symbol:
                self.lane(self._stored(name), name, complex(45, y), complex(45, y + SHORT), 1)

    def column(self, column: list[str], out: int) -> None:
        """The nodes and branches of a column; out: direction of its outside."""
        x, chain = self.at[column[0]].real, [self.top, *column]
        for (i, a), (j, b) in combinations(enumerate(chain), 2):
            for k, item in enumerate(self.between(a, b)):
                ends, beside = (complex(x, self.rows[i]), complex(x, self.rows[j])), 60 * (k + (j > i + 1))
                self.arc(item, a, *ends, -out * beside, -out)
        for name in column:
            at, stored = self.at[name], self._stored(name)
            for item in self.between(name, self.bottom):
                off = self.off[item[0]]
                self.lane(item, name, at, complex(x + out * off, self.rows[-1]), out if off else -out)
            for k, item in enumerate(self.between(GROUND, name), 1):
                to = at - out * k * LANE + 1j * (PISTON if item[1].mechanics else SHORT)
                self.lane(item, name, at, to, -out)
            symbol = stored[1].symbol
            if stored[1].kind is Kind.CAPACITANCE:
                self.lane(stored, name, at, at + complex(out * LANE, SHORT), out)
                symbol = "P_" + symbol.replace("_", "")
            self.dots.append((name, *_xy(at).split(), _xy(at + 9 * out - 10j).split(), out, symbol))
