"""Layout of a system's diagram: positions of components and connectors, bends of connections [mm]; y is up.

Components are arranged in columns. A connector is on the side of the column that its connection leads to, and
at the height of the connector at the other end if that height is free. So most connections are straight, and
none crosses a component.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from orchestrator.ssp.system import Port

WIDTH, GAP, PITCH = 70.0, 50.0, 5.0  # [mm]: width of a component, gap between columns, pitch of connectors
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
        """Position of a connector relative to the box, whose corners are (0, 0) and (1, 1)."""
        side = int(name in self.sides[1])
        return float(side), (self.sides[side][name] - self.bottom) / (self.top - self.bottom)

    def absolute(self, name: str) -> Point:
        """Position of a connector in the diagram."""
        x1, _, x2, _ = self.corners
        side = int(name in self.sides[1])
        return (x1, x2)[side], self.sides[side][name]


class Diagram:
    """The layout of a diagram.

    boxes   component -> its box
    bends   connection -> its waypoints, if it is not straight
    """

    def __init__(
        self,
        connectors: Mapping[str, tuple[Sequence[str], Sequence[str]]],
        connections: Sequence[tuple[Port, Port]],
        columns: Sequence[Sequence[str]] = (),
    ) -> None:
        """connectors: component -> inputs and outputs; columns: from the left; default: one per component."""
        self._connectors, self._connections = connectors, connections
        self.columns = columns or [[name] for name in connectors]
        self._column = {name: i for i, names in enumerate(self.columns) for name in names}
        self.boxes: dict[str, Box] = {}
        self._place()
        self.bends = self._bends()

    def _place(self) -> None:
        """Place all components, from the fullest column outwards."""
        columns = self.columns
        first = max(range(len(columns)), key=lambda i: len(columns[i]), default=0)
        for i in [*range(first, len(columns)), *range(first - 1, -1, -1)]:
            ceiling = float("inf")
            for name in columns[i]:
                self.boxes[name] = self._box(name, ceiling)
                ceiling = self.boxes[name].bottom - 2 * PITCH

    def _box(self, name: str, ceiling: float) -> Box:
        """The box of a component below `ceiling`; connectors have the heights of their placed peers."""
        box = Box(self._column[name])
        top = 0.0 if ceiling == float("inf") else ceiling - PITCH
        for heights, names in zip(box.sides, self._sides(name), strict=True):
            peer_heights = {
                v: y for v in names if (y := self._peer_height(Port(name, v))) is not None and y <= top
            }
            for v, y in sorted(peer_heights.items(), key=lambda item: -item[1]):
                heights[v] = y if y not in heights.values() else min(heights.values()) - PITCH
            below = min(heights.values(), default=top + PITCH)
            for n, v in enumerate((v for v in names if v not in heights), start=1):
                heights[v] = below - n * PITCH
        levels = [y for heights in box.sides for y in heights.values()] or [top]
        box.bottom, box.top = min(levels) - PITCH, max(levels) + PITCH
        return box

    def _sides(self, name: str) -> tuple[list[str], list[str]]:
        """Connectors on the left and on the right; those with the same stem are adjacent."""
        inputs, outputs = self._connectors[name]
        sides: tuple[list[str], list[str]] = ([], [])
        connected: list[str] = []
        for v in (*inputs, *outputs):
            peers = [p.component for p in self._peers(Port(name, v)) if p.component in self._column]
            towards = [self._column[peer] - self._column[name] for peer in peers]
            side = 1 if v in outputs else 0
            if towards and towards[0]:
                side = int(towards[0] > 0)
            sides[side].append(v)
            connected += [v] if towards else []
        stems = list(dict.fromkeys(v.partition("_")[0] for v in connected))
        for names in sides:  # connected ones by stem, then the others
            names.sort(key=lambda v: stems.index(v.partition("_")[0]) if v in connected else len(stems))
        return sides

    def _peers(self, port: Port) -> list[Port]:
        """The other ends of the connections of a connector."""
        return [b if a == port else a for a, b in self._connections if port in (a, b)]

    def _peer_height(self, port: Port) -> float | None:
        """The height of the first connector at the other end that is placed."""
        placed = [p for p in self._peers(port) if p.component in self.boxes]
        return self.boxes[placed[0].component].absolute(placed[0].variable)[1] if placed else None

    def _bends(self) -> dict[tuple[Port, Port], list[Point]]:
        """The waypoints of each connection that is not straight.

        A connection turns in the gap next to each of its ends. It passes other columns below all components.
        """
        lane = {gap: 0 for gap in range(-1, len(self.boxes) + 1)}
        floor = min((box.bottom for box in self.boxes.values()), default=0.0) - PITCH
        bent = [c for c in self._connections if not self._straight(*c)]
        bends = {}
        for connection in bent:
            turns = []
            for component, name in connection:
                box, (x, y) = self.boxes[component], self.boxes[component].absolute(name)
                gap = box.column if x > box.corners[0] else box.column - 1
                lane[gap] += 1
                lane_x = (gap + 1) * (WIDTH + GAP) - GAP + lane[gap] * GAP / (2 * len(bent) + 1)
                turns.append((gap, lane_x, y))
            (gap, x, y), (other, x2, y2) = turns
            if gap == other:
                bends[connection] = [(x, y), (x, y2)]
            else:
                bends[connection] = [(x, y), (x, floor), (x2, floor), (x2, y2)]
                floor -= PITCH / 2
        return bends

    def _straight(self, *ends: Port) -> bool:
        boxes = [self.boxes[end.component] for end in ends]
        heights = {box.absolute(end.variable)[1] for box, end in zip(boxes, ends, strict=True)}
        return len(heights) == 1 and abs(boxes[0].column - boxes[1].column) == 1
