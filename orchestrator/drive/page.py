"""The page on which one drives: HTML fragments that need no server, and the page of `harvester view`.

A visitor drives the FMU of the whole machine, compiled to WebAssembly (fmus/export/compile.py), or, on the
page of `harvester view`, the machine in real time; with a recorded run the page replays it, next to a
reference. All of it is the same section and the same scripts, ES modules in `web`:

    page.js         the section: toolbar, time, what is seen
    module.js       source: the module in the browser, called by fmu.js
    socket.js       source: the machine in real time, by a websocket in a worker (worker.js)
    recording.js    source: a recorded run
    levers.js       keys, gamepad, sticks on the screen
    scene.js        the machine in space, with rig.js and brush.js
    panels.js       gauges, sliders, status line
    findings.js     what a diagnosis in the machine finds
    charts.js       strip charts
    task.js         training task
    dialogs.js      dialogs of `harvester view`
    loader.js       unpacks the modules of a fragment

A fragment contains modules, data and WebAssembly, compressed; reports and the documentation contain it, and
`write_page` writes it as a file of its own. Nothing is requested.

The commands change every 10 ms of simulated time (`FRAME`) and are linear in between. A scenario with a row
of each frame, which the page can save, gives the same motion with `harvester run`.
"""

import base64
import json
import zlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from orchestrator.base.errors import Problem
from orchestrator.base.files import FMI3, Location, shipped_with, write_whole
from orchestrator.base.units import parse_unit
from orchestrator.data.trace import Trace
from orchestrator.drive import drawing, sticks
from orchestrator.drive.scene import Values, parameters, pose_names, start
from orchestrator.drive.view_description import (
    CAVITATION,
    ViewDescription,
    by_bare_name,
    scale,
    view_description,
)
from orchestrator.fmi.interface import FmuInterface
from orchestrator.pages import html_page
from orchestrator.pages.figures import VENDOR
from orchestrator.ssp.load import load
from orchestrator.ssp.parameter_sets import with_sets
from orchestrator.ssp.system import System

HERE = Path(__file__).parent
WEB = HERE / "web"
MODULE = "binaries/wasm32-wasip1/{}.wasm"
SERVED = ("loader", "socket", "worker", "dialogs")  # scripts that are no modules of a fragment
PROGRAM = "extra/org.fmi-standard.fmi-ls-ref/input.csv"  # of the reference experiment
FRAME = 0.01  # s; the commands change after this time, as in real time
STEP = 1e-3  # s; communication step of an FMU that suggests none
REPLAY_RATE = 25  # 1/s; pictures of a replay
MOST = 30_000  # pictures of a replay; of a longer run they are further apart
DIGITS = 5  # significant digits of a replayed signal


@dataclass(frozen=True)
class Replayed:
    """A run that the page replays, and the reference that it was compared with."""

    run: Trace
    reference: Trace | None = None


def find_fmu(system: Path) -> Path | None:
    """The FMU of FMI 3.0 with a WebAssembly module of a whole system; None if there is none.

    That of an SSP has the same name and is next to the file or in its subfolder fmi3.
    """
    name = f"{FMI3}/{system.stem}.fmu"
    paths = (system.with_suffix(".fmu"), system.parent / name)
    driven = (path for path in paths if path.is_file() and _module(load(path)) is not None)
    return next(driven, None) or shipped_with(system, name)


def fragment(
    system: Path,
    replayed: Replayed | None = None,
    autostart: bool = False,
    shown: System | None = None,
    faults: Sequence[str] = (),
) -> Markup:
    """The section of a system whose file describes a scene; empty if there is nothing to drive or to replay.

    replayed    shown first; left out if it has no angle of a joint
    autostart   the machine moves when it comes into sight, unless the visitor prefers reduced motion
    shown       the system of the replayed run; default: that of the file
    faults      names of findings, whose parts are marked; then the machine only replays
    """
    loaded, fmu = shown or load(system), None if faults else find_fmu(system)
    driven = load(fmu) if fmu is not None else None
    description = view_description(loaded)
    if description.scene is not None and replayed is not None:
        angles = by_bare_name(replayed.run.signals)
        replayed = replayed if any(joint in angles for joint in description.scene.signals) else None
    if description.scene is None or (driven is None and replayed is None):
        return Markup()
    data = page_data(description, parameters(description.scene, loaded))
    data |= {"autostart": autostart, "title": loaded.name}
    drawing.mark(data["scene"]["machine"]["shapes"], description.scene, faults)
    parts = {"scripts": json.dumps(scripts()).encode()}
    if fmu is not None and driven is not None:
        data |= {"fmu": {"file": fmu.name} | _fmu(view_description(driven), driven, loaded)}
        parts["module"] = _module(driven) or b""
    if replayed is not None:
        data |= {"replay": _replay(description.shown, description.scene.signals, replayed)}
    parts["data"] = json.dumps(data, separators=(",", ":")).encode()
    packed = [(name, base64.b64encode(zlib.compress(part, 9)).decode()) for name, part in parts.items()]
    texts = [f'<script type="text/plain" data-part="{name}">{text}</script>' for name, text in packed]
    script = f"<script>\n{_web('loader.js')}</script>"
    content = (f"<style>\n{style()}\n</style>", _web("section.html"), *texts, script)
    return Markup("<div>\n{}\n</div>").format(Markup("\n".join(content)))


