"""Data of the drawing for a browser: the machine, its surroundings, and the colours of pressures.

`web/scene.js` and `web/rig.js` draw it.

The colour scale of cylinders, hoses, gauges and legend is matplotlib's plasma (Smith and van der Walt 2015).
Its lightness is monotone, so it is readable with any colour blindness. Its palest end is left out, because it
is hard to see on light background.
"""

from collections.abc import Sequence
from typing import Any

from orchestrator.drive.scene import Scene, Values, data

STEPS = 33  # distinct colours; a colour is sent to the browser only when it changes
UNKNOWN, MARKED = "#8b9196", "#00b7ff"  # no pressure; a fault: light blue is none of the scale

# matplotlib's "plasma" from 0.04 to 0.92, without an import that takes longer than the drawing
SCALE: Sequence[str] = (
    *("#260591", "#330597", "#3f049c", "#4b03a1", "#5601a4", "#6100a7", "#6c00a8", "#7701a8", "#8104a7"),
    *("#8b0aa5", "#9511a1", "#9e199d", "#a72197", "#b02991", "#b7318a", "#bf3984", "#c6417d", "#cc4977"),
    *("#d35171", "#da5a6a", "#df6263", "#e56a5d", "#e97257", "#ee7b51", "#f2844b", "#f68d45", "#f9973f"),
    *("#fba139", "#fdab33", "#fdb52e", "#fec029", "#fdcb26", "#fbd724"),
)


SCHEMES = {
    "light": {"sky": "#dfe6e8", "floor": "#c9cfc4", "grid": "#b7beb3", "axis": "#98a094"},
    "dark": {"sky": "#1d2427", "floor": "#2a312d", "grid": "#39433d", "axis": "#4d5951"},
}
SHADE = {"light": "#aab2a6", "dark": "#191e1b"}
SUN = (4.0, -6.0, 12.0)  # direction of the sun


def scene(declared: Scene, values: Values) -> dict[str, Any]:
    """Data of the machine, and of its surroundings in both colour schemes."""
    place = {"ground": declared.ground, "sun": SUN}
    grounds = {scheme: place | colours for scheme, colours in SCHEMES.items()}
    shown = {"shade": SHADE, "ground": grounds, "level": declared.ground, "views": declared.views}
    return {"machine": data(declared, values) | place, **shown}


def mark(shapes: Sequence[dict[str, Any]], declared: Scene, faults: Sequence[str]) -> None:
    """Colour the shapes where faults are, by the first words of their names.

    Of a fault of an angle or speed it is the body that the joint moves, else what shows the pressures of that
    function, or one of them: a fault boom_head_leak is at the hose and chamber boom_head.
    """
    for name in faults:
        words = set(name.split("_"))
        bodies = {b for b, joint in declared.joints.items() if _begins(name, joint.signal)}
        bodies = bodies if words & {"angle", "speed"} else set()
        of_function = {channel for channel in declared.pressures if _begins(name, channel)}
        channels = {c for c in of_function if set(c.split("_")) <= words} or of_function
        for shape in shapes:
            if shape["body"] in bodies or (not bodies and shape["channel"] in channels):
                shape |= {"colour": MARKED, "channel": ""}


def _begins(name: str, part: str) -> bool:
    """Does a name begin with that of a part but for its last word?"""
    function = part.rpartition("_")[0]
    return bool(function) and name.startswith(f"{function}_")
