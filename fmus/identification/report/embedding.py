"""The ways out of a figure: PNG for documents, SVG inside a page."""

from __future__ import annotations

import base64
import io
import re

from markupsafe import Markup
from matplotlib import rc_context
from matplotlib.figure import Figure

from fmus.identification.report.style import PALETTE

DPI = 150
# An SVG above this size [characters] is embedded as PNG instead.
SVG_LIMIT = 700_000


def png(figure: Figure, dpi: int = DPI) -> bytes:
    """The figure as PNG on white."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=dpi)
    return buffer.getvalue()


def svg(figure: Figure) -> str:
    """The figure as SVG text: text stays text, the same figure gives the same bytes."""
    buffer = io.StringIO()
    with rc_context({"svg.fonttype": "none", "svg.hashsalt": "harvester", "path.simplify_threshold": 0.2}):
        figure.savefig(buffer, format="svg", transparent=True, metadata={"Date": None})
    return buffer.getvalue()


def embed(figure: Figure, prefix: str, title: str) -> Markup:
    """The figure for HTML: SVG whose colours follow the page's theme, or PNG if that would be too large."""
    text = svg(figure)
    if len(text) > SVG_LIMIT:
        data = Markup(base64.b64encode(png(figure)).decode())
        return Markup('<img class="paper" alt="{}" src="data:image/png;base64,{}">').format(title, data)
    return Markup(_inline(text, prefix, title))


def _inline(text: str, prefix: str, title: str) -> str:
    """An SVG file as an HTML element: no prologue, no metadata, own ids, colours as CSS variables."""
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(r'\sxmlns(:\w+)?="[^"]*"', "", text).replace("xlink:href", "href")
    label = Markup.escape(title)
    text = re.sub(r'(<svg [^>]*?)width="[^"]*"', r'\1width="100%"', text, count=1)
    text = re.sub(r'(<svg [^>]*?)height="[^"]*"', rf'\1role="img" aria-label="{label}"', text, count=1)
    text = re.sub(r'\bid="|href="#|url\(#', lambda match: match[0] + prefix, text)
    text = re.sub(r'\bd="[^"]*"', lambda path: re.sub(r"(\.\d\d)\d+", r"\1", path[0]), text)
    for name, colour in _theme().items():
        text = text.replace(colour, f"var(--{name}, {colour})")
    return re.sub(r"\s*\n\s*", "\n", text)


def _theme() -> dict[str, str]:
    """CSS variable -> the colour it stands for in the light theme."""
    words = {f"fig-{word}": getattr(PALETTE, word) for word in ("ink", "faint", "grid", "good", "bad")}
    for k, (measured, fit) in enumerate(PALETTE.pairs):
        words |= {f"fig-m{k}": measured, f"fig-f{k}": fit}
    return words
