"""The diagram of a system: wires end at their connectors, run straight where they can, cross no component."""

from itertools import combinations, pairwise

import pytest

from orchestrator.ssp.diagram import GAP, PITCH, WIDTH, Diagram
from orchestrator.ssp.system import Port


def structure(columns, wires, **connectors):
    """Connectors by component, connections and columns of a diagram, and the diagram itself."""
    connections = [tuple(Port(*end.split(".")) for end in wire) for wire in wires]
    return connectors, connections, Diagram(connectors, connections, columns)


LOOP = structure(
    [["driver"], ["left", "right"], ["body"]],
    [
        *(("driver.l", "left.command"), ("driver.r", "right.command")),
        *(("left.force", "body.left_force"), ("body.left_speed", "left.speed")),
        *(("right.force", "body.right_force"), ("body.right_speed", "right.speed")),
    ],
    driver=((), ("l", "r")),
    left=(("command", "speed"), ("force", "heat")),
    right=(("command", "speed"), ("force", "heat")),
    body=(("left_force", "right_force"), ("left_speed", "right_speed", "energy")),
)
TANGLE = structure(
    [["a"], ["b", "d"], ["c"]],
    [("a.y", "b.u"), ("a.z", "c.w"), ("b.y", "c.u"), ("a.y", "c.v"), ("c.y", "b.v"), ("c.y", "d.u")],
    a=((), ("y", "z")),
    b=(("u", "v"), ("y",)),
    c=(("u", "v", "w"), ("y",)),
    d=(("u",), ("y",)),
)
ROW = structure([], [("a.y", "b.u"), ("b.y", "c.u")], a=((), ("y",)), b=(("u",), ("y",)), c=(("u",), ()))


@pytest.mark.parametrize("system", [LOOP, TANGLE, ROW], ids=["loop", "tangle", "row"])
def test_components_stand_apart_in_their_columns(system):
    """In the requested column, with every connector on its edge and none on another."""
    connectors, _, diagram = system
    placed = diagram.boxes
    for i, names in enumerate(diagram.columns):
        for name in names:
            x1, y1, x2, y2 = placed[name].corners
            assert (x1, x2 - x1) == (i * (WIDTH + GAP), WIDTH)
            assert y1 < y2
        for a, b in combinations((placed[n] for n in names), 2):
            assert a.bottom > b.top or b.bottom > a.top
    for name, (inputs, outputs) in connectors.items():
        points = {placed[name].connector(v) for v in (*inputs, *outputs)}
        assert len(points) == len(inputs) + len(outputs)
        assert all(x in (0.0, 1.0) and 0 < y < 1 for x, y in points)


def test_wires_between_neighbours_are_straight():
    """Both ways: the inputs from a component on the right are on the right side."""
    _, connections, diagram = LOOP
    assert diagram.bends == {}
    for ends in connections:
        (_, y), (_, y2) = (diagram.boxes[end.component].absolute(end.variable) for end in ends)
        assert y == y2


@pytest.mark.parametrize("system", [LOOP, TANGLE, ROW], ids=["loop", "tangle", "row"])
def test_no_wire_crosses_a_component(system):
    """Each runs along the axes from connector to connector, outside of all components."""
    _, connections, diagram = system
    placed = diagram.boxes
    for ends in connections:
        start, end = (placed[port.component].absolute(port.variable) for port in ends)
        for (x, y), (x2, y2) in pairwise([start, *diagram.bends.get(ends, []), end]):
            assert x == x2 or y == y2
            for left, bottom, right, top in (box.corners for box in placed.values()):
                inside = min(x, x2) < right and max(x, x2) > left and min(y, y2) < top and max(y, y2) > bottom
                assert not inside, ends


def test_connectors_are_apart():
    """No closer than the pitch of the diagram, so that their names can be read."""
    for box in TANGLE[2].boxes.values():
        for heights in box.sides:
            assert all(abs(a - b) >= PITCH for a, b in combinations(heights.values(), 2))
