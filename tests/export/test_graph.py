"""Linear graphs of circuits: nothing overlaps, everything is there, the paper's Figs. 2 and 3 by name."""

import re
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from kit import shards
from kit.scripts import names_of
from lxml import etree

from fmus import boom_stick
from fmus.components.additions import Accumulator, ChamberReliefs, Cushion, PistonLeakage, Regeneration
from fmus.components.circuit import GROUND, SUPPLY, TANK, Branch, Circuit, Kind, Node
from fmus.contract import Subsystem, symbols
from fmus.drives.drive import part
from fmus.drives.lumped import LUMPED
from fmus.export.graph import svg
from fmus.machine.parts import FAMILIES
from fmus.supply import CONSUMERS, supply

ROOT = Path(__file__).parents[2]
SVG = "{http://www.w3.org/2000/svg}"
ADDED = {"leak": PistonLeakage, "reliefs": ChamberReliefs, "cushion": Cushion, "regeneration": Regeneration}


def circuits(sub: Subsystem) -> dict[str, Circuit]:
    return dict(sub.circuits(symbols(sub.states), symbols(sub.inputs), symbols(sub.parameters)))


def with_additions() -> Subsystem:
    """The lumped boom and stick drives, the boom with all additions."""
    boom, stick = boom_stick.AXES
    axes = (replace(boom, additions=tuple(ADDED.items())), stick)
    return part("boom_stick", axes, LUMPED, text="-", validity="-", values=boom_stick.VALUES)


SUBSYSTEMS = {
    **{f"{name} {v}": sub for name, variants in FAMILIES.items() for v, sub in variants.items()},
    "boom_stick additions": with_additions(),
    **{f"{v} accumulator": s for v, s in supply(CONSUMERS, additions={"accumulator": Accumulator}).items()},
}
DRAWN = {
    f"{name} {axis}": circuit for name, sub in SUBSYSTEMS.items() for axis, circuit in circuits(sub).items()
}


# ---- what a reader sees, from the SVG alone

Box = tuple[float, float, float, float]  # left, top, right, bottom


def placed(root):
    """Elements with their place: groups and marks are moved by `translate`."""
    for element in root.iter(f"{SVG}text", f"{SVG}path", f"{SVG}circle"):
        moves = [e.get("transform", "") for e in (element, *element.iterancestors())]
        at = [[float(v) for v in m[1].split()] for t in moves if (m := re.match(r"translate\((.*?)\)", t))]
        yield element, sum(x for x, _ in at), sum(y for _, y in at)


def boxes(root) -> dict[str, Box]:
    """Boxes of all labels in a wide font: 0.62 em for a letter, 0.9 em above the line."""
    found = {}
    for k, (element, x, y) in enumerate(placed(root)):
        if element.tag == f"{SVG}text":
            size = 11 if element.get("class") == "legend" else 14
            spans = [(s, 11 if s.get("class") == "index" else size) for s in element.iter(f"{SVG}tspan")]
            texts = [((s.text or "").replace("\u0307", ""), n) for s, n in spans or [(element, size)]]
            long = sum(0.62 * n * len(letters) for letters, n in texts)
            anchor = {"start": 0, "middle": 0.5, "end": 1}[element.get("text-anchor", "start")]
            left, y = x + float(element.get("x")) - anchor * long, y + float(element.get("y"))
            low = y + (6.5 if len(spans) > 1 else 3)
            found[f"{k} {''.join(element.itertext())}"] = (left, y - 0.9 * size, left + long, low)
    return found


def points(root) -> list[tuple[float, float]]:
    """Points at most 2 px apart on all lines, arrow heads and marks by their corners and middle."""
    found = []
    for element, x, y in placed(root):
        if element.tag == f"{SVG}circle":
            cx, cy = x + float(element.get("cx")), y + float(element.get("cy"))
            found += [(cx + dx, cy + dy) for dx in (-4.5, 0, 4.5) for dy in (-4.5, 0, 4.5)]
        elif element.get("transform"):
            found += [(x + dx, y + dy) for dx in (-6, 0, 6) for dy in (-5, 0, 5)]
        elif element.tag == f"{SVG}path":
            found += [(x + px, y + py) for px, py in along(element.get("d"))]
    return found