def write_page(path: Path, system: Path, title: str) -> Path:
    """Write the machine of a system as an HTML file of its own; a `Problem` if nothing can be driven."""
    if find_fmu(system) is None:
        raise Problem(
            f"{system}: expected {system.stem}.fmu of FMI 3.0 with a WebAssembly module, next to the file or"
            " in fmi3, found none; harvester build makes it, from the wheel harvester build --shipped"
        )
    section = fragment(system, autostart=True)
    if not section:
        raise Problem(f"{system}: expected resources/view.toml with a scene, found none")
    return write_whole(path, html_page.render(HERE / "machine_page.html.j2", title=title, section=section))


# ---- scripts and style


def scripts() -> dict[str, str]:
    """The modules of a fragment, by the names under which they are imported; uPlot is a plain script."""
    own = (path.name for path in sorted(WEB.glob("*.js")) if path.stem not in SERVED)
    return {f"drive/{name}": _web(name) for name in own} | libraries()


def libraries() -> dict[str, str]:
    """Modules and scripts of others, with their licences."""
    three = HERE / "three"
    return {
        "three": _licensed(three / "three.min.js", three / "LICENSE"),
        "uplot": _licensed(VENDOR / "uPlot.iife.min.js", VENDOR / "LICENSE"),
    }


def style() -> str:
    """Style of the section and of its charts."""
    return f"{(VENDOR / 'uPlot.min.css').read_text(encoding='utf-8')}\n{_web('page.css')}"


def _licensed(path: Path, licence: Path) -> str:
    return f"/*{licence.read_text(encoding='utf-8')}*/\n{path.read_text(encoding='utf-8')}"


def _web(name: str) -> str:
    return (WEB / name).read_text(encoding="utf-8")


def served(title: str) -> dict[str, tuple[str, str]]:
    """What a server serves: path -> media type and text. The websocket of the page is `/live`."""
    section = Markup(f"<style>\n{style()}\n</style>\n{_web('section.html')}")
    page = html_page.render(HERE / "served.html.j2", title=title, section=section)
    files = {path.name: _web(path.name) for path in WEB.glob("*.js")}
    files |= {f"{name}.js": text for name, text in libraries().items()}
    scripts = {f"/drive/{name}": ("text/javascript", text) for name, text in files.items()}
    return {"/": ("text/html", page), **scripts}


# ---- data


def _module(fmu: System) -> bytes | None:
    """The WebAssembly module of a system of one FMU of FMI 3.0."""
    component = next(iter(fmu.components.values()))
    if component.interface.model.major != 3 or component.source is None:
        return None
    file: Location = component.source.member(MODULE.format(component.interface.identifier))
    return file.read() if file.exists else None


def page_data(description: ViewDescription, values: Values | None) -> dict[str, Any]:
    """What the page shows of a machine from any source: scene, gauges, charts, levers, training task.

    values   parameters of the drawn machine; None for a machine without a drawing
    """
    scene = description.scene
    return {
        "scene": drawing.scene(scene, values) if scene and values is not None else None,
        "initial": start(scene, values or {}) if scene else (),
        "full": description.full_pressure,
        "joints": scene.signals if scene else (),
        "pressures": dict(scene.pressures) if scene else {},
        "gauges": [
            {"title": group.title, "lines": list(map(_shown, group.lines))} for group in description.gauges
        ],
        "cavitation": CAVITATION,
        "charts": list(map(_shown, description.charts)),
        "notices": [asdict(notice) for notice in description.notices],
        "sliders": list(map(_shown, description.sliders)),
        "curve": dict(sticks.CURVE),
        "patterns": {name: asdict(pattern) for name, pattern in description.patterns.items()},
        "legends": {
            name: {
                p: sticks.legend(pattern, description.functions, mode)
                for p, pattern in description.patterns.items()
            }
            for name, mode in description.modes.items()
        },
        "task": asdict(description.task) | {"needed": description.task.needed},
        "slowed": asdict(description.slowed) if description.slowed else None,
        "scale": list(drawing.SCALE),
        "unknown": drawing.UNKNOWN,
    }


