"""What a person sees of an FMU: the page in documentation/, icon, licence, display units."""

import re
import runpy
import struct
import tomllib
import zipfile
from itertools import product
from pathlib import Path

import pytest
from export.conftest import stateless
from kit.fmu import driving
from kit.mistakes import problem, table
from lxml import etree, html
from markdown_it import MarkdownIt

from fmus.components.opening_curve import POINTS
from fmus.contract import Quantity, quantities
from fmus.controller import CONTROLLER
from fmus.export.build import packages
from fmus.export.documentation import formulas, mathml, printed, project_file, prose
from fmus.export.interface import interface_of
from fmus.machine.build import HELD, HELD_COMMAND, UNPOWERED
from fmus.machine.one_block import HARVESTER
from fmus.machine.parts import FAMILIES, FERIC
from fmus.machine.ssp import all_wires
from fmus.parameters import Values, numbers, values
from fmus.valve_actuation import ACTUATION
from orchestrator.base.units import pretty

ROOT = Path(__file__).parents[2]
FOLDERS = ("docs", "examples", "fmus", "orchestrator")
DOCUMENTS = sorted([*ROOT.glob("*.md"), *(p for top in FOLDERS for p in (ROOT / top).rglob("*.md"))])
VARIANTS = [sub for variants in FAMILIES.values() for sub in variants.values()]
ALONE = [*FERIC.components.values(), ACTUATION, CONTROLLER, HARVESTER]
SUBSYSTEMS = {sub.name: sub for sub in (*ALONE, *VARIANTS)}
PARTS, WIRES = ("swing", "boom_stick", "manipulator"), all_wires(FERIC)
# part -> rate ports that are connected to it
RATED = {
    part: {p for wire in WIRES for end in wire if end.startswith(f"{part}.") for p in [end.split(".")[1]]}
    for part in (*FERIC.components, ACTUATION.name, CONTROLLER.name)
}
ICONS = {2: "model.png", 3: "terminalsAndIcons/icon.png"}


@pytest.fixture(scope="module")
def content(fmu_dir, fmi3_dir):
    """(name, FMI version) -> files of the FMU as built."""
    found = {}
    for name, (fmi, folder) in product(SUBSYSTEMS, ((2, fmu_dir), (3, fmi3_dir))):
        place = "" if SUBSYSTEMS[name] in ALONE else "variants"
        with zipfile.ZipFile(folder / place / f"{name}.fmu") as archive:
            found[name, fmi] = {member: archive.read(member) for member in archive.namelist()}
    return found


@pytest.fixture
def page(content):
    """page("swing"): the parsed documentation."""
    return lambda name, fmi=3: html.fromstring(content[name, fmi]["documentation/index.html"].decode())


@pytest.mark.parametrize("fmi", ICONS)
@pytest.mark.parametrize("name", SUBSYSTEMS)
def test_icon_and_licence_are_where_the_standard_has_them(content, name, fmi):
    """The FMU contains a square PNG icon of at least 128 pixels and the licence."""
    files = content[name, fmi]
    icon = files[ICONS[fmi]]
    assert icon.startswith(b"\x89PNG\r\n\x1a\n")
    width, height = struct.unpack_from(">II", icon, 16)
    assert width == height >= 128
    assert files["documentation/licenses/license.txt"] == project_file("LICENSE").read_bytes()
    assert files["documentation/licenses/notices.md"] == project_file("NOTICES.md").read_bytes()


@pytest.mark.parametrize("name", SUBSYSTEMS)
def test_icons_differ(content, name):
    """Icons of different parts differ; those of the variants of a part are equal."""
    icons = {other: content[other, 2]["model.png"] for other in SUBSYSTEMS}
    alike = [other for other, icon in icons.items() if icon == icons[name]]
    assert alike == [n for n, sub in SUBSYSTEMS.items() if sub.component == SUBSYSTEMS[name].component]


