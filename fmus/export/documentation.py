"""documentation/index.html of an FMU: what it is, its ports and numbers, its equations, in one file."""

from __future__ import annotations

from base64 import b64encode

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from fmus.contract import Subsystem
from fmus.export import tables
from fmus.export.codegen import DEFAULT_TOLERANCE
from fmus.export.interface import Interface
from fmus.export.model_description import LOG_CATEGORIES, package_version
from fmus.export.proof import PAGE, proof
from fmus.export.prose import prose
from fmus.parameters import SOURCES


def page(sub: Subsystem, face: Interface, fmi: int, step: float, stop: float, icon: bytes | None) -> str:
    """One self-contained HTML page; step and stop are the default experiment [s]."""
    loader = PackageLoader("fmus.export")
    environment = Environment(
        loader=loader, autoescape=True, trim_blocks=True, lstrip_blocks=True, undefined=StrictUndefined
    )
    text, sections = prose(sub.values.parent / "README.md", sub.variant)
    groups = tables.parameters(sub, face)
    start = tables.start_values(sub, face)
    used = {row.number.source for group in (*groups, *start) for row in group.rows if row.number}
    return environment.get_template("page.html.j2").render(
        sub=sub,
        fmi=fmi,
        version=package_version(),
        step=tables.figure(step),
        stop=tables.figure(stop),
        tolerance=tables.figure(DEFAULT_TOLERANCE),
        stiff=face.stiff,
        rates=any(v.quantity.rate for v in face.inputs),
        icon=b64encode(icon).decode() if icon else "",
        style=Markup(environment.get_template("page.css").render()),
        text=text,
        sections=sections,
        ports=tables.ports(sub, face),
        parameters=groups,
        start=start,
        hidden=tables.hidden(face),
        sources={word: meaning for word, meaning in SOURCES.items() if word in used},
        categories=LOG_CATEGORIES,
        proof=PAGE.rpartition("/")[2] if proof(sub) else "",
    )
