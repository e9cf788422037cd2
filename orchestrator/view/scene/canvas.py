"""The drawing in the browser: scene, views, colours of pressures, and target rings of a task.

The colour scale of cylinders, hoses, gauges and legend is matplotlib's plasma (Smith and van der Walt 2015).
Its lightness is monotone, so it is readable with any colour blindness. Its palest end is left out, because it
is hard to see on light background.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from matplotlib import colormaps
from matplotlib.colors import to_hex
from nicegui import ui
from nicegui.elements.scene.scene_object3d import Object3D

from orchestrator.view.scene import bodies
from orchestrator.view.scene.pose import GROUND, NODES, Geometry, ScenePose

STEPS = 33  # distinct colours; a colour is sent to the browser only when it changes
UNKNOWN = "#8b9196"

SCALE: Sequence[str] = tuple(to_hex(colormaps["plasma"](0.04 + 0.88 * k / (STEPS - 1))) for k in range(STEPS))


def colour(pressure: float, full: float) -> str:
    """Colour of a pressure [Pa] on the scale from zero to `full` [Pa]; grey if it is not finite."""
    if not math.isfinite(pressure) or full <= 0:
        return UNKNOWN
    fraction = min(1.0, max(0.0, pressure / full))
    return SCALE[round(fraction * (STEPS - 1))]


def gradient() -> str:
    """The colour scale as a CSS gradient, low to high from left to right."""
    return f"linear-gradient(to right, {', '.join(SCALE[::4])})"


NEXT, LATER = "#d55e00", "#0072b2"  # Okabe and Ito: distinct with any colour blindness

Point3 = tuple[float, float, float]


def rings(targets: Sequence[Point3], radius: float, done: int) -> list[dict[str, Any]]:
    """Rings of the remaining targets, as data for the browser. done: number of targets that are done."""
    remaining = list(targets)[done:]
    return [
        {"at": list(at), "radius": radius, "colour": LATER if k else NEXT, "strong": k == 0}
        for k, at in enumerate(remaining)
    ]


SKY, FLOOR, SHADE, GRID, AXIS = "#dfe6e8", "#c9cfc4", "#aab2a6", "#b7beb3", "#98a094"
SUN = (4.0, -6.0, 12.0)  # direction of the sun
RATE = 30  # 1/s; largest frame rate while the view is rotated
PLAIN = Path(__file__).with_name("plain.js").read_text(encoding="utf-8")
VIEWS: Mapping[str, tuple[float, float, float, float, float, float]] = {
    "quarter": (8.4, -11.9, 4.8, 1.5, 0.0, 1.15),
    "side": (2.0, -13.0, 1.4, 2.0, 0.0, 1.0),
    "top": (1.6, -0.1, 13.5, 1.6, 0.0, 0.0),
    "cab": (-1.2, 0.9, 1.9, 5.0, 0.0, -0.2),
}
TIP = "with the tip"


class Rig(Object3D, component="rig.js"):
    """The machine; `show` moves it."""


class Ground(Object3D, component="ground.js"):
    """Ground, trees and light."""


class Marks(Object3D, component="marks.js"):
    """Target rings of a task; `show` sets them."""


class Brush(Object3D, component="brush.js"):
    """Decides when the scene is drawn."""


class Canvas:
    """The scene of one page.

    ready   True when the browser has built the scene
    """

    def __init__(self, geometry: Geometry, shown: Callable[[int], None], begun: Callable[[], None]) -> None:
        """shown: called with the number of every fourth drawn picture; begun: called with a new scene."""
        self.ready = False
        ui.add_head_html(f"<script>{PLAIN}</script>")
        camera = ui.scene.perspective_camera(fov=38, near=0.3, far=200)
        self.scene = ui.scene(grid=False, background_color=SKY, fps=RATE, camera=camera, click_events=[])
        self.scene.classes("machine").on("shown", lambda event: shown(int(event.args)))
        self.scene.on("init", self._begin)
        with self.scene:
            Brush(self.scene.id)
            Ground(self.scene.id, surroundings())
            self.rig = Rig(self.scene.id, machine(geometry))
            self.aims = Marks(self.scene.id, GROUND)
        self._begun = begun
        self._colours: dict[str, str] = {}
        self._numbers: list[float] = []
        self._marks: list[dict[str, Any]] = []
        self._following = False
        self.look("quarter")

    def look(self, name: str, duration: float = 0.0) -> None:
        """Show one of the named views, or follow the tip from the current view (`TIP`)."""
        self._following = name == TIP
        if self.ready:
            self.scene.run_method("run_method_on_component", self.rig.id, "track", self._following)
        if self._following:
            return
        x, y, z, *target = VIEWS[name]
        look_at = dict(zip(("look_at_x", "look_at_y", "look_at_z"), target, strict=True))
        self.scene.move_camera(x, y, z, **look_at, duration=duration)

    def show(self, number: int, pose: ScenePose, colours: Mapping[str, str], again: bool = False) -> bool:
        """Show a pose. Returns False if nothing has changed. Only changed colours are sent."""
        changed = {name: c for name, c in colours.items() if self._colours.get(name) != c}
        numbers = pose.flat()
        if not (changed or again) and numbers == self._numbers:
            return False
        self._colours.update(changed)
        self._numbers = numbers
        self._call(self.rig, number, numbers, changed, again)
        return True

    def marks(self, marks: list[dict[str, Any]]) -> None:
        """Show rings, see `rings`, if they have changed."""
        if marks != self._marks and self.ready:
            self._marks = marks
            self._call(self.aims, marks)

    def _begin(self) -> None:
        """Reset: a new scene has no pose, colours or rings."""
        self._colours.clear()
        self._numbers, self._marks = [], []
        self.ready = True
        if self._following:
            self.look(TIP)
        self._begun()

    def _call(self, target: Object3D, *arguments: Any) -> None:
        self.scene.run_method("run_method_on_component", target.id, "show", *arguments)


def machine(geometry: Geometry) -> dict[str, Any]:
    """Data for `rig.js`."""
    bodies_of_machine = [*bodies.site_parts(), *bodies.crane_parts(geometry), *bodies.head_parts(geometry)]
    parts = [part.data() for part in bodies_of_machine]
    return {"parts": parts, "nodes": list(NODES), "ground": GROUND, "sun": SUN, "shade": SHADE}


def surroundings() -> dict[str, Any]:
    """Data for `ground.js`."""
    colours = {"sky": SKY, "floor": FLOOR, "grid": GRID, "axis": AXIS}
    return {"trees": bodies.trees(), "ground": GROUND, "sun": SUN, **colours}