@pytest.mark.parametrize("name", SUBSYSTEMS)
def test_page_needs_nothing_from_outside(content, page, name):
    """The page contains its pictures and styles; links lead to anchors of the page or to files of the FMU."""
    tree = page(name)
    places = {element.get("id") for element in tree.iter() if element.get("id")}
    links = {a.get("href") for a in tree.iter("a")}
    assert {link[1:] for link in links if link.startswith("#")} <= places
    assert {f"documentation/{link}" for link in links if not link.startswith("#")} <= set(content[name, 3])
    assert all(image.get("src").startswith("data:") for image in tree.iter("img"))
    assert not list(tree.iter("link", "script", "iframe"))


@pytest.mark.parametrize("name", SUBSYSTEMS)
def test_sections_that_the_readme_names_come_along(name):
    """Each link of the README, but for sections of other variants, finds its section in another document."""
    sub = SUBSYSTEMS[name]
    readme = sub.values.parent / "README.md"
    head, *sections = re.split(r"^(?=## )", readme.read_text(encoding="utf-8"), flags=re.MULTILINE)
    siblings = {v for v in FAMILIES.get(sub.component, {}) if v != sub.variant}
    titles = [section.splitlines()[0].removeprefix("## ") for section in sections]
    text = head + "".join(s for s, title in zip(sections, titles, strict=True) if title not in siblings)
    assert not siblings or sub.variant in titles  # each variant has its own section
    wanted = re.findall(r"\]\([^)\s]+\.md#([^)\s]+)\)", text)
    assert [section.anchor for section in prose(readme, sub.variant)[1]] == list(dict.fromkeys(wanted))


def test_installed_copy_of_a_document_is_found(tmp_path):
    """Without a docs folder next to the packages the sections come from the copy in the package."""
    readme = tmp_path / "fmus" / "x" / "README.md"
    readme.parent.mkdir(parents=True)
    readme.write_text("# x\n\nSee [valve](../../docs/equations.md#2-valve-eqs-1-2) and [gone](../gone.md).\n")
    text, sections = prose(readme)
    assert text.strip() == '<p>See <a href="#2-valve-eqs-1-2">valve</a> and gone.</p>'
    assert [(section.title, section.short) for section in sections] == [("2. Valve, eqs. (1), (2)", "Valve")]


@pytest.mark.parametrize("name", SUBSYSTEMS)
def test_every_port_and_every_number_is_in_a_table(page, name):
    """The tables contain all ports with unit and description, and parameters with value, source and note."""
    sub, tree = SUBSYSTEMS[name], page(name)
    rows = {section: _rows(tree, section) for section in ("ports", "parameters")}
    ports = quantities(sub.inputs) | quantities(sub.outputs)
    assert set(rows["ports"]) == set(ports)
    declared = quantities(sub.parameters)
    lists = {f"{n} to {POINTS}" for n, q in declared.items() if q.listed and n.endswith("_1")}
    assert set(rows["parameters"]) == {n for n, q in declared.items() if not q.listed} | lists
    for variable, quantity in ports.items():
        assert quantity.text in rows["ports"][variable]
        assert pretty(quantity.unit) in rows["ports"][variable]
    for name, number in numbers(sub)["parameters"].items():
        variable = name.rpartition("_")[0] + f"_1 to {POINTS}" if number.listed else name
        row = rows["parameters"][variable]
        assert f"{printed(number.value)} {pretty(number.unit)}" in row
        assert f"{number.source} {number.note}" in row


def _rows(tree, section):
    """The rows of the tables of a section: name -> text."""
    found = tree.get_element_by_id(section).xpath(".//tr[td/code and count(td) > 1]")
    texts = [" ".join(" ".join(cell.text_content().split()) for cell in row.findall("td")) for row in found]
    return {row.find("td/code").text: text for row, text in zip(found, texts, strict=True)}


@pytest.mark.parametrize("name", SUBSYSTEMS)
def test_page_says_what_to_connect(page, name):
    """The table has the machine's connections of the FMU, no more and no fewer, with the rate ports."""
    sub, tree = SUBSYSTEMS[name], page(name)
    found = set()
    for row in tree.get_element_by_id("connections").iter("tr"):
        cells = [[code.text for code in cell.iter("code")] for cell in row.findall("td")]
        if cells:
            (port,), direction, ends, rates = cells[0], row.findall("td")[1].text, cells[2], cells[3]
            for end in ends:
                part, _, other = end.partition(".")
                rated = () if other else RATED.get(part, set()) & {*rates}
                found |= {(direction, port, part, other or port)}
                found |= {(direction, rate, part, rate) for rate in rated}
    parts = PARTS if name == HARVESTER.name else (sub.component,)
    expected = set()
    for wire in WIRES:
        for direction, own, other in (("out", *wire), ("in", *wire[::-1])):
            (part, port), (partner, name_there) = own.split("."), other.split(".")
            outside = partner not in parts and not (name == HARVESTER.name and partner == "supply")
            if part in parts and outside:
                expected.add((direction, port, partner, name_there))
    assert found == expected


