"""Opening curve of a metering edge from a table: opening over command, monotone between the points.

A table has up to ten points (V_i, a_i): command [V] and opening [1], relative to the full area. The curve is
zero below the first point, whose opening is zero, so V_1 is the dead band. It is constant above the last
point. In between it is the piecewise cubic Hermite interpolation

    a(V) = a_i + s (d_i + s ((3 D_i - 2 d_i - d_i+1) / h_i + s (d_i + d_i+1 - 2 D_i) / h_i^2))

    s = V - V_i        h_i = V_i+1 - V_i        D_i = (a_i+1 - a_i) / h_i

with the slopes d_i of Fritsch and Butland, weighted by the intervals as in SciPy's `PchipInterpolator`:

    d_i = (w_1 + w_2) / (w_1 / D_i-1 + w_2 / D_i)        w_1 = 2 h_i + h_i-1        w_2 = h_i + 2 h_i-1

and d_i = 0 if D_i-1 or D_i is zero. At the first point the slope is zero, which rounds the start. At the last
point it is that of the parabola through the last three points, limited to zero; of two points, D_1.

The curve is monotone if the points are, and continuously differentiable up to the last point. There its slope
jumps to zero, as that of the straight line does at full command. Points on a line give this line from the
third point on.

Reference: F. N. Fritsch and J. Butland, A Method for Constructing Local Monotone Piecewise Cubic
Interpolants, SIAM J. Sci. Stat. Comput. 5 (1984) 300; monotone: Fritsch and Carlson, SIAM J. Numer. Anal. 17
(1980) 238.

Which points count: the first one always; point i > 1 if its command is positive. With fewer than two points
there is no table, and the curve is a straight line with a rounded start (`StraightOpening`), which has three
such pieces: a quartic, the line, and 1 from full command on.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca

from fmus.contract import Group, Quantity, Scalar, make_group
from fmus.smooth import ramp

POINTS = 10
EDGES = ("pa", "at", "pb", "bt")
SMALLEST_GAP = 1e-3  # V, between the commands of two points
COEFFICIENTS = 5 * POINTS - 4  # the first piece has a_1 = d_1 = 0, after the last point only a is not zero
NEVER = 1e9  # V: a command that no edge gets; its fourth power is finite


def _point(number: int) -> dict[str, Quantity]:
    command = Quantity(
        "V",
        f"Command of point {number} of the opening curve of the edge {{}}"
        + ("; 0: no such point" if number > 1 else "; up to it the edge stays closed"),
        minimum=0.0,
        group="Opening curves" if number == 1 else "",
        listed="Commands of the points of the opening curve of the edge {}; none: the straight line",
    )
    opening = Quantity(
        "1",
        f"Opening at point {number} of the opening curve of the edge {{}}, relative to the full area",
        minimum=0.0,
        maximum=1.0,
        listed="Openings at the points of the opening curve of the edge {}, relative to the full area",
    )
    return {f"command_{number}": command, f"opening_{number}": opening}


_COMMANDS, _OPENINGS = zip(*(_point(number).items() for number in range(1, POINTS + 1)), strict=True)
OpeningTable: Any = make_group("OpeningTable", dict(_COMMANDS + _OPENINGS))  # as they are listed


class OpeningCurves(
    Group,
    pa=(OpeningTable, "P-A"),
    at=(OpeningTable, "A-T"),
    pb=(OpeningTable, "P-B"),
    bt=(OpeningTable, "B-T"),
):
    """Tables of the four metering edges of a valve."""


def commands(table: Any) -> list[Scalar]:
    """Commands [V] of a table."""
    return [getattr(table, f"command_{i}") for i in range(1, POINTS + 1)]


def openings(table: Any) -> list[Scalar]:
    """Openings [1] of a table."""
    return [getattr(table, f"opening_{i}") for i in range(1, POINTS + 1)]


@dataclass(frozen=True)
class StraightOpening:
    """The curve without a table [V]: ramp(V - dead_band) / ramp(full - dead_band), constant from full on.

    ramp is that of `smooth`, rounded over `rounding`.
    """

    dead_band: Scalar
    full: Scalar
    rounding: Scalar


CLOSED = StraightOpening(NEVER, 2 * NEVER, 1.0)  # an edge that no command opens


@dataclass(frozen=True)
class Pieces:
    """The pieces of a curve, which depend on the parameters alone.

    coefficients   V_i of all points; of the first piece the factors of s^2, s^3 and s^4, of each other one
                   a_i, d_i and the factors of s^2 and s^3; a_i of the last point. Shape (COEFFICIENTS, 1)
    """

    coefficients: Any

    def opening(self, command: Scalar) -> Scalar:
        """Opening [1] at a command [V]."""
        return CURVE(command, self.coefficients)


def meter_in_dead_bands(
    curves: OpeningCurves, pa: Scalar, pb: Scalar, full: Scalar = 1
) -> tuple[Scalar, Scalar]:
    """Commands at which P-A and P-B begin to open: by their tables, in parts of `full`, else pa and pb."""
    a, b = curves.pa, curves.pb
    return (
        ca.if_else(a.command_2 > 0, a.command_1 / full, pa),
        ca.if_else(b.command_2 > 0, b.command_1 / full, pb),
    )


def pieces(table: Any, line: StraightOpening = CLOSED) -> Pieces:
    """The pieces of the curve through the points of a table, or of the line."""
    points = ca.vertcat(*commands(table)), ca.vertcat(*openings(table)[1:])
    return Pieces(PIECES(*points, ca.vertcat(line.dead_band, line.full, line.rounding)))


def _pieces() -> ca.Function:
    """(commands, openings from the second on, line) -> coefficients; a function that stays a call."""
    given = ca.SX.sym("commands", POINTS), ca.SX.sym("openings", POINTS - 1), ca.SX.sym("line", 3)
    v: list[Scalar] = ca.vertsplit(given[0])
    a: list[Scalar] = [0, *ca.vertsplit(given[1])]
    used = [v[1] > 0, *(value > 0 for value in v[1:])]
    for i in range(2, POINTS):  # an unused point repeats the one before
        v[i], a[i] = ca.if_else(used[i], v[i], v[i - 1]), ca.if_else(used[i], a[i], a[i - 1])
    gaps = [ca.if_else(used[i + 1], v[i + 1] - v[i], 1) for i in range(POINTS - 1)]
    secants = [(a[i + 1] - a[i]) / gaps[i] for i in range(POINTS - 1)]
    slopes = _slopes(used, gaps, secants)
    rows = []
    for i in range(POINTS - 1):
        d, following, rise, gap = slopes[i], slopes[i + 1], secants[i], gaps[i]
        factors = (d, (3 * rise - 2 * d - following) / gap, (d + following - 2 * rise) / gap**2)
        rows.append([a[i], *factors])
    first, *others = rows
    table = [*v, *first[2:], 0, *(x for row in others for x in row), a[-1]]
    line = _line_pieces(StraightOpening(*ca.vertsplit(given[2])))
    values = [ca.if_else(used[0], x, y) for x, y in zip(table, line, strict=True)]
    return ca.Function("opening_pieces", given, [ca.vertcat(*values)], {"never_inline": True, "cse": True})


def _line_pieces(line: StraightOpening) -> list[Scalar]:
    """The coefficients of the line: with w = `rounding`, (w (s/w)^3 - w (s/w)^4/2)/r and (w/2 + s)/r."""
    start, full, w = line.dead_band, line.full, line.rounding
    r = ramp(full - start, w)
    commands = [start, ca.fmin(start + w, full), full, *[NEVER] * (POINTS - 3)]
    first = [0, 1 / (w**2 * r), -1 / (2 * w**3 * r)]
    others = [[w / 2 / r, 1 / r, 0, 0], [1, 0, 0, 0], *[[0, 0, 0, 0]] * (POINTS - 4)]
    return [*commands, *first, *(x for row in others for x in row), 1]


def _slopes(used: Sequence[Scalar], gaps: Sequence[Scalar], secants: Sequence[Scalar]) -> list[Scalar]:
    """Slopes d_i [1/V] at the points."""
    slopes: list[Scalar] = [0]
    for i in range(1, POINTS):
        end = secants[0]
        if i > 1:
            h, before, rise = gaps[i - 1], gaps[i - 2], secants[i - 1]
            end = ca.fmax(0, ((2 * h + before) * rise - h * secants[i - 2]) / (h + before))
        inner = _inner_slope(gaps[i - 1], gaps[i], secants[i - 1], secants[i]) if i < POINTS - 1 else end
        following = used[i + 1] if i < POINTS - 1 else 0
        slopes.append(ca.if_else(following, inner, end))
    return slopes


def _inner_slope(h1: Scalar, h2: Scalar, d1: Scalar, d2: Scalar) -> Scalar:
    """Slope between two intervals: the harmonic mean of their secants, without a division by these."""
    w1, w2 = 2 * h2 + h1, h2 + 2 * h1
    total = w1 * d2 + w2 * d1
    positive = d1 * d2 > 0
    return ca.if_else(positive, (w1 + w2) * d1 * d2 / ca.if_else(positive, total, 1), 0)


def _curve() -> ca.Function:
    """(command, coefficients) -> opening, as a function that stays a call in larger expressions.

    This expression evaluates all pieces; the C code of the FMUs evaluates one (templates/opening_curve.h.j2).
    """
    command, table = ca.SX.sym("command"), ca.SX.sym("table", COEFFICIENTS)
    v, factors = table[:POINTS], table[POINTS:-1]
    rows: list[tuple[Scalar, ...]] = [(0, 0, *ca.vertsplit(factors[:3]))]
    rows += [(*ca.vertsplit(factors[4 * i - 1 : 4 * i + 3]), 0) for i in range(1, POINTS - 1)]
    value: Scalar = ca.if_else(command >= v[POINTS - 1], table[COEFFICIENTS - 1], 0)
    for i, (a, d, square, cube, fourth) in enumerate(rows):
        s = command - v[i]
        inside = ca.logic_and(command >= v[i], command < v[i + 1])
        value += ca.if_else(inside, a + s * (d + s * (square + s * (cube + s * fourth))), 0)
    return ca.Function("opening_curve", [command, table], [value], {"never_inline": True})


CURVE, PIECES = _curve(), _pieces()


def requirements(curves: Any, full_command: Scalar) -> dict[str, Scalar]:
    """Requirements: the points of each table are in order."""
    result: dict[str, Scalar] = {}
    for edge in EDGES:
        table = getattr(curves, edge)
        ascending, monotone = ORDER(ca.vertcat(*commands(table)), ca.vertcat(*openings(table)), full_command)
        text = f"valve_{edge}_commands ascend by at least {SMALLEST_GAP:g} V up to valve_full_command, then 0"
        result |= {text: ascending, f"valve_{edge}_openings do not descend, and begin with 0": monotone}
    return result


def _order() -> ca.Function:
    """(commands, openings, full command) -> two numbers that are positive if the points are in order."""
    given = ca.SX.sym("commands", POINTS), ca.SX.sym("openings", POINTS), ca.SX.sym("full_command")
    v, a = (ca.vertsplit(values) for values in given[:2])
    results = [_ascending(v, given[2]), _monotone(v, a)]
    return ca.Function("opening_order", given, results, {"never_inline": True})


def _ascending(v: Sequence[Scalar], full_command: Scalar) -> Scalar:
    """Positive if the commands of all points ascend, and no point follows an unused one."""
    gap = SMALLEST_GAP * (1 - 1e-6)  # rounding of the difference of two commands
    margin: Scalar = 1.0
    for i in range(1, POINTS):
        step = ca.fmin(v[i] - v[i - 1] - gap, full_command * (1 + 1e-9) - v[i])
        step = step if i == 1 else ca.if_else(v[i - 1] > 0, step, 0)
        margin = ca.fmin(margin, ca.if_else(v[i] > 0, step, 1))
    return margin


def _monotone(v: Sequence[Scalar], a: Sequence[Scalar]) -> Scalar:
    """1 if the first opening of a table is zero and none is below the one before, else 0."""
    wrong = ca.logic_and(v[1] > 0, a[0] > 0)
    for i in range(2, POINTS):  # none is negative
        wrong = ca.logic_or(wrong, ca.logic_and(v[i] > 0, a[i] < a[i - 1]))
    return ca.logic_not(wrong)


ORDER = _order()
