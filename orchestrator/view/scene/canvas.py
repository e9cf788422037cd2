"""The drawing in the browser: scene, views, and target rings of a task."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from nicegui import ui
from nicegui.elements.scene.scene_object3d import Object3D

from orchestrator.scene import drawing
from orchestrator.scene.drawing import SKY, VIEWS
from orchestrator.scene.geometry import GROUND, Geometry

SCRIPTS = Path(drawing.__file__).parent
RATE = 30  # 1/s; largest frame rate while the view is rotated
PLAIN = Path(__file__).with_name("plain.js").read_text(encoding="utf-8")
TIP = "with the tip"


class Rig(Object3D, component=str(SCRIPTS / "rig.js")):
    """The machine; `show` moves it."""


class Ground(Object3D, component=str(SCRIPTS / "ground.js")):
    """Ground, trees and light."""


class Marks(Object3D, component="marks.js"):
    """Target rings of a task; `show` sets them."""


class Brush(Object3D, component=str(SCRIPTS / "brush.js")):
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
            Ground(self.scene.id, drawing.surroundings())
            self.rig = Rig(self.scene.id, drawing.machine(geometry))
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

    def show(
        self, number: int, angles: Sequence[float], colours: Mapping[str, str], again: bool = False
    ) -> bool:
        """Show a pose: swing, boom, stick, head, head sideways [rad]. Returns False if nothing has changed.

        Only changed colours are sent.
        """
        changed = {name: c for name, c in colours.items() if self._colours.get(name) != c}
        numbers = [round(angle, 5) for angle in angles]
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
