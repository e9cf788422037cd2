"""Hydraulic symbols of ISO 1219-1 as SVG.

Coordinates in pixels, y downwards. A symbol is drawn at its centre; its connections are at the distances that
its docstring gives. Working lines are solid, pilot and drain lines dashed.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape

Point = tuple[float, float]
BOX = 36.0  # side of a valve's square
HALF = BOX / 2


class Sheet:
    """A drawing; `svg()` is its text."""

    def __init__(self, width: float, height: float, title: str) -> None:
        self.size, self.title = (width, height), title
        self.items: list[str] = []

    def svg(self) -> str:
        """The picture, in the colour of the text around it or dark on its own."""
        w, h = self.size
        head = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {w:g} {h:g}" width="{w:g}" '
        head += f'height="{h:g}" role="img" '
        head += 'font-family="Helvetica, Arial, sans-serif" font-size="11" fill="none" stroke="#222" '
        head += 'stroke-width="1.5" stroke-linecap="round" stroke-linejoin="round">'
        ground = f'<rect width="{w:g}" height="{h:g}" fill="#fff" stroke="none"/>'
        return "\n".join([head, f"<title>{escape(self.title)}</title>", ground, *self.items, "</svg>", ""])

    # ---- elements

    def line(self, points: Sequence[Point], pilot: bool = False, width: float = 1.5) -> None:
        """A polyline."""
        path = " ".join(f"{x:g},{y:g}" for x, y in points)
        dash = ' stroke-dasharray="5 3" stroke-width="1"' if pilot else f' stroke-width="{width:g}"'
        self.items.append(f'<polyline points="{path}"{dash}/>')

    def frame(self, x: float, y: float, width: float, height: float) -> None:
        """A rectangle with its upper left corner at (x, y)."""
        self.items.append(f'<rect x="{x:g}" y="{y:g}" width="{width:g}" height="{height:g}"/>')

    def group(self, x: float, y: float, width: float, height: float) -> None:
        """A dash-dotted frame around an assembly."""
        self.items.append(
            f'<rect x="{x:g}" y="{y:g}" width="{width:g}" height="{height:g}" '
            'stroke="#888" stroke-width="1" stroke-dasharray="8 3 2 3"/>'
        )

    def circle(self, x: float, y: float, r: float, filled: bool = False) -> None:
        """A circle."""
        self.items.append(f'<circle cx="{x:g}" cy="{y:g}" r="{r:g}"' + (' fill="#222"/>' if filled else "/>"))

    def triangle(self, points: Iterable[Point]) -> None:
        """A filled triangle."""
        path = " ".join(f"{x:g},{y:g}" for x, y in points)
        self.items.append(f'<polygon points="{path}" fill="#222" stroke="none"/>')

    def text(self, x: float, y: float, text: str, anchor: str = "start", colour: str = "#222") -> None:
        """Text; lines are separated by line feeds."""
        for k, part in enumerate(text.split("\n")):
            self.items.append(
                f'<text x="{x:g}" y="{y + 13 * k:g}" text-anchor="{anchor}" fill="{colour}" stroke="none">'
                f"{escape(part)}</text>"
            )

    def arrow(self, start: Point, end: Point, width: float = 1.5) -> None:
        """A line with a head at its end."""
        self.line([start, end], width=width)
        dx, dy = end[0] - start[0], end[1] - start[1]
        length = (dx**2 + dy**2) ** 0.5
        ux, uy = dx / length, dy / length
        base = end[0] - 7 * ux, end[1] - 7 * uy
        self.triangle([end, (base[0] - 3 * uy, base[1] + 3 * ux), (base[0] + 3 * uy, base[1] - 3 * ux)])

    def node(self, x: float, y: float) -> None:
        """A junction of lines."""
        self.circle(x, y, 2.5, filled=True)

    def spring(self, x: float, y: float, to: float, adjustable: bool = False, vertical: bool = False) -> None:
        """A spring from (x, y) to the coordinate `to` along x, or along y."""
        n, step = 6, (to - (y if vertical else x)) / 7
        zigzag = [(5.0 if k % 2 else -5.0) for k in range(1, n + 1)]
        along = [step * (k + 0.5) for k in range(1, n + 1)]
        if vertical:
            points = [(x, y), *((x + d, y + a) for d, a in zip(zigzag, along, strict=True)), (x, to)]
        else:
            points = [(x, y), *((x + a, y + d) for d, a in zip(zigzag, along, strict=True)), (to, y)]
        self.line(points, width=1)
        if adjustable:
            mx, my = (x, (y + to) / 2) if vertical else ((x + to) / 2, y)
            self.arrow((mx - 9, my + 9), (mx + 9, my - 9), width=1)

    # ---- symbols

    def tank(self, x: float, y: float) -> None:
        """Reservoir; the line ends at (x, y)."""
        self.line([(x - 11, y - 4), (x - 11, y + 6), (x + 11, y + 6), (x + 11, y - 4)])
        self.line([(x, y - 8), (x, y + 3)])

    def source(self, x: float, y: float) -> None:
        """Hydraulic energy source, an ideal one; the line starts at (x, y - 16)."""
        self.triangle([(x, y - 16), (x - 11, y + 4), (x + 11, y + 4)])

    def pump(self, x: float, y: float) -> None:
        """Variable displacement pump, outlet (x, y - 20), inlet (x, y + 20), shaft (x - 20, y)."""
        self.circle(x, y, 20)
        self.triangle([(x, y - 20), (x - 7, y - 9), (x + 7, y - 9)])
        self.arrow((x - 22, y + 22), (x + 23, y - 23), width=1)

    def motor(self, x: float, y: float) -> None:
        """Motor for both directions: ports (x, y - 20) and (x, y + 20), shaft (x + 20, y)."""
        self.circle(x, y, 20)
        for side in (-1, 1):  # the base is a chord of the circle
            self.triangle([(x, y + 8 * side), (x - 7, y + 18.7 * side), (x + 7, y + 18.7 * side)])

    def engine(self, x: float, y: float, label: str) -> None:
        """Combustion engine with the shaft at (x + 26, y)."""
        self.frame(x - 26, y - 16, 52, 32)
        self.text(x, y + 4, label, "middle")

    def check(self, x: float, y: float, direction: str) -> None:
        """Check valve with free flow "up", "down", "left" or "right"; connections at a distance of 9."""
        vx, vy = {"up": (0, -1), "down": (0, 1), "left": (-1, 0), "right": (1, 0)}[direction]
        self.circle(x + 2 * vx, y + 2 * vy, 5)
        seat = (x - 6 * vx, y - 6 * vy)
        for side in (1, -1):
            self.line([seat, (x + 3 * vx + 8 * side * vy, y + 3 * vy + 8 * side * vx)])
        self.line([(x - 9 * vx, y - 9 * vy), seat])
        self.line([(x + 7 * vx, y + 7 * vy), (x + 9 * vx, y + 9 * vy)])

    def relief(self, x: float, y: float, flow: str = "down", label: str = "") -> None:
        """Pressure relief valve; inlet and outlet at a distance of 22.

        flow   "down", "up": direction of the relieved flow
        """
        s = 1 if flow == "down" else -1
        self.frame(x - HALF, y - HALF, BOX, BOX)
        self.arrow((x - 7, y - 14 * s), (x - 7, y + 14 * s))
        self.line([(x, y - HALF * s), (x, y - 22 * s)])
        self.line([(x, y + HALF * s), (x, y + 22 * s)])
        self.line([(x, y - 21 * s), (x - 26, y - 21 * s), (x - 26, y), (x - HALF, y)], pilot=True)
        self.spring(x + HALF, y, x + 36, adjustable=True)
        if label:
            self.text(x + 40, y + 4, label)

    def shuttle(self, x: float, y: float) -> None:
        """Shuttle valve, which passes on the higher of two pressures.

        Inlets (x, y - 14) and (x, y + 14), outlet (x - 8, y).
        """
        self.frame(x - 8, y - 14, 16, 28)
        for side in (-1, 1):
            self.line([(x - 6, y + 7 * side), (x, y + 14 * side), (x + 6, y + 7 * side)], width=1)
        self.circle(x, y + 6, 4)

    def counterbalance(self, x: float, y: float) -> None:
        """Load-holding valve in a vertical line.

        Cylinder at (x, y - 30), valve at (x, y + 46), pilot at (x - 40, y + 8): a relief valve from the
        cylinder to the valve with a second pilot and a drained spring chamber, and a check valve past it.
        """
        self.frame(x - HALF, y - HALF, BOX, BOX)
        self.arrow((x - 7, y - 14), (x - 7, y + 14))
        self.line([(x, y - HALF), (x, y - 30)])
        self.line([(x, y + HALF), (x, y + 46)])
        self.line([(x, y - 24), (x - 26, y - 24), (x - 26, y - 8), (x - HALF, y - 8)], pilot=True)
        self.line([(x - 40, y + 8), (x - HALF, y + 8)], pilot=True)
        self.spring(x + HALF, y, x + 34, adjustable=True)
        self.line([(x + HALF, y + 14), (x + 31, y + 14), (x + 31, y + 20)], pilot=True)
        self.tank(x + 31, y + 28)
        self.line([(x, y - 26), (x + 54, y - 26), (x + 54, y - 1)])
        self.line([(x + 54, y + 17), (x + 54, y + 42), (x, y + 42)])
        self.check(x + 54, y + 8, "up")
        self.node(x, y - 26)
        self.node(x, y + 42)

    def compensator(self, x: float, y: float) -> None:
        """Pressure compensator in a vertical line that flows up: inlet (x, y + 18), outlet (x, y - 18).

        The pilot that closes comes from the outlet; the pilot with the spring ends at (x + 40, y).
        """
        self.frame(x - HALF, y - HALF, BOX, BOX)
        self.arrow((x, y + HALF), (x, y - HALF))
        self.line([(x, y - 24), (x - 26, y - 24), (x - 26, y), (x - HALF, y)], pilot=True)
        self.spring(x + HALF, y, x + 34)
        self.line([(x + 34, y), (x + 44, y)], pilot=True)
        self.line([(x, y - HALF), (x, y - 30)])

    def _closed_centre(self, x: float, top: float, bottom: float) -> None:
        for port in (-9, 9):
            self.line([(x + port, top), (x + port, top + 7)])
            self.line([(x + port - 4, top + 7), (x + port + 4, top + 7)])
            self.line([(x + port, bottom), (x + port, bottom - 7)])
            self.line([(x + port - 4, bottom - 7), (x + port + 4, bottom - 7)])

    def _bleeding_centre(self, x: float, top: float, bottom: float) -> None:
        """P closed; A and B to T, each through a restrictor."""
        self.line([(x - 9, bottom), (x - 9, bottom - 7)])
        self.line([(x - 13, bottom - 7), (x - 5, bottom - 7)])
        self.line([(x + 9, top), (x + 9, bottom)], width=1)
        self.line([(x - 9, top), (x - 9, top + 19), (x + 9, top + 19)], width=1)
        for port in (x - 9, x + 9):
            for side in (-1, 1):
                ends, waist = port + 5 * side, port + 1.5 * side
                self.line([(ends, top + 5), (waist, top + 9), (ends, top + 13)], width=1)

    def four_way(self, x: float, y: float, sensing: bool = False, bleeding: bool = False) -> None:
        """Proportional 4/3 valve; A, B at (x -+ 9, y - 18), P, T at (x -+ 9, y + 18).

        sensing    port LS at (x + 15, y + 18)
        bleeding   in neutral both ports are connected to the tank through restrictors; else all are closed
        """
        for k in (-1, 0, 1):
            self.frame(x + k * BOX - HALF, y - HALF, BOX, BOX)
        top, bottom = y - HALF, y + HALF
        (self._bleeding_centre if bleeding else self._closed_centre)(x, top, bottom)
        self.text(x - 20, y - 23, "A", "middle")
        self.text(x + 20, y - 23, "B", "middle")
        left, right = x - BOX, x + BOX
        self.arrow((left - 9, bottom), (left - 9, top))
        self.arrow((left + 9, top), (left + 9, bottom))
        self.arrow((right - 9, bottom), (right + 9, top))
        self.arrow((right - 9, top), (right + 9, bottom))
        for edge in (top - 3, bottom + 3):  # two lines along the boxes: continuous positions
            self.line([(x - 1.5 * BOX, edge), (x + 1.5 * BOX, edge)], width=1)
        for side in (-1, 1):
            edge = x + side * 1.5 * BOX
            self.spring(edge, y + 8, edge + side * 22)
            self.frame(min(edge, edge + side * 18), y - 15, 18, 15)
            self.arrow((edge + side * 4, y - 2), (edge + side * 16, y - 14), width=1)
        if sensing:
            self.line([(x + 15, bottom + 3), (x + 15, bottom + 10)], pilot=True)

    def cylinder(self, x: float, y: float, label: str = "") -> None:
        """Double-acting cylinder; head side at (x - 44, y + 16), rod side at (x + 34, y + 16)."""
        self.frame(x - 54, y - 16, 98, 32)
        self.line([(x - 12, y - 16), (x - 12, y + 16)], width=3)
        self.line([(x - 12, y - 4), (x + 84, y - 4)])
        self.line([(x - 12, y + 4), (x + 84, y + 4)])
        self.line([(x + 84, y - 9), (x + 84, y + 9)], width=3)
        if label:
            self.text(x - 54, y - 22, label)

    def hose(self, x: float, y: float, label: str = "") -> None:
        """Flexible line between (x, y - 22) and (x, y + 22)."""
        self.items.append(
            f'<path d="M {x:g} {y - 22:g} C {x + 14:g} {y - 8:g} {x - 14:g} {y + 8:g} {x:g} {y + 22:g}"/>'
        )
        self.node(x, y - 22)
        self.node(x, y + 22)
        if label:
            self.text(x + 12, y + 4, label)

    def brake(self, x: float, y: float) -> None:
        """Brake on a shaft at y, applied by a spring, released by the pressure at (x - 24, y + 24)."""
        self.line([(x, y - 10), (x, y + 10)], width=3)
        self.line([(x - 6, y + 13), (x + 6, y + 13)], width=2)
        self.frame(x - 12, y + 18, 24, 30)
        self.line([(x, y + 13), (x, y + 30)])
        self.line([(x - 12, y + 30), (x + 12, y + 30)], width=3)
        self.spring(x, y + 31, y + 48, vertical=True)
        self.line([(x - 12, y + 24), (x - 24, y + 24)], pilot=True)
