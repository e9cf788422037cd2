"""How the figures of a study look: sizes that fit a column of the page, colours of options, ticks."""

from __future__ import annotations

import math

from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.ticker import FuncFormatter, MaxNLocator

from orchestrator.sweep.units import Unit, display, number
from orchestrator.validation.figures import PALETTE

WIDTH = 6.2  # in; a column of the page, text stays readable where it is 500 pixels wide
DARK = tuple(dark for _, dark in PALETTE.pairs)
LIGHT = tuple(light for light, _ in PALETTE.pairs)


def figure(height: float) -> Figure:
    """A figure as wide as a column; what is drawn as pixels is fine enough for two of them per point."""
    made = Figure(figsize=(WIDTH, height), dpi=144, layout=ConstrainedLayoutEngine(h_pad=0.05, w_pad=0.05))
    FigureCanvasAgg(made)
    return made


def axis_label(name: str, unit: Unit) -> str:
    """A quantity with its unit."""
    return f"{name} [{display(unit)}]" if display(unit) else name


def ticks(axis: Axis, count: int = 5) -> None:
    """Few ticks; very large and small numbers with their power of ten at the last tick only."""
    axis.set_major_locator(MaxNLocator(count))
    low, high = sorted(axis.get_view_interval())
    largest = max(abs(low), abs(high))
    power = math.floor(math.log10(largest)) if largest > 0 else 0
    if -3 <= power <= 4:
        axis.set_major_formatter(FuncFormatter(lambda value, _: _plain(value, high - low)))
        return

    def told(value: float, _: object) -> str:
        return _plain(value / 10.0**power, (high - low) / 10.0**power)

    axis.set_major_formatter(FuncFormatter(told))
    ending = number(10.0**power).split("·")[-1]
    label = axis.get_label_text()
    cut = label.rfind("[")
    axis.set_label_text(
        f"{label[: cut + 1]}{ending} {label[cut + 1 :]}" if cut >= 0 else f"{label} [{ending}]"
    )


def _plain(value: float, span: float) -> str:
    """As many digits as the span needs."""
    digits = max(0, 1 - math.floor(math.log10(span))) if span > 0 else 2
    text = f"{value:.{min(digits, 4)}f}"
    text = text.rstrip("0").rstrip(".") if "." in text else text
    return "0" if text == "-0" else text.replace("-", "\N{MINUS SIGN}")


def legend(made: Figure | Axes, columns: int = 3, **more: object) -> None:
    """Above what it is of: inside it would lie on the curves."""
    options = {"fontsize": 8, "frameon": False, "labelcolor": PALETTE.ink, "ncols": columns, **more}
    if isinstance(made, Figure):
        made.legend(**{"loc": "outside upper left", **options})
    else:
        made.legend(**{"loc": "lower left", "bbox_to_anchor": (0.0, 1.0), "borderaxespad": 0.2, **options})
