"""The colour of a pressure: one scale for cylinders, hoses, gauges and the legend.

Plasma of matplotlib (Smith and van der Walt 2015): even steps of lightness, so it can be read without any
sense of colour, and with red-green or blue-yellow blindness. Its palest end is left out: on light ground it
is lost.

The targets of a task as rings in space: what is next is strong, what is done is gone.

The machine in a browser: one `ui.scene` with one object in it, which `rig.js` builds and moves.
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

STEPS = 33  # colours that are told apart: a browser is sent one only when it changes
UNKNOWN = "#8b9196"

SCALE: Sequence[str] = tuple(to_hex(colormaps["plasma"](0.04 + 0.88 * k / (STEPS - 1))) for k in range(STEPS))


def colour(pressure: float, full: float) -> str:
    """The colour of a pressure [Pa] between zero and `full`; grey for what is not known."""
    if not math.isfinite(pressure) or full <= 0:
        return UNKNOWN
    share = min(1.0, max(0.0, pressure / full))
    return SCALE[round(share * (STEPS - 1))]


def gradient() -> str:
    """The scale as a gradient of a style sheet, low to high from left to right."""
    return f"linear-gradient(to right, {', '.join(SCALE[::4])})"


NEXT, LATER = "#d55e00", "#0072b2"  # Okabe and Ito: told apart with every kind of colour blindness

Point3 = tuple[float, float, float]


def rings(targets: Sequence[Point3], radius: float, done: int) -> list[dict[str, Any]]:
    """For the browser: the targets that are left, in their order; `done` are not shown any more."""
    left = list(targets)[done:]
    return [
        {"at": list(at), "radius": radius, "colour": LATER if k else NEXT, "strong": k == 0}
        for k, at in enumerate(left)
    ]


SKY, FLOOR, SHADE, GRID, AXIS = "#dfe6e8", "#c9cfc4", "#aab2a6", "#b7beb3", "#98a094"
SUN = (4.0, -6.0, 12.0)  # towards it
RATE = 30  # frames per second at most, while somebody turns the view
PLAIN = Path(__file__).with_name("plain.js").read_text(encoding="utf-8")
VIEWS: Mapping[str, tuple[float, float, float, float, float, float]] = {
    "quarter": (8.4, -11.9, 4.8, 1.5, 0.0, 1.15),
    "side": (2.0, -13.0, 1.4, 2.0, 0.0, 1.0),
    "top": (1.6, -0.1, 13.5, 1.6, 0.0, 0.0),
    "cab": (-1.2, 0.9, 1.9, 5.0, 0.0, -0.2),
}
TIP = "with the tip"


class Rig(Object3D, component="rig.js"):
    """All that moves, and the carrier; its numbers come by `show`."""


class Ground(Object3D, component="ground.js"):
    """Ground, trees and light."""


class Marks(Object3D, component="marks.js"):
    """Targets of a task, by `show`."""


class Brush(Object3D, component="brush.js"):
    """When the picture is drawn."""


class Canvas:
    """The scene of one page.

    shown   called with the number of a picture that the browser has drawn, every fourth one
    begun   called when the browser has built the scene, perhaps anew
    ready   it has
    """

    def __init__(self, geometry: Geometry, shown: Callable[[int], None], begun: Callable[[], None]) -> None:
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
        """One of the named views, or TIP: from where the view is, it goes with the tip."""
        self._following = name == TIP
        if self.ready:
            self.scene.run_method("run_method_on_component", self.rig.id, "track", self._following)
        if self._following:
            return
        x, y, z, *at = VIEWS[name]
        eye = dict(zip(("look_at_x", "look_at_y", "look_at_z"), at, strict=True))
        self.scene.move_camera(x, y, z, **eye, duration=duration)

    def show(self, number: int, pose: ScenePose, colours: Mapping[str, str], again: bool = False) -> bool:
        """Move to a pose; False if it looks as before. Of the colours only those that changed are sent."""
        fresh = {name: c for name, c in colours.items() if self._colours.get(name) != c}
        numbers = pose.flat()
        if not (fresh or again) and numbers == self._numbers:
            return False
        self._colours.update(fresh)
        self._numbers = numbers
        self._call(self.rig, number, numbers, fresh, again)
        return True

    def marks(self, marks: list[dict[str, Any]]) -> None:
        """Rings of a task, see `marks.rings`; nothing is sent that is there already."""
        if marks != self._marks and self.ready:
            self._marks = marks
            self._call(self.aims, marks)

    def _begin(self) -> None:
        """A scene that is new knows no colours."""
        self._colours.clear()
        self._numbers, self._marks = [], []
        self.ready = True
        if self._following:
            self.look(TIP)
        self._begun()

    def _call(self, target: Object3D, *arguments: Any) -> None:
        self.scene.run_method("run_method_on_component", target.id, "show", *arguments)


def machine(geometry: Geometry) -> dict[str, Any]:
    """All that `rig.js` needs."""
    everything = [*bodies.site_parts(), *bodies.crane_parts(geometry), *bodies.head_parts(geometry)]
    parts = [part.data() for part in everything]
    return {"parts": parts, "nodes": list(NODES), "ground": GROUND, "sun": SUN, "shade": SHADE}


def surroundings() -> dict[str, Any]:
    """All that `ground.js` needs."""
    colours = {"sky": SKY, "floor": FLOOR, "grid": GRID, "axis": AXIS}
    return {"trees": bodies.trees(), "ground": GROUND, "sun": SUN, **colours}
