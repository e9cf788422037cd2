"""The machine on a page: an HTML fragment that needs no server, no other file and no network.

`fragment` makes a section with style, script and data. A visitor drives the FMU of the whole machine,
compiled to WebAssembly (fmus/export/compile.py), with keys, sticks and sliders. The scene is that of
`harvester view`. With a recorded run the section also replays it, next to a reference. Reports and the
documentation contain it; `write_page` writes it as a file of its own.

The commands change every 10 ms of simulated time (`FRAME`) and are linear in between. A scenario with a
row of each frame, which the page can save, gives the same motion with `harvester run`.

    fmu.js          calls the module
    machine.js      simulation, levers, panels, scene
    rig.js ...      the scene, of `harvester view`
    three/          three.js, which draws
"""

import base64
import json
import re
import zlib
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from orchestrator.base.errors import Problem
from orchestrator.base.files import FMI3, Location
from orchestrator.base.units import parse_unit
from orchestrator.data.trace import Trace
from orchestrator.fmi.description import FmuInterface
from orchestrator.pages import html_page
from orchestrator.scene import drawing
from orchestrator.scene.geometry import GROUND, geometry, pose_names, start
from orchestrator.scene.view_description import (
    CAVITATION,
    DriveMode,
    Gauge,
    ViewDescription,
    by_bare_name,
    view_description,
)
from orchestrator.ssp.load import load
from orchestrator.ssp.parameter_sets import with_sets
from orchestrator.ssp.system import System

HERE = Path(__file__).parent
TEMPLATES = HERE / "templates"
MODULE = "binaries/wasm32-wasip1/{}.wasm"
PROGRAM = "extra/org.fmi-standard.fmi-ls-ref/input.csv"  # of the reference experiment
FRAME = 0.01  # s; the commands change after this time, as in `view`
STEP = 1e-3  # s; communication step of an FMU that suggests none
REPLAY_RATE = 25  # 1/s; pictures of a replay
DIGITS = 5  # significant digits of a replayed signal
SCENE_SCRIPTS = ("rig", "ground", "brush")


@dataclass(frozen=True)
class Replayed:
    """A run that the page replays, and the reference that it was compared with."""

    run: Trace
    reference: Trace | None = None


def find_fmu(system: Path) -> Path | None:
    """The FMU of FMI 3.0 with a WebAssembly module of a whole system; None if there is none.

    That of an SSP has the same name and is next to the file or in its subfolder fmi3.
    """
    names = (system.with_suffix(".fmu"), system.parent / FMI3 / f"{system.stem}.fmu")
    return next((path for path in names if path.is_file() and _module(load(path)) is not None), None)


def fragment(
    system: Path, replayed: Replayed | None = None, autostart: bool = False, shown: System | None = None
) -> Markup:
    """The section of a system whose file describes a scene; empty if there is nothing to drive or to replay.

    replayed    shown first; left out if it has no angle of a joint
    autostart   the machine moves when it comes into sight, unless the visitor prefers reduced motion
    shown       the system of the replayed run; default: that of the file
    """
    loaded, fmu = shown or load(system), find_fmu(system)
    driven = load(fmu) if fmu is not None else None
    description = view_description(loaded)
    if description.scene is not None and replayed is not None:
        angles = by_bare_name(replayed.run.signals)
        replayed = replayed if any(joint in angles for joint in description.scene.joints) else None
    if description.scene is None or (driven is None and replayed is None):
        return Markup()
    parts, data = {"three": three()}, _scene(description, loaded)
    if driven is not None:
        data |= {"fmu": _fmu(view_description(driven), driven, loaded)}
        parts["module"] = _module(driven) or b""
    if replayed is not None:
        data |= {"replay": _replay(description.shown, description.scene.joints, replayed)}
    parts["data"] = json.dumps(data | {"autostart": autostart}, separators=(",", ":")).encode()
    return Markup(
        _environment()
        .get_template("machine.html.j2")
        .render(
            style=Markup((TEMPLATES / "machine.css").read_text(encoding="utf-8")),
            script=Markup(script()),
            parts={name: base64.b64encode(zlib.compress(part, 9)).decode() for name, part in parts.items()},
            drives=driven is not None,
            replays=replayed is not None,
            gradient=drawing.gradient(),
            full=f"{description.full_pressure / 1e6:g}",
            fmu=fmu.name if fmu else "",
        )
    )


