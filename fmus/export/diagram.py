"""The diagram of a system: where components, their connectors and the bends of the wires are [mm], y up.

Components stand in columns. A connector is on the side of the column its wire leads to, and at the height of
the connector it is wired to where that is free, so that most wires are straight and none crosses a component.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from fmus.export.ssp_structure import Structure, split

WIDTH, GAP, PITCH = 70.0, 50.0, 5.0  # of components, between columns, between connectors
Point = tuple[float, float]


@dataclass
class Box:
    """A component: its column, and the heights of the connectors on its left (0) and right (1) side."""

    column: int
    sides: tuple[dict[str, float], dict[str, float]] = field(default_factory=lambda: ({}, {}))
    bottom: float = 0.0
    top: float = 0.0

    @property
    def corners(self) -> tuple[float, float, float, float]:
        """x1, y1, x2, y2."""
        left = self.column * (WIDTH + GAP)
        return left, self.bottom, left + WIDTH, self.top

    def connector(self, name: str) -> Point:
        """Place of a connector, in a frame that has its corners at (0, 0) and (1, 1)."""
        side = int(name in self.sides[1])
        return float(side), (self.sides[side][name] - self.bottom) / (self.top - self.bottom)

    def absolute(self, name: str) -> Point:
        """Place of a connector in the diagram."""
        x1, _, x2, _ = self.corners
        side = int(name in self.sides[1])
        return (x1, x2)[side], self.sides[side][name]


def boxes(s: Structure) -> dict[str, Box]:
    """The places of all components; columns from left to right as given, else one for each component."""
    columns = s.columns or [[name] for name in s.elements]
    first = max(range(len(columns)), key=lambda i: len(columns[i]))  # the fullest column, then outwards
    order = [*range(first, len(columns)), *range(first - 1, -1, -1)]
    column_of = {name: i for i, names in enumerate(columns) for name in names}
    placed: dict[str, Box] = {}
    for i in order:
        ceiling = float("inf")
        for name in columns[i]:
            box = _box(s, name, column_of, placed, ceiling)
            placed[name] = box
            ceiling = box.bottom - 2 * PITCH
    return placed


def _box(
    s: Structure, name: str, column_of: Mapping[str, int], placed: Mapping[str, Box], ceiling: float
) -> Box:
    """A component below `ceiling`: connectors with placed peers at their heights, others under each other."""
    box = Box(column_of[name])
    top = 0.0 if ceiling == float("inf") else ceiling - PITCH
    for side, names in enumerate(_sides(s, name, column_of)):
        heights = box.sides[side]
        wanted = {v: y for v in names if (y := _peer(s, f"{name}.{v}", placed)) is not None and y <= top}
        for v, y in sorted(wanted.items(), key=lambda item: -item[1]):
            heights[v] = y if y not in heights.values() else min(heights.values()) - PITCH
        below = min(heights.values(), default=top + PITCH)
        for n, v in enumerate((v for v in names if v not in heights), start=1):
            heights[v] = below - n * PITCH
    levels = [y for heights in box.sides for y in heights.values()] or [top]
    box.bottom, box.top = min(levels) - PITCH, max(levels) + PITCH
    return box


def _sides(s: Structure, name: str, column_of: Mapping[str, int]) -> tuple[list[str], list[str]]:
    """Connectors on the left and on the right, those of one port beside each other."""
    element = s.elements[name]
    sides: tuple[list[str], list[str]] = ([], [])
    wired: list[str] = []
    for v in (*element.inputs, *element.outputs):
        towards = [column_of[c] - column_of[name] for c in _peers(s, f"{name}.{v}") if c in column_of]
        side = 1 if v in element.outputs else 0
        if towards and towards[0]:
            side = int(towards[0] > 0)
        sides[side].append(v)
        wired += [v] if towards else []
    stems = list(dict.fromkeys(v.partition("_")[0] for v in wired))
    for names in sides:
        names.sort(key=lambda v: (v not in wired, stems.index(v.partition("_")[0]) if v in wired else 0))
    return sides


def _ends(s: Structure, port: str) -> list[str]:
    return [b if a == port else a for a, b in s.wires if port in (a, b)]


def _peers(s: Structure, port: str) -> list[str]:
    """Components at the other ends of the wires of a connector."""
    return [split(end)[0] for end in _ends(s, port)]


def _peer(s: Structure, port: str, placed: Mapping[str, Box]) -> float | None:
    """The height of the first connector at the other end that is placed."""
    for component, name in map(split, _ends(s, port)):
        if component in placed:
            return placed[component].absolute(name)[1]
    return None


def bends(s: Structure, placed: Mapping[str, Box]) -> dict[tuple[str, str], list[Point]]:
    """The waypoints of each wire between components that is not straight.

    A wire turns in the gap beside each of its ends; one that passes a column does so below all components.
    """
    lane = {gap: 0 for gap in range(-1, len(placed) + 1)}
    floor = min(box.bottom for box in placed.values()) - PITCH
    bent = [w for w in s.wires if split(w[0])[0] in placed and not _straight(w, placed)]
    found = {}
    for wire in bent:
        turns = []
        for component, name in map(split, wire):
            box, (x, y) = placed[component], placed[component].absolute(name)
            gap = box.column if x > box.corners[0] else box.column - 1
            lane[gap] += 1
            turns.append((gap, (gap + 1) * (WIDTH + GAP) - GAP + lane[gap] * GAP / (2 * len(bent) + 1), y))
        (gap, x, y), (other, x2, y2) = turns
        if gap == other:
            found[wire] = [(x, y), (x, y2)]
        else:
            found[wire] = [(x, y), (x, floor), (x2, floor), (x2, y2)]
            floor -= PITCH / 2
    return found


def _straight(wire: Sequence[str], placed: Mapping[str, Box]) -> bool:
    a, b = (placed[split(end)[0]] for end in wire)
    heights = {box.absolute(split(end)[1])[1] for box, end in zip((a, b), wire, strict=True)}
    return len(heights) == 1 and abs(a.column - b.column) == 1
