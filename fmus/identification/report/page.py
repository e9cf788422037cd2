"""The report of an identification: one self-contained HTML file, and the same numbers as JSON."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import asdict, fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from fmus.identification.finding import Finding
from fmus.identification.report import captions, figures, matrix, words
from fmus.identification.report.content import Page
from fmus.identification.report.embedding import embed
from fmus.identification.report.style import prose

TEMPLATES = Path(__file__).with_name("templates")
NAME = "identification"


def write_page(folder: Path, page: Page) -> tuple[Path, Path]:
    """Write identification.html and identification.json to a folder; returns both paths."""
    folder.mkdir(parents=True, exist_ok=True)
    html, data = folder / f"{NAME}.html", folder / f"{NAME}.json"
    html.write_text(render(page), encoding="utf-8", newline="\n")
    text = json.dumps(numbers(page), indent=1, allow_nan=False, ensure_ascii=False)
    data.write_text(text + "\n", encoding="utf-8", newline="\n")
    return html, data


def render(page: Page) -> str:
    """The HTML text; no content from other servers."""
    environment = Environment(
        loader=FileSystemLoader(TEMPLATES),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["prose"] = prose
    joint = page.refinement
    return environment.get_template("identification.html.j2").render(
        page=page,
        words=words,
        origin=captions.origin(page.kinds),
        findings=[(f, _figure(f, k, page.kinds), captions.caption(f, page.kinds)) for k, f in _all(page)],
        heat=None
        if joint is None or len(joint.names) < 2
        else embed(matrix.draw(joint.names, joint.correlation), "c-", "Correlation"),
        pictures=[(p, embed(p.figure, f"t{k}-", p.title)) for k, p in enumerate(page.pictures)],
        style=Markup((TEMPLATES / "identification.css").read_text(encoding="utf-8")),
    )


def _all(page: Page) -> Iterable[tuple[int, Finding]]:
    return enumerate(page.findings)


def _figure(finding: Finding, place: int, kinds: Iterable[str]) -> Markup | None:
    if not finding.panels:
        return None
    return embed(figures.draw(finding, kinds, titled=False), f"f{place}-", finding.title)


def numbers(page: Page) -> dict[str, Any]:
    """All numbers of the page in SI units, without the curves of the figures."""
    found = {f.name: getattr(page, f.name) for f in fields(page) if f.name not in ("findings", "pictures")}
    found["findings"] = [{k: v for k, v in _shallow(f).items() if k != "panels"} for f in page.findings]
    plain: dict[str, Any] = _plain(found)
    return plain


def _shallow(value: Any) -> dict[str, Any]:
    return {f.name: getattr(value, f.name) for f in fields(value)}


def _plain(value: Any) -> Any:
    """Dataclasses, mappings, sequences and NumPy numbers as JSON knows them; what is not finite is null."""
    if is_dataclass(value) and not isinstance(value, type):
        return _plain(asdict(value))
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, str | bool) or value is None:
        return value
    if isinstance(value, int | np.integer):
        return int(value)
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, Iterable):
        return [_plain(item) for item in value]
    return str(value)