def write_page(path: Path, system: Path, title: str) -> Path:
    """Write the machine of a system as an HTML file of its own; a `Problem` if nothing can be driven."""
    if find_fmu(system) is None:
        raise Problem(
            f"{system}: expected {system.stem}.fmu of FMI 3.0 with a WebAssembly module, next to the file or"
            " in fmi3, found none; harvester build makes it"
        )
    section = fragment(system, autostart=True)
    if not section:
        raise Problem(f"{system}: expected resources/view.toml with a scene, found none")
    return html_page.write_text(
        path, html_page.render(TEMPLATES / "machine_page.html.j2", title=title, section=section)
    )


def _environment() -> Environment:
    return Environment(
        loader=FileSystemLoader(TEMPLATES),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )


# ---- scripts


def three() -> bytes:
    """three.js with its licence."""
    licence = (HERE / "three" / "LICENSE").read_text(encoding="utf-8")
    return f"/*{licence}*/\n{(HERE / 'three' / 'three.min.js').read_text(encoding='utf-8')}".encode()


def scene_modules() -> str:
    """Classes Rig, Ground and Brush of the scene, for a function of THREE and getElement."""
    return "\n".join(_without_modules(HERE / f"{name}.js") for name in SCENE_SCRIPTS)


def script() -> str:
    """The script without three.js."""
    body = f"{scene_modules()}\nreturn {{ Rig, Ground, Brush }};"
    scene = f"const sceneOf = (THREE, getElement) => {{\n{body}\n}};"
    own = ((HERE / name).read_text(encoding="utf-8") for name in ("fmu.js", "machine.js"))
    return "\n".join(["(() => {", '"use strict";', scene, *own, "})();"])


def _without_modules(path: Path) -> str:
    """A module of the scene as plain text: its import is an argument, its class a local name."""
    text = path.read_text(encoding="utf-8").replace('import { THREE } from "nicegui-scene";\n', "")
    text = text.replace("export default class", "class")
    if re.search(r"^(import|export)\b", text, re.MULTILINE):
        raise Problem(f"{path}: expected the import of THREE and one exported class only")
    return text


# ---- data


def _module(fmu: System) -> bytes | None:
    """The WebAssembly module of a system of one FMU of FMI 3.0."""
    component = next(iter(fmu.components.values()))
    if component.interface.fmi != 3 or component.source is None:
        return None
    file: Location = component.source.member(MODULE.format(component.interface.identifier))
    return file.read() if file.exists else None


def _scene(description: ViewDescription, system: System) -> dict[str, Any]:
    """Scene, gauges and charts."""
    shape = geometry(system)
    initial = start(system, description.scene.initial if description.scene else ())
    return {
        "scene": {
            "machine": {s: drawing.machine(shape, c) for s, c in _schemes(drawing.SHADE, drawing.DARK_SHADE)},
            "ground": {s: drawing.surroundings(dark) for s, dark in _schemes(False, True)},
            "level": GROUND,
            "views": drawing.VIEWS,
            "scale": list(drawing.SCALE),
            "unknown": drawing.UNKNOWN,
        },
        "initial": [initial.swing, initial.boom, initial.stick, 0.0, 0.0],
        "full": description.full_pressure,
        "joints": description.scene.joints if description.scene else (),
        "pressures": dict(description.scene.pressures) if description.scene else {},
        "gauges": [
            {"title": g.title, "lines": [_gauge(line) for line in g.lines]} for g in description.gauges
        ],
        "charts": [asdict(chart) | {"factor": chart.factor} for chart in description.charts],
    }


def _gauge(gauge: Gauge) -> dict[str, Any]:
    return asdict(gauge) | {"factor": gauge.factor, "coloured": gauge.is_pressure, "cavitation": CAVITATION}


def _schemes(light: Any, dark: Any) -> Iterable[tuple[str, Any]]:
    return ("light", light), ("dark", dark)


