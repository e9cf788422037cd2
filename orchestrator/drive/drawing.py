"""Data of the drawing for a browser: bodies, colours of pressures, and views.

`web/scene.js` and `web/rig.js` draw it.

The colour scale of cylinders, hoses, gauges and legend is matplotlib's plasma (Smith and van der Walt 2015).
Its lightness is monotone, so it is readable with any colour blindness. Its palest end is left out, because it
is hard to see on light background.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

from matplotlib import colormaps
from matplotlib.colors import to_hex

from orchestrator.drive import bodies
from orchestrator.drive.geometry import GROUND, NODES, Geometry

STEPS = 33  # distinct colours; a colour is sent to the browser only when it changes
UNKNOWN = "#8b9196"

SCALE: Sequence[str] = tuple(to_hex(colormaps["plasma"](0.04 + 0.88 * k / (STEPS - 1))) for k in range(STEPS))


SCHEMES = {
    "light": {"sky": "#dfe6e8", "floor": "#c9cfc4", "grid": "#b7beb3", "axis": "#98a094"},
    "dark": {"sky": "#1d2427", "floor": "#2a312d", "grid": "#39433d", "axis": "#4d5951"},
}
SHADE = {"light": "#aab2a6", "dark": "#191e1b"}
SUN = (4.0, -6.0, 12.0)  # direction of the sun
VIEWS: Mapping[str, tuple[float, float, float, float, float, float]] = {
    "quarter": (8.4, -11.9, 4.8, 1.5, 0.0, 1.15),
    "side": (2.0, -13.0, 1.4, 2.0, 0.0, 1.0),
    "top": (1.6, -0.1, 13.5, 1.6, 0.0, 0.0),
    "cab": (-1.2, 0.9, 1.9, 5.0, 0.0, -0.2),
}


def scene(geometry: Geometry) -> dict[str, Any]:
    """Data of the machine, and of its surroundings in both colour schemes."""
    every = [*bodies.site_parts(), *bodies.crane_parts(geometry), *bodies.head_parts(geometry)]
    machine = {"parts": [part.data() for part in every], "nodes": list(NODES), "sizes": asdict(geometry)}
    place = {"ground": GROUND, "sun": SUN}
    ground = {"trees": bodies.trees(), **place}
    grounds = {scheme: ground | colours for scheme, colours in SCHEMES.items()}
    return {"machine": machine | place, "shade": SHADE, "ground": grounds, "level": GROUND, "views": VIEWS}