def page_of(sub, values):
    """The documentation of any subsystem."""
    return packages(sub, 1e-3, 1.0, values)[2]["documentation/index.html"].decode()


def test_page_of_another_model_has_no_table(toys):
    """Only FMUs of the machine have partners; the note on unconnected inputs is on every page."""
    text = page_of(*toys["gain"])
    assert 'id="connections"' not in text
    assert "Simulink and OpenModelica set them to 0. Connect constants there: <code>left</code> 1" in text
    assert "harvester-cosim." not in text


def test_inputs_that_must_not_be_zero_are_listed(page):
    """The page names the supply pressure with its value, and what happens without it."""
    text = " ".join(page("swing").get_element_by_id("use").text_content().split())
    assert "supply_pressure 2.0684·10⁷ Pa" in text
    assert UNPOWERED in text
    assert "tank_pressure" not in text


@pytest.mark.parametrize("voltage", [-4.0, 4.0])
def test_without_supply_pressure_the_arm_sinks(fmu_dir, voltage):
    """As the page says: no command turns the swing, and each command lets boom or stick sink."""
    moved = {}
    for axis in ("swing", "boom", "stick"):
        given = {"supply_pressure": 0.0, f"{axis}_command": voltage}
        with driving(fmu_dir / "harvester.fmu", **given) as fmu:
            before = fmu[f"{axis}_angle"]
            moved[axis] = fmu.step(0.01, 100)[f"{axis}_angle"] - before  # rad in a second
    assert abs(moved["swing"]) < 1e-3  # leakage
    assert max(moved["boom"], moved["stick"]) < -0.02


@table(__file__, "held", "document, rows")
def test_cost_of_held_inputs_is_that_of_the_measurement(page, document, rows):
    """The numbers in the pages are those of the tables that the named commands write."""
    lines = (ROOT / "docs" / document).read_text(encoding="utf-8").splitlines()
    told, name = (HELD, "swing") if document == "rate-ports.md" else (HELD_COMMAND, "harvester")
    assert told in page(name).get_element_by_id("use").text_content()
    for start, number in rows.items():
        (line,) = [line for line in lines if line.startswith(f"|{start}|")]
        assert number in line.split("|")
        assert f"{number.removesuffix(' %')} %" in told


def test_readme_of_the_release_lists_the_connections():
    """The README in the zip has each connection of the parts, or its port has it as its rate."""
    text = runpy.run_path(str(ROOT / "tools" / "release.py"))["read_me"]("1.2.3")
    for start, end in WIRES:
        name = end.partition(".")[2]
        assert f"  {start} to {end}" in text or f", rate port {name}\n" in text
    assert max(map(len, text.splitlines())) <= 120


@pytest.mark.parametrize("name", SUBSYSTEMS)
def test_parameters_stand_under_headings(name):
    """Every parameter has a group, and the parameters of a group are consecutive in the FMU."""
    sub = SUBSYSTEMS[name]
    groups = [v.quantity.group for v in interface_of(sub, values(sub)).parameters]
    assert all(groups)
    changes = [a for a, b in zip(groups, [*groups[1:], ""], strict=True) if a != b]
    assert len(changes) == len(set(changes))


def test_text_of_a_declaration_is_escaped():
    """Characters with a meaning in HTML are escaped."""
    u = Quantity("1", "a < b & c", maximum=5.0)
    odd = stateless("odd", {"u": u}, {"y": u}, lambda _x, u, p: {"y": p.k * u.u}, {"k": u})
    text = page_of(odd, Values({"k": 2.0}, {"u": 1.0}, {}))
    assert "a &lt; b &amp; c" in text
    assert "a < b" not in text