def _fmu(description: ViewDescription, fmu: System, system: System) -> dict[str, Any]:
    """Interface of the FMU: variables that the page uses, driven inputs, sliders, poses and program."""
    component = next(iter(fmu.components.values()))
    interface = component.interface
    scene = description.scene
    axes = description.driven(fmu)
    mode = next((m for m in description.modes.values() if m.drives(axes)), None)
    if scene is None or mode is None:
        raise Problem(
            f"{fmu.source}: expected a scene and a mode in resources/view.toml to drive the machine"
        )
    sliders = [s for s in description.sliders if s.name in interface.variables]
    inputs = [n for n in (*axes, *(s.name for s in sliders)) if interface.variables[n].causality == "input"]
    rates = {n: interface.rate_inputs[n] for n in inputs if n in interface.rate_inputs}
    initial = [n for n in scene.initial if n in interface.variables]
    shown = [n for n in description.shown if n in interface.variables]
    used = dict.fromkeys((*shown, *inputs, *rates.values(), *(s.name for s in sliders), *initial))
    return {
        "identifier": interface.identifier,
        "token": interface.guid,
        "step": interface.step or STEP,
        "frame": FRAME,
        "variables": {name: interface.variables[name].reference for name in used},
        "outputs": shown,
        "axes": [_axis(n, description, interface, rates) for n in dict.fromkeys(inputs)],
        "full": _full(mode),
        "sliders": [
            asdict(s) | {"factor": 1 / parse_unit(s.unit).factor, "start": _start(interface, s.name)}
            for s in sliders
        ],
        "poses": {
            name: dict(zip(initial, (at.swing, at.boom, at.stick), strict=True))
            for name in pose_names(system, scene.initial)
            for at in [start(with_sets(system, [name]), scene.initial)]
        },
        "initial": initial,
        "program": _program(fmu, inputs),
    }


def _axis(
    name: str, description: ViewDescription, interface: FmuInterface, rates: Mapping[str, str]
) -> dict[str, Any]:
    """An input that the page sets: its limits, its start value, and the input for its slope."""
    driven = next((a for a in description.axes if name in a.name), None)
    slider = next((s for s in description.sliders if s.name == name), None)
    rate = slider.rate if slider else driven.rate if driven else 0.0
    return {
        "name": name,
        "start": _start(interface, name),
        "limit": driven.limit if driven and not slider else None,
        "rate": rate,
        "slope": rates.get(name, ""),
    }


def _start(interface: FmuInterface, name: str) -> float:
    return float(interface.variables[name].start or 0.0)


def _full(mode: DriveMode) -> dict[str, dict[str, float]]:
    return {function: dict(driven) for function, driven in vars(mode.full).items()}


def _program(fmu: System, inputs: Iterable[str]) -> dict[str, Any] | None:
    """Commands of the reference experiment in the FMU, which the page plays until somebody drives."""
    source = next(iter(fmu.components.values())).source
    file = source.member(PROGRAM) if source else None
    if file is None or not file.exists:
        return None
    names, *rows = (line.split(",") for line in file.read().decode().splitlines())
    table = np.array(rows, dtype=np.float64)
    columns = {n: table[:, k].tolist() for k, n in enumerate(names) if n in inputs}
    return {"time": table[:, 0].tolist(), "columns": columns} if columns else None


def _replay(shown: Iterable[str], joints: Iterable[str], replayed: Replayed) -> dict[str, Any]:
    """Signals of a run at the times of the pictures, and the angles of the reference."""
    run = replayed.run
    count = max(2, round((run.time[-1] - run.time[0]) * REPLAY_RATE) + 1)
    time = np.linspace(run.time[0], run.time[-1], count)
    ghost = _columns(replayed.reference, time, joints) if replayed.reference else {}
    return {
        "time": [round(t, 4) for t in time.tolist()],
        "columns": _columns(run, time, shown),
        "ghost": ghost,
    }


def _columns(trace: Trace, time: Any, names: Iterable[str]) -> dict[str, list[float]]:
    """Samples of the signals with these bare names, rounded."""
    full = by_bare_name(trace.signals)
    wanted = [n for n in names if n in full]
    sampled = trace.select([full[n] for n in wanted]).at(time)
    return {n: [float(f"{v:.{DIGITS}g}") for v in sampled[full[n]].tolist()] for n in wanted}