def along(d: str) -> list[tuple[float, float]]:
    """Points of a path of the commands M, L, Q, H, V, h."""
    at, found = 0j, []
    for command, numbers in re.findall(r"([MLQHVh])([-\d. ]+)", d):
        v = [float(n) for n in numbers.split()]
        if command in "HVh":
            to = {"H": complex(v[0], at.imag), "V": complex(at.real, v[0]), "h": at + v[0]}[command]
        else:
            to = complex(*v[-2:])
        c = complex(*v[:2]) if command == "Q" else (at + to) / 2
        steps = 1 + int((abs(c - at) + abs(to - c)) / 2)
        if command != "M":
            share = np.linspace(0, 1, steps + 1)
            curve = (1 - share) ** 2 * at + 2 * share * (1 - share) * c + share**2 * to
            found += zip(curve.real, curve.imag, strict=True)
        at = to
    return found


def overlaps(drawing: str) -> list[str]:
    """What overlaps a label, or leaves the picture."""
    root = etree.fromstring(drawing)
    labels, (_, _, width, height) = boxes(root), (float(v) for v in root.get("viewBox").split())
    wrong = [
        f"{one} and {other}"
        for (one, a), (other, b) in combinations(labels.items(), 2)
        if a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]
    ]
    lines = points(root)
    for name, (left, top, right, bottom) in labels.items():
        hit = [p for p in lines if left < p[0] < right and top < p[1] < bottom]
        wrong += [f"{name} and a line at {p}" for p in hit[:1]]
        if not (left > 0 and right < width and top > 0 and bottom < height):
            wrong.append(f"{name} leaves the picture")
    return wrong


@pytest.mark.parametrize("name", DRAWN)
def test_no_label_overlaps_another_one_or_a_line(name):
    """In every variant, with every addition."""
    assert overlaps(svg(DRAWN[name], name)) == []


def test_overlaps_are_noticed():
    """A label that is 25 px further to the left is on its line, one of another place on another label."""
    drawing = svg(DRAWN["swing lumped swing"], "-")
    label = re.search(r'<text x="([\d.]+)" y="([\d.]+)" text-anchor="start"><tspan>R<', drawing)
    moved = drawing.replace(label[0], label[0].replace(label[1], f"{float(label[1]) - 25}"))
    assert any("a line" in wrong for wrong in overlaps(moved))
    other = re.search(r'<text x="([\d.]+)" y="([\d.]+)" text-anchor="start"><tspan>I<', drawing)
    moved = drawing.replace(label[0], other[0].replace("I<", "R<"))
    assert any("I1" in wrong and "R1" in wrong for wrong in overlaps(moved))


@pytest.mark.parametrize("name", DRAWN)
def test_every_node_and_branch_is_drawn_once(name):
    """By the names that a reader sees at the pointer; capacitances and given pressures are branches, too."""
    circuit = DRAWN[name]
    root = etree.fromstring(svg(circuit, name))
    of_branches = sorted(g.findtext(f"{SVG}title") for g in root.iter(f"{SVG}g") if g.findtext(f"{SVG}title"))
    expected = [f"{n}: {b.kind}" for n, b in circuit.branches.items()]
    expected += [f"{n}: capacitance" for n, node in circuit.nodes.items() if node.capacitance is not None]
    free = {n: node for n, node in circuit.nodes.items() if node.capacitance is None}
    given = {n for n, node in free.items() if node.symbol.startswith("P_")}
    lines = {"supply", "tank", "supply_pressure", "reservoir_pressure"}
    expected += [f"{n}: given pressure" for n in given & lines or given & {"tank_pressure"}]
    assert of_branches == sorted(expected)
    dots = {c.findtext(f"{SVG}title") for c in root.iter(f"{SVG}circle")} - {None}
    labels = {t.text for t in root.iter(f"{SVG}text")} - {None}
    names = {n.replace("_", " ") for n in circuit.nodes}
    assert names - {GROUND} == {n.replace("_", " ") for n in dots} | (labels & names)


