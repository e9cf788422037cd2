"""documentation/index.html of an FMU: description, equations, ports and parameter values on one page.

The text is the README of the subsystem, with the sections of other documents that it links to. The tables
contain the variables. Formulas, LaTeX between dollar signs as on git servers, become MathML: the page needs
neither JavaScript nor a server.
"""

import re
from base64 import b64encode
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from latex2mathml.converter import convert
from lxml import etree
from markdown_it import MarkdownIt
from markdown_it.rules_inline import StateInline
from markdown_it.token import Token
from markdown_it.utils import EnvType
from markupsafe import Markup

from fmus.contract import Subsystem
from fmus.export.c_code import DEFAULT_TOLERANCE, TEMPLATES
from fmus.export.graph import graphs
from fmus.export.interface import Interface, Variable
from fmus.export.model_description import LOG_CATEGORIES, PAGE, ls_ref_files
from fmus.package_files import project_file
from fmus.parameters import SOURCES, Number, numbers
from orchestrator.base.errors import Problem
from orchestrator.base.text import grouped, rendered, typeset
from orchestrator.base.units import display_conversion, pretty
from orchestrator.base.xml import package_version

_LINK = re.compile(r"\[([^\]]*)\]\(([^)\s]+)\)")
_VARIANT = re.compile(r"^## ([a-z_]+)\n(?:(?!## ).*\n?)*", re.MULTILINE)
_HEADING = re.compile(r"^(#+) +(.*)$", re.MULTILINE)
_FORMULA = re.compile(r"\$\$(?P<display>[^$]+)\$\$|\$(?P<inline>[^\s$](?:[^$\n]*[^\s$])?)\$(?![\w$])")
_FUNCTION = re.compile(  # a space precedes "ln"; one follows it, except before "(" or at an end
    r"<m[io]>(cos|exp|height|ln|max|min|sign|sin)</m[io]>"
    r'(<mo stretchy="false">&#x00028;|<mrow><mo stretchy=|</)?'
)
_NOT_CONVERTED = re.compile(r"\\[A-Za-z]+\*?|<mi>&</mi>")


# ---- README ------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class LinkedSection:
    """A section of another document."""

    anchor: str
    title: str
    html: Markup

    @property
    def short(self) -> str:
        """The title without its section number and without the part after a comma."""
        return re.sub(r"^[\d.]+ ", "", self.title).partition(",")[0]


