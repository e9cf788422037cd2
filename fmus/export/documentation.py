"""The written part of an FMU's documentation: the subsystem's README and the sections that it links to.

What the documentation of an FMU shows of its variables: rows of text, grouped.

documentation/index.html of an FMU: what it is, its ports and numbers, its equations, in one file.
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
from fmus.export.model_description import LOG_CATEGORIES
from fmus.export.reference_experiment import PAGE, proof
from fmus.parameters import SOURCES, Number, Tables, numbers
from orchestrator.base.units import display
from orchestrator.ssp.common import package_version

_LINK = re.compile(r"\[([^\]]*)\]\(([^)\s]+)\)")
_VARIANT = re.compile(r"^## ([a-z_]+)\n(?:(?!## ).*\n?)*", re.MULTILINE)
_HEADING = re.compile(r"^(#+) +(.*)$", re.MULTILINE)


def shipped(name: str) -> Path | None:
    """A file by its path in a checkout, such as data/x.csv; an installed package has a copy inside."""
    package = Path(__file__).parents[1]
    return next((folder / name for folder in (package.parent, package) if (folder / name).is_file()), None)


@dataclass(frozen=True)
class Section:
    """A section of another document."""

    anchor: str
    title: str
    html: Markup

    @property
    def short(self) -> str:
        """The title without its number and what follows a comma."""
        return re.sub(r"^[\d.]+ ", "", self.title).partition(",")[0]


def prose(readme: Path, variant: str = "") -> tuple[Markup, list[Section]]:
    """A README without its title as HTML, and the sections of other documents that it links to.

    Of the sections about variants, whose headings are plain lower-case names, only that of `variant` stays.
    """
    if not readme.is_file():
        return Markup(), []
    text = re.sub(r"\A# .*\n", "", readme.read_text(encoding="utf-8"))
    text = _VARIANT.sub(lambda section: section[0] if section[1] == variant else "", text)
    sections: dict[str, str] = {}
    for _, target in _LINK.findall(text):
        file, _, anchor = target.partition("#")
        found = _section(readme, file, anchor) if file.endswith(".md") and anchor else None
        if found:
            sections[anchor] = found
    text = _LINK.sub(lambda match: _inside(match, sections), text)
    return _html(text), [_section_shown(anchor, section) for anchor, section in sections.items()]


def _section_shown(anchor: str, section: str) -> Section:
    title, body = section.split("\n", 1)
    return Section(anchor, title.lstrip("# "), _html(_LINK.sub(r"\1", body)))


def _inside(match: re.Match[str], sections: dict[str, str]) -> str:
    """A link as it works in the one page: to a section in it, to the web, else only its words."""
    words, target = match[1], match[2]
    anchor = target.partition("#")[2]
    if anchor in sections:
        return f"[{words}](#{anchor})"
    return match[0] if target.startswith(("http://", "https://")) else words


def _section(readme: Path, file: str, anchor: str) -> str | None:
    """The section of a Markdown file with this anchor, from its heading to the next of the same rank."""
    path = readme.parent / file
    if not path.is_file():  # installed without the folder of the documents
        path = shipped(file.removeprefix("../../")) or path
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


_SUPERSCRIPTS = str.maketrans("0123456789-", "⁰¹²³⁴⁵⁶⁷⁸⁹⁻")


@dataclass(frozen=True)
class Row:
    """One variable."""

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
class Group:
    """Rows under a heading."""

    title: str
    rows: Sequence[Row]
    name: str = ""  # of the terminal


def ports(sub: Subsystem, face: Interface) -> list[Group]:
    """Inputs and outputs by terminal, then the rest."""
    found = _provenance(sub)
    table = {v.name: _row(v, found) for v in face.variables if v.kind == "INPUT" or v.output}
    groups = []
    for terminal in sub.terminals:
        members = [table.pop(m.variable) for m in terminal.members if m.variable in table]
        groups.append(Group(terminal.text, members, terminal.name))
    rest = list(table.values())
    for direction, title in (("in", "Other inputs"), ("out", "Other outputs")):
        groups.append(Group(title, [row for row in rest if row.direction == direction]))
    return [group for group in groups if group.rows]


def parameters(sub: Subsystem, face: Interface) -> list[Group]:
    """The parameters under the headings of their declaration."""
    found = _provenance(sub)
    groups: dict[str, list[Row]] = {}
    for v in face.parameters:
        groups.setdefault(v.quantity.group, []).append(_row(v, found))
    return [Group(title, rows) for title, rows in groups.items()]


def start_values(sub: Subsystem, face: Interface) -> list[Group]:
    """States and inputs that start at a number with a source, or may be given one."""
    found = _provenance(sub)
    given = [v for v in (*face.states, *face.inputs) if v.start is not None]
    rows = [_row(v, found) for v in given if v.name in found or v.kind == "STATE"]
    return [Group("", rows)] if rows else []


def hidden(face: Interface) -> list[Row]:
    """States that are no outputs; of the derivatives nobody wants a table."""
    return [_row(v, {}) for v in face.states if not v.output]


def _provenance(sub: Subsystem) -> dict[str, Number]:
    if sub.numbers is None and sub.values is not None and not sub.values.is_file():
        return {}
    tables: Tables = numbers(sub)
    return {name: n for table in tables.values() for name, n in table.items()}


def _row(v: Variable, found: Mapping[str, Number]) -> Row:
    q = v.quantity
    number = found.get(v.name)
    known = number if number and number.value == v.start else None
    return Row(
        v.name,
        "in" if v.kind == "INPUT" else "out" if v.output else "",
        q.text,
        pretty(q.unit),
        _value(v, known),
        *_shown(v),
        _bounds(q.minimum, q.maximum),
        list(_remarks(v)),
        known,
    )


def _value(v: Variable, number: Number | None) -> str:
    if v.start is None:
        return "calculated" if v.kind == "CALCULATED_STATE" else ""
    return figure(v.start) + (f" ± {figure(number.sd)}" if number and number.sd else "")


def _shown(v: Variable) -> tuple[str, str]:
    """The display unit, and the start value in it."""
    other = display(v.quantity.unit)
    if other is None:
        return "", ""
    unit = pretty(other[0])
    if v.start is None:
        return unit, ""
    rounded = float(f"{v.start * other[1]:.4g}")
    return unit, f"{figure(rounded)} {unit}"


def _remarks(v: Variable) -> Iterable[str]:
    """What the words of the declaration do not say."""
    if v.kind == "TUNABLE":
        yield "tunable"
    if v.quantity.rate:
        yield f"moves with {v.quantity.rate} inside a step"
    if v.quantity.warn_above is not None:
        yield f"warning above {figure(v.quantity.warn_above)} {pretty(v.quantity.unit)}"


def _bounds(low: float | None, high: float | None) -> str:
    if low is not None and high is not None:
        return f"{figure(low)} to {figure(high)}"
    return f"≥ {figure(low)}" if low is not None else f"≤ {figure(high)}" if high is not None else ""


def figure(value: float) -> str:
    """A number as in a data sheet: 1.6e9 for 1600000000.0, with a true minus."""
    text = re.sub(r"e([+-])0*(\d+)", lambda m: f"e{m[1].strip('+')}{m[2]}", f"{value:.6g}")
    return text.replace("-", "\N{MINUS SIGN}")


def pretty(unit: str) -> str:
    """A unit as it is printed: N·m·s/rad, m³/s; nothing for 1."""
    powers = re.sub(r"(?<=[A-Za-z])-?\d+", lambda m: m[0].translate(_SUPERSCRIPTS), unit)
    return "" if unit == "1" else powers.replace(".", "·")


def page(sub: Subsystem, face: Interface, fmi: int, step: float, stop: float, icon: bytes | None) -> str:
    """One self-contained HTML page; step and stop are the default experiment [s]."""
    loader = PackageLoader("fmus.export")
    environment = Environment(
        loader=loader, autoescape=True, trim_blocks=True, lstrip_blocks=True, undefined=StrictUndefined
    )
    text, sections = prose(sub.folder / "README.md", sub.variant)
    groups = parameters(sub, face)
    start = start_values(sub, face)
    used = {row.number.source for group in (*groups, *start) for row in group.rows if row.number}
    return environment.get_template("page.html.j2").render(
        sub=sub,
        fmi=fmi,
        version=package_version(),
        step=figure(step),
        stop=figure(stop),
        tolerance=figure(DEFAULT_TOLERANCE),
        stiff=face.stiff,
        rates=any(v.quantity.rate for v in face.inputs),
        icon=b64encode(icon).decode() if icon else "",
        style=Markup(environment.get_template("page.css").render()),
        text=text,
        sections=sections,
        ports=ports(sub, face),
        parameters=groups,
        start=start,
        hidden=hidden(face),
        sources={word: meaning for word, meaning in SOURCES.items() if word in used},
        categories=LOG_CATEGORIES,
        proof=PAGE.rpartition("/")[2] if proof(sub) else "",
    )