def test_any_circuit_is_drawn():
    """Random ones, with parallel branches, without lines: each branch once, twice the same."""
    rng = np.random.default_rng(3)
    for _ in range(40):
        names = [*rng.permutation([SUPPLY, TANK, GROUND, "a", "b", "c", "d_e"])][: rng.integers(2, 8)]
        nodes = {str(n): Node(0.0, "", rng.choice([None, 1.0])) for n in names}
        ends = [rng.choice(names, 2, replace=False) for _ in range(rng.integers(1, 12))]
        branches = {
            f"q_{k}": Branch(*map(str, e), list(Kind)[rng.integers(len(Kind))], 0.0)
            for k, e in enumerate(ends)
        }
        drawing = svg(Circuit(nodes, branches), "-")
        titles = [g.findtext(f"{SVG}title") or "" for g in etree.fromstring(drawing).iter(f"{SVG}g")]
        assert sorted(t.partition(":")[0] for t in titles if t.startswith("q_")) == sorted(branches)
        assert drawing == svg(Circuit(nodes, branches), "-")


# ---- the paper's Figs. 2 and 3, transcribed from the text around them and from eqs. (6) to (12)

BRANCHES = {
    "swing": "P_s C_R C_Re I_1 I_2 C_1 C_2 R_1 R_2 R_in R_e1 R_e2 D_m N B_sw",
    "boom_stick": "P_s C_R C_Re I_1 I_2 C_1 C_2 R_1 R_2 gy_1 gy_2 B",
}
ACROSS = {"swing": "P_C1 P_C2 P_1 P_2 q̇_sw", "boom_stick": "P_C1 P_C2 ẋ"}
# through variables: Q_i1, Q_i2, the motor's Q_sw, Q_in, Q_ex1, Q_ex2; the cylinder's Q_in, Q_out
THROUGH = {
    "swing": {"flow_a": "I_1", "flow_b": "I_2", "motor": "D_m N", "internal_leakage": "R_in"}
    | {"drain_a": "R_e1", "drain_b": "R_e2"},
    "boom_stick": {"head_flow": "I_1, R_1", "rod_flow": "I_2, R_2"}
    | {"head_piston": "gy_1", "rod_piston": "gy_2"},
}


def label(text) -> str:
    return "".join(("_" if s.get("class") == "index" else "") + s.text for s in text.iter(f"{SVG}tspan"))


@pytest.mark.parametrize("name", ["swing lumped swing", "boom_stick lumped boom", "boom_stick lumped stick"])
def test_the_papers_figures_are_there_by_name(name):
    """Every branch, across and through variable; through variables have the names of outputs of the FMU."""
    figure, root = name.split()[0], etree.fromstring(svg(DRAWN[name], name))
    seen = re.split(r"[ ,]+", " ".join(map(label, root.iter(f"{SVG}text"))))
    assert set(BRANCHES[figure].split()) | set(ACROSS[figure].split()) <= set(seen)
    named = {
        g.findtext(f"{SVG}title").partition(":")[0]: label(g.find(f"{SVG}text"))
        for g in root.iter(f"{SVG}g")
        if g.findtext(f"{SVG}title")
    }
    assert THROUGH[figure].items() <= named.items()


@shards.documents
def test_the_pictures_of_the_documents_are_those_that_the_code_draws(monkeypatch):
    """`python docs/circuits.py` would change no file: hydraulic diagrams and graphs."""
    monkeypatch.syspath_prepend(ROOT / "docs")
    pictures = names_of(ROOT / "docs/circuits.py")["pictures"]()
    files = {
        p.name: p.read_text(encoding="utf-8")
        for of in ("circuit", "graph")
        for p in (ROOT / "docs/images").glob(f"{of}_*.svg")
    }
    assert pictures == files