def prose(readme: Path, variant: str = "") -> tuple[Markup, list[LinkedSection]]:
    """A README without its title as HTML, and the sections of other documents that it links to.

    Sections about other variants are left out; the heading of such a section is the name of the variant.
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
            html = _html(_LINK.sub(r"\1", body), file)
            linked[anchor] = LinkedSection(anchor, title.lstrip("# "), html)

    def page_link(match: re.Match[str]) -> str:
        """The link to a section of the page or to the web; for other targets only its text."""
        text, target = match[1], match[2]
        anchor = target.partition("#")[2]
        if anchor in linked:
            return f"[{text}](#{anchor})"
        return match[0] if target.startswith(("http://", "https://")) else text

    return _html(_LINK.sub(page_link, text), readme), list(linked.values())


def _section(readme: Path, file: str, anchor: str) -> str | None:
    """The section of a Markdown file with this anchor, up to the next heading of its level or above."""
    path = readme.parent / file
    if not path.is_file():  # installed without the folder of the documents
        path = project_file(file.lstrip("./")) or path
    text = path.read_text(encoding="utf-8") if path.is_file() else ""
    headings = list(_HEADING.finditer(text))
    for i, heading in enumerate(headings):
        if slug(heading[2]) == anchor:
            ends = (h.start() for h in headings[i + 1 :] if len(h[1]) <= len(heading[1]))
            return text[heading.start() : next(ends, len(text))]
    return None


def slug(heading: str) -> str:
    """The anchor of a heading as on GitHub: "4. Swing, eq. (8)" becomes 4-swing-eq-8."""
    return re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-")


@cache
def _html(text: str, file: Path | str) -> Markup:
    reader = MarkdownIt("commonmark").enable("table").use(formulas)
    return Markup(reader.render(text, {"file": str(file)}))


# ---- formulas ----------------------------------------------------------------------------------------


def formulas(reader: MarkdownIt) -> None:
    """A plugin for markdown-it: `$...$` and `$$...$$` become MathML; `env["file"]` is named in a Problem."""

    def rule(state: StateInline, silent: bool) -> bool:
        found = _FORMULA.match(state.src, state.pos) if state.src[state.pos] == "$" else None
        if found and not silent:
            token = state.push("formula", "math", 0)
            token.content, token.block = found[found.lastgroup or 0], found.lastgroup == "display"
        state.pos = found.end() if found else state.pos
        return bool(found)

    def render(_self: object, tokens: Sequence[Token], i: int, _options: object, env: EnvType) -> str:
        return mathml(tokens[i].content, tokens[i].block, env.get("file", ""))

    reader.inline.ruler.before("escape", "formula", rule)
    reader.add_render_rule("formula", render)


def mathml(latex: str, display: bool = False, file: str = "") -> str:
    """MathML of a formula in LaTeX, on a line of its own if `display`; a Problem if it does not convert.

    latex2mathml knows neither `aligned` nor that \\lvert and \\rvert are a pair.
    """
    where = f"{file}: formula {latex.strip()}"
    text = re.sub(r"\\(begin|end)\{aligned\}", r"\\\1{align*}", latex)
    text = re.sub(r"(?<!left)(?<!right)\\([lr])(vert|angle)\b", lambda m: f"\\{SIDES[m[1]]}{m[0]}", text)
    try:
        made = convert(text, display="block" if display else "inline")
    except Exception as error:  # of many classes, most without a message
        reason = str(error) or type(error).__name__
        raise Problem(f"{where}: expected LaTeX, {reason}") from None
    if unknown := _NOT_CONVERTED.search(made):
        raise Problem(f"{where}: expected commands of LaTeX, found {unknown[0]}")
    for element in etree.fromstring(made).iter():
        if len(element) != ARITY.get(etree.QName(element).localname, len(element)):
            raise Problem(f"{where}: expected LaTeX, found a command without an argument")
    return _FUNCTION.sub(_spaced, made)


def _spaced(name: re.Match[str]) -> str:
    return f'<mo lspace="0.17em" rspace="{"0" if name[2] else "0.17em"}">{name[1]}</mo>{name[2] or ""}'


ARITY = {"mfrac": 2, "mroot": 2, "msub": 2, "msup": 2, "mover": 2, "munder": 2, "msubsup": 3, "munderover": 3}
SIDES = {"l": "left", "r": "right"}  # which \\left or \\right a fence needs to be stretched and spaced as one


# ---- variables -------------------------------------------------------------------------------------


Row = dict[str, Any]  # texts of one variable for the tables, by the names that the template uses


def _group(title: str, rows: Sequence[Row], terminal: str = "") -> dict[str, Any]:
    """Rows of a table with a heading; `terminal` is the name of a terminal."""
    return {"title": title, "members": rows, "terminal": terminal}


def _row(v: Variable, sources: Mapping[str, Number]) -> Row:
    """Texts of a variable; those for display are empty if tools use the SI unit for it."""
    q, number = v.quantity, sources.get(v.name)
    if number is not None and number.value != v.start:
        number = None  # the FMU is built with another value
    value = "calculated" if v.kind == "CALCULATED_STATE" else ""
    if v.start is not None:
        value = printed(v.start) + (f" ± {printed(number.sd)}" if number and number.sd else "")
    display_unit, display_value = "", ""
    if customary := display_conversion(q.unit):
        display_unit = pretty(customary[0])
        if v.start is not None:
            display_value = f"{printed(float(f'{v.start * customary[1]:.4g}'))} {display_unit}"
    return {
        "name": v.name,
        "direction": "in" if v.kind == "INPUT" else "out" if v.output else "",
        "description": q.text,
        "unit": pretty(q.unit),
        "value": value,
        "display_unit": display_unit,
        "display_value": display_value,
        "bounds": _bounds(q.minimum, q.maximum),
        "remarks": list(_remarks(v)),
        "number": number,  # source of the value, if known
    }


def _row_name(v: Variable) -> str:
    """What the variables of one row have in common: those of a list have one row."""
    return v.name.rpartition("_")[0] + "_*" if v.quantity.listed else v.name


def _list_row(group: Sequence[Variable], rows: Mapping[str, Row]) -> Row:
    """One row for the entries of a list, or that of the only variable; zeros at the end are left out."""
    first = rows[group[0].name]
    if len(group) == 1:
        return first
    count = max((i for i, v in enumerate(group, 1) if v.start), default=0)
    return first | {
        "name": f"{group[0].name} to {group[-1].name.rpartition('_')[2]}",
        "description": group[0].quantity.listed,
        "value": ", ".join(rows[v.name]["value"] for v in group[:count]) or "0",
    }


def _remarks(v: Variable) -> Iterable[str]:
    """Remarks that follow the description of a variable."""
    q = v.quantity
    if v.kind == "TUNABLE":
        yield "tunable"
    if q.rate:
        yield f"changes at the rate {q.rate} inside a step"
    if q.optional:
        yield f"without it {q.optional}"
    below = ("below", q.warn_below, q.below or q.meaning)
    for where, limit, meaning in (("above", q.warn_above, q.meaning), below):
        if limit is not None:
            yield f"warning {where} {printed(limit)} {pretty(q.unit)}{': ' * bool(meaning)}{meaning}"


def _bounds(low: float | None, high: float | None) -> str:
    if low is not None and high is not None:
        return f"{printed(low)} to {printed(high)}"
    return f"≥ {printed(low)}" if low is not None else f"≤ {printed(high)}" if high is not None else ""


def printed(value: float) -> str:
    """A number as in a data sheet: 1.6·10⁹ for 1600000000.0, with the minus sign of typesetting."""
    return typeset(f"{value:.6g}")


def _ports(sub: Subsystem, rows: Mapping[str, Row]) -> list[dict[str, Any]]:
    """Inputs and outputs by terminal, then those without a terminal."""
    ports = {name: row for name, row in rows.items() if row["direction"]}
    groups = [
        _group(t.text, [ports.pop(m.variable) for m in t.members if m.variable in ports], t.name)
        for t in sub.terminals
    ]
    for direction, title in (("in", "Other inputs"), ("out", "Other outputs")):
        groups.append(_group(title, [row for row in ports.values() if row["direction"] == direction]))
    return [group for group in groups if group["members"]]


# ---- page ------------------------------------------------------------------------------------------


def page(sub: Subsystem, interface: Interface, fmi: int, step: float, stop: float, icon: bytes | None) -> str:
    """One self-contained HTML page; step and stop are the default experiment [s]."""
    text, sections = prose(sub.folder / "README.md", sub.variant)
    has_file = sub.numbers is not None or sub.values is None or sub.values.is_file()
    sources = {name: n for table in numbers(sub).values() for name, n in table.items()} if has_file else {}
    rows = {v.name: _row(v, sources) for v in interface.variables}
    lists = grouped(interface.parameters, _row_name).values()
    parameters = grouped(lists, lambda variables: variables[0].quantity.group)
    start = [  # states and inputs whose start value has a source or may be set
        rows[v.name]
        for v in (*interface.states, *interface.inputs)
        if v.start is not None and (v.name in sources or v.kind == "STATE")
    ]
    with_value = [*(rows[v.name] for v in interface.parameters), *start]
    used_sources = {row["number"].source for row in with_value if row["number"]}
    return rendered(
        TEMPLATES / "page.html.j2",
        escaped=True,
        sub=sub,
        fmi=fmi,
        version=package_version(),
        step=printed(step),
        stop=printed(stop),
        tolerance=printed(DEFAULT_TOLERANCE),
        stiff=interface.stiff,
        rates=any(v.quantity.rate for v in interface.inputs),
        icon=b64encode(icon).decode() if icon else "",
        style=Markup(rendered(TEMPLATES / "page.css")),
        text=text,
        sections=sections,
        graphs={name: Markup(graph) for name, graph in graphs(sub).items()},
        ports=_ports(sub, rows),
        directions={name: row["direction"] for name, row in rows.items()},
        not_zero=[rows[v.name] for v in interface.inputs if v.start],
        parameters=[_group(t, [_list_row(v, rows) for v in group]) for t, group in parameters.items()],
        start=[_group("", start)] if start else [],
        local_states=[rows[v.name] for v in interface.states if not v.output],
        sources={source: meaning for source, meaning in SOURCES.items() if source in used_sources},
        categories=LOG_CATEGORIES,
        experiment_page=PAGE.rpartition("/")[2] if ls_ref_files(sub) else "",
    )
