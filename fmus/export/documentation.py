"""documentation/index.html of an FMU: what it is, its ports and numbers, its equations, in one file.

The text is the subsystem's README with the sections of other documents that it links to; the tables show its
variables.
"""

from __future__ import annotations

import re
from base64 import b64encode
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from jinja2 import Environment, PackageLoader, StrictUndefined
from markdown_it import MarkdownIt
from markupsafe import Markup

from fmus.contract import Subsystem
from fmus.export.c_code import DEFAULT_TOLERANCE
from fmus.export.interface import Interface, Variable
from fmus.export.ls_ref import PAGE, ls_ref_files
from fmus.export.model_description import LOG_CATEGORIES
from fmus.parameters import SOURCES, Number, numbers
from orchestrator.base.text import typeset
from orchestrator.base.units import display_conversion, pretty
from orchestrator.ssp.xml_writing import package_version

_LINK = re.compile(r"\[([^\]]*)\]\(([^)\s]+)\)")
_VARIANT = re.compile(r"^## ([a-z_]+)\n(?:(?!## ).*\n?)*", re.MULTILINE)
_HEADING = re.compile(r"^(#+) +(.*)$", re.MULTILINE)


def shipped(name: str) -> Path | None:
    """A file by its path in a checkout, such as data/x.csv; an installed package has a copy inside."""
    package = Path(__file__).parents[1]
    return next((folder / name for folder in (package.parent, package) if (folder / name).is_file()), None)


# ---- text ------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class LinkedSection:
    """A section of another document."""

    anchor: str
    title: str
    html: Markup

    @property
    def short(self) -> str:
        """The title without its number and what follows a comma."""
        return re.sub(r"^[\d.]+ ", "", self.title).partition(",")[0]


def prose(readme: Path, variant: str = "") -> tuple[Markup, list[LinkedSection]]:
    """A README without its title as HTML, and the sections of other documents that it links to.

    Of the sections about variants, whose headings are plain lower-case names, only that of `variant` stays.
    """
    if not readme.is_file():
        return Markup(), []
    text = re.sub(r"\A# .*\n", "", readme.read_text(encoding="utf-8"))
    text = _VARIANT.sub(lambda section: section[0] if section[1] == variant else "", text)
    linked: dict[str, LinkedSection] = {}
    for _, target in _LINK.findall(text):
        file, _, anchor = target.partition("#")
        section = _section(readme, file, anchor) if file.endswith(".md") and anchor else None
        if section:
            title, body = section.split("\n", 1)
            linked[anchor] = LinkedSection(anchor, title.lstrip("# "), _html(_LINK.sub(r"\1", body)))

    def inside(match: re.Match[str]) -> str:
        """A link as it works in the one page: to a section in it, to the web, else only its words."""
        words, target = match[1], match[2]
        anchor = target.partition("#")[2]
        if anchor in linked:
            return f"[{words}](#{anchor})"
        return match[0] if target.startswith(("http://", "https://")) else words

    return _html(_LINK.sub(inside, text)), list(linked.values())


def _section(readme: Path, file: str, anchor: str) -> str | None:
    """The section of a Markdown file with this anchor, from its heading to the next of the same rank."""
    path = readme.parent / file
    if not path.is_file():  # installed without the folder of the documents
        path = shipped(file.lstrip("./")) or path
    text = path.read_text(encoding="utf-8") if path.is_file() else ""
    headings = list(_HEADING.finditer(text))
    for i, heading in enumerate(headings):
        if slug(heading[2]) == anchor:
            after = (h.start() for h in headings[i + 1 :] if len(h[1]) <= len(heading[1]))
            return text[heading.start() : next(after, len(text))]
    return None


def slug(heading: str) -> str:
    """The anchor that forges give a heading: "4. Swing, eq. (8)" is 4-swing-eq-8."""
    return re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-")


def _html(text: str) -> Markup:
    return Markup(MarkdownIt("commonmark").enable("table").render(text))


# ---- variables -------------------------------------------------------------------------------------


@dataclass(frozen=True)
class DocumentedVariable:
    """One variable, as text."""

    name: str
    direction: str  # in, out or empty
    text: str
    unit: str
    value: str  # start value, empty where the model calculates it
    display: str  # the unit that tools show it in, if another one
    shown: str  # the value in that unit
    bounds: str
    remarks: Sequence[str]
    number: Number | None  # where the value comes from


@dataclass(frozen=True)
class VariableGroup:
    """Rows under a heading."""

    title: str
    rows: Sequence[DocumentedVariable]
    name: str = ""  # of the terminal