@pytest.mark.parametrize("name", SUBSYSTEMS)
def test_quantities_are_shown_in_customary_units(content, name):
    """Display units in both versions are bar, L/min, degrees and kN."""
    customary = {"Pa": "bar", "m3/s": "L/min", "rad": "deg", "rad/s": "deg/s", "N": "kN", "N.m": "kN.m"}
    for fmi, path in ((2, ".//ScalarVariable/Real"), (3, ".//Float64")):
        tree = etree.fromstring(content[name, fmi]["modelDescription.xml"])
        units = [(e.get("unit"), e.get("displayUnit")) for e in tree.iterfind(path)]
        assert units
        assert {(u, d) for u, d in units if u in customary} <= set(customary.items())


def test_numbers_travel_with_the_fmu(content):
    """resources/parameters.toml has the values with their sources, even if the subsystem has no such file."""
    for (name, _), files in content.items():
        table = tomllib.loads(files["resources/parameters.toml"].decode())["parameters"]
        names, known = quantities(SUBSYSTEMS[name].parameters), numbers(SUBSYSTEMS[name])["parameters"]
        listed = {n.rpartition("_")[0] + "s": n for n, q in names.items() if q.listed}
        assert set(table) == {n for n, q in names.items() if not q.listed} | set(listed)
        assert all(len(table[n]["value"]) == POINTS for n in listed)
        for n in set(table) - set(listed):
            told = {key: table[n][key] for key in ("value", "unit", "source", "note")}
            assert told.items() <= vars(known[n]).items()


@table(__file__, "numbers", "value, text")
def test_numbers_read_as_in_a_data_sheet(value, text):
    """Exponents are not padded, and the minus sign is that of typesetting."""
    assert printed(value) == text


# ---- formulas ----------------------------------------------------------------------------------------


def parsed(document: Path) -> tuple[html.HtmlElement, list[str]]:
    """A document with its formulas in MathML and without code; the formulas with their dollar signs."""
    page = MarkdownIt("commonmark").enable("table").use(formulas)
    source = document.read_text(encoding="utf-8")
    tree = html.fromstring(f"<div>{page.render(source, {'file': document.name})}</div>")
    for code in tree.xpath("//code"):
        code.text = ""
    found = [t for block in page.parse(source) for t in block.children or [] if t.type == "formula"]
    return tree, [f"$${t.content}$$" if t.block else f"${t.content}$" for t in found]


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda p: str(p.relative_to(ROOT)))
def test_every_formula_becomes_mathml(document):
    """No dollar sign is left over, and every formula converts without an unknown command.

    Git servers let Markdown pass first: no emphasis, escape or tag of Markdown is inside a formula.
    """
    tree, found = parsed(document)
    assert "$" not in tree.text_content()
    assert len(list(tree.iter("math"))) == len(found)
    plain = MarkdownIt("commonmark").enable("table").render(document.read_text(encoding="utf-8"))
    text = html.fromstring(f"<div>{plain}</div>").text_content()
    assert [formula for formula in found if formula not in text] == []


@table(__file__, "formulas", "latex, elements")
def test_parts_of_a_formula_are_those_of_mathml(latex, elements):
    """Fractions, indices, matrices, cases and aligned lines become elements of MathML."""
    made = html.fromstring(mathml(latex, display=True))
    assert set(elements) <= {element.tag for element in made.iter()}
    assert made.get("display") == "block"


@pytest.mark.parametrize("latex", [r"\undefined x", r"\frac{a}", "a & b", "a_1_2", r"\left(x"])
def test_a_formula_that_does_not_convert_is_named(latex):
    """The message has the file and the formula."""
    line = problem(lambda: mathml(latex, file="page.md"))
    assert line.startswith(f"page.md: formula {latex}: expected ")


@pytest.mark.parametrize("name", SUBSYSTEMS)
def test_equations_are_typeset_in_the_page(page, name):
    """The page of a part with equations has MathML, no dollar sign and no LaTeX."""
    tree = page(name)
    assert bool([*tree.iter("math")]) == (name != "operator_input")
    assert not re.search(r"\$|\\[a-z]", tree.xpath("string(//main)"))
