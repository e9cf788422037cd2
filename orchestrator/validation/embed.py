"""Figures inside an HTML page: SVG that follows the page's colours, or PNG where that would be too large."""

from __future__ import annotations

import base64
import re

from markupsafe import Markup
from matplotlib.figure import Figure

from orchestrator.validation.figures import PALETTE, png, svg

# An SVG above this size [characters] is embedded as PNG instead.
SVG_LIMIT = 700_000


def embed(figure: Figure, prefix: str, title: str) -> Markup:
    """The figure for HTML: SVG whose colours follow the page's theme, or PNG if that would be too large."""
    text = svg(figure)
    if len(text) > SVG_LIMIT:
        data = base64.b64encode(png(figure)).decode()
        return Markup('<img class="paper" alt="{}" src="data:image/png;base64,{}">').format(
            title, Markup(data)
        )
    return Markup(_inline(text, prefix))


def _inline(text: str, prefix: str) -> str:
    """An SVG file as an HTML element: no prologue, no metadata, own ids, colours as CSS variables."""
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(r'\sxmlns(:\w+)?="[^"]*"', "", text).replace("xlink:href", "href")
    text = re.sub(r'(<svg [^>]*?)width="[^"]*"', r'\1width="100%"', text, count=1)
    text = re.sub(r'(<svg [^>]*?)height="[^"]*"', r'\1role="img"', text, count=1)
    text = re.sub(r'\bid="|href="#|url\(#', lambda match: match[0] + prefix, text)
    text = re.sub(r'\bd="[^"]*"', lambda path: re.sub(r"(\.\d\d)\d+", r"\1", path[0]), text)
    for name, colour in _theme().items():
        text = text.replace(colour, f"var(--{name}, {colour})")
    return re.sub(r"\s*\n\s*", "\n", text)


def _theme() -> dict[str, str]:
    """CSS variable -> the colour it stands for in the light theme."""
    pairs = {
        f"{part}{k}": c for k, pair in enumerate(PALETTE.pairs) for part, c in zip("rs", pair, strict=True)
    }
    words = ("ink", "faint", "grid", "good", "bad")
    return {
        **{f"fig-{word}": getattr(PALETTE, word) for word in words},
        **{f"fig-{k}": v for k, v in pairs.items()},
    }