def _row(v: Variable, sources: Mapping[str, Number]) -> DocumentedVariable:
    q, number = v.quantity, sources.get(v.name)
    if number is not None and number.value != v.start:
        number = None  # built with another value than that of the file
    value = "calculated" if v.kind == "CALCULATED_STATE" else ""
    if v.start is not None:
        value = printed(v.start) + (f" ± {printed(number.sd)}" if number and number.sd else "")
    customary, shown = display_conversion(q.unit), ""
    if customary and v.start is not None:
        shown = f"{printed(float(f'{v.start * customary[1]:.4g}'))} {pretty(customary[0])}"
    return DocumentedVariable(
        name=v.name,
        direction="in" if v.kind == "INPUT" else "out" if v.output else "",
        text=q.text,
        unit=pretty(q.unit),
        value=value,
        display=pretty(customary[0]) if customary else "",
        shown=shown,
        bounds=_bounds(q.minimum, q.maximum),
        remarks=list(_remarks(v)),
        number=number,
    )


def _remarks(v: Variable) -> Iterable[str]:
    """What the words of the declaration do not say."""
    if v.kind == "TUNABLE":
        yield "tunable"
    if v.quantity.rate:
        yield f"moves with {v.quantity.rate} inside a step"
    if v.quantity.warn_above is not None:
        yield f"warning above {printed(v.quantity.warn_above)} {pretty(v.quantity.unit)}"


def _bounds(low: float | None, high: float | None) -> str:
    if low is not None and high is not None:
        return f"{printed(low)} to {printed(high)}"
    return f"≥ {printed(low)}" if low is not None else f"≤ {printed(high)}" if high is not None else ""


def printed(value: float) -> str:
    """A number as in a data sheet: 1.6·10⁹ for 1600000000.0, with a true minus."""
    return typeset(f"{value:.6g}")


def _ports(sub: Subsystem, rows: Mapping[str, DocumentedVariable]) -> list[VariableGroup]:
    """Inputs and outputs by terminal, then the rest."""
    rest = {name: row for name, row in rows.items() if row.direction}
    groups = []
    for terminal in sub.terminals:
        members = [rest.pop(m.variable) for m in terminal.members if m.variable in rest]
        groups.append(VariableGroup(terminal.text, members, terminal.name))
    for direction, title in (("in", "Other inputs"), ("out", "Other outputs")):
        groups.append(VariableGroup(title, [row for row in rest.values() if row.direction == direction]))
    return [group for group in groups if group.rows]


# ---- page ------------------------------------------------------------------------------------------


def page(sub: Subsystem, interface: Interface, fmi: int, step: float, stop: float, icon: bytes | None) -> str:
    """One self-contained HTML page; step and stop are the default experiment [s]."""
    environment = Environment(
        loader=PackageLoader("fmus.export"),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=StrictUndefined,
    )
    text, sections = prose(sub.folder / "README.md", sub.variant)
    has_file = sub.numbers is not None or sub.values is None or sub.values.is_file()
    sources = {name: n for table in numbers(sub).values() for name, n in table.items()} if has_file else {}
    rows = {v.name: _row(v, sources) for v in interface.variables}
    parameters: dict[str, list[DocumentedVariable]] = {}
    for v in interface.parameters:
        parameters.setdefault(v.quantity.group, []).append(rows[v.name])
    start = [  # of states and inputs: what has a source, or may be set
        rows[v.name]
        for v in (*interface.states, *interface.inputs)
        if v.start is not None and (v.name in sources or v.kind == "STATE")
    ]
    listed = [rows[v.name] for v in interface.parameters] + start
    used = {row.number.source for row in listed if row.number}
    return environment.get_template("page.html.j2").render(
        sub=sub,
        fmi=fmi,
        version=package_version(),
        step=printed(step),
        stop=printed(stop),
        tolerance=printed(DEFAULT_TOLERANCE),
        stiff=interface.stiff,
        rates=any(v.quantity.rate for v in interface.inputs),
        icon=b64encode(icon).decode() if icon else "",
        style=Markup(environment.get_template("page.css").render()),
        text=text,
        sections=sections,
        ports=_ports(sub, rows),
        parameters=[VariableGroup(title, group) for title, group in parameters.items()],
        start=[VariableGroup("", start)] if start else [],
        hidden=[
            rows[v.name] for v in interface.states if not v.output
        ],  # of derivatives nobody wants a table
        sources={word: meaning for word, meaning in SOURCES.items() if word in used},
        categories=LOG_CATEGORIES,
        proof=PAGE.rpartition("/")[2] if ls_ref_files(sub) else "",
    )