def replay_data(
    description: ViewDescription, values: Values | None, run: Trace, title: str
) -> dict[str, Any]:
    """The data of a page that replays a run and nothing else; values: as of `page_data`."""
    joints = description.scene.signals if description.scene else ()
    replay = _replay(description.shown, joints, Replayed(run))
    own = {"autostart": True, "alone": True, "title": title, "replay": replay}
    return page_data(description, values) | own


def _shown(part: Any) -> dict[str, Any]:
    """A gauge, chart or slider, with the factors from the FMU's unit to the displayed and the SI unit.

    pressure   in Pa, the displayed unit; 0 of other quantities
    """
    si = parse_unit(part.fmu_unit).factor if part.fmu_unit else 1.0
    unit = parse_unit(part.unit)
    pressure = unit.factor if unit.base() == parse_unit("Pa").base() else 0.0
    return asdict(part) | {"factor": scale(part.unit, part.fmu_unit), "si": si, "pressure": pressure}


def _fmu(description: ViewDescription, fmu: System, system: System) -> dict[str, Any]:
    """Interface of the FMU: variables that the page uses, driven inputs, sliders, poses and program."""
    component = next(iter(fmu.components.values()))
    interface, scene = component.interface, description.scene
    axes = description.driven(fmu)
    name, mode = next(((n, m) for n, m in description.modes.items() if m.drives(axes)), ("", None))
    if scene is None or mode is None:
        expected = "expected a scene and a mode in resources/view.toml to drive the machine"
        raise Problem(f"{fmu.source}: {expected}")
    sliders = [s.name for s in description.sliders if s.name in interface.variables]
    inputs = [n for n in (*axes, *sliders) if interface.variables[n].causality == "input"]
    rates = {n: interface.rate_inputs[n] for n in inputs if n in interface.rate_inputs}
    initial = {n: k for n, k in scene.initial.items() if n in interface.variables}
    shown = [n for n in description.shown if n in interface.variables]
    used = dict.fromkeys((*shown, *inputs, *rates.values(), *sliders, *initial))
    return {
        "component": component.name,
        "identifier": interface.identifier,
        "token": interface.model.token,
        "step": interface.step or STEP,
        "frame": FRAME,
        "variables": {name: interface.variables[name].reference for name in used},
        "outputs": shown,
        "axes": [_axis(n, description, interface, rates) for n in dict.fromkeys(inputs)],
        "mode": name,
        "full": {function: dict(driven) for function, driven in mode.full.items()},
        "sliders": {name: _start(interface, name) for name in sliders},
        "poses": {
            name: {parameter: at[k] for parameter, k in initial.items()}
            for name in pose_names(scene, system)
            for at in [start(scene, parameters(scene, with_sets(system, [name])))]
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
    moved = driven or (slider.driven(0.0) if slider else None)
    rate = (slider and slider.rate) or (moved.rate if moved else 0.0)
    limit = driven.limit if driven and not slider else None
    slope, start = rates.get(name, ""), _start(interface, name)
    return {"name": name, "start": start, "limit": limit, "rate": rate, "slope": slope}


def _start(interface: FmuInterface, name: str) -> float:
    return float(interface.variables[name].start or 0.0)


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
    count = min(max(2, round((run.time[-1] - run.time[0]) * REPLAY_RATE) + 1), MOST)
    time = np.linspace(run.time[0], run.time[-1], count)
    ghost = _columns(replayed.reference, time, joints) if replayed.reference else {}
    times = [round(t, 4) for t in time.tolist()]
    return {"time": times, "columns": _columns(run, time, shown), "ghost": ghost}


def _columns(trace: Trace, time: Any, names: Iterable[str]) -> dict[str, list[float]]:
    """Samples of the signals with these bare names, rounded."""
    full = by_bare_name(trace.signals)
    wanted = [n for n in names if n in full]
    sampled = trace.select([full[n] for n in wanted]).at(time)
    return {n: [float(f"{v:.{DIGITS}g}") for v in sampled[full[n]].tolist()] for n in wanted}
