"""Figures of procedures and of a predicted recording, as in the paper's Figs. 5 to 11.

Curves can be distinguished without colour: measured values are marks or a broad line, a fit is a thin dark
line, a prediction a dotted one, and masked values are hollow marks. Successive panels over the same quantity
are one figure. A residual is the strip below its panel.
"""

import re
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import replace
from itertools import groupby
from typing import Any

from fmus.identification.report.prediction import WINDOW, RecordingComparison
from fmus.identification.results import Curve, Panel, ProcedureResult
from orchestrator.base import text
from orchestrator.base.text import display_unit, name_with_unit, sentences, typeset
from orchestrator.data.recording import Recording
from orchestrator.pages.figures import (
    PALETTE,
    REFERENCE,
    SIMULATION,
    TraceArea,
    TraceFigure,
    TraceLine,
    TracePanel,
)

SIMULATED = "simulated data (virtual test rig), not FERIC data"
KINDS = {"simulation": SIMULATED, "published": "published data", "measurement": "measured data"}


def origin(kinds: Iterable[str]) -> str:
    """Origin of the data: a description of each kind of recording."""
    return "; ".join(dict.fromkeys(KINDS.get(kind, kind) for kind in kinds))


def footer(number: int, kinds: Iterable[str]) -> str:
    """The origin of a figure's data, and the figure of the paper that it corresponds to, 0 for none."""
    return " · ".join(filter(None, (origin(kinds), f"cf. Fig. {number} of the paper" if number else "")))


def percentage(value: float | None, digits: int = 2) -> str:
    """A ratio as percentage; rounding errors are zero."""
    if value is not None and abs(value) < 1e-9:
        return "0 %"
    return typeset(text.percentage(value, digits, zeros=True))


# ---- procedures

DRAWING_ORDER = ("masked", "measured", "fit")  # later curves are on top
MARKS = ("o", "s", "^", "D")


def procedure_figures(result: ProcedureResult, kinds: Iterable[str] = ()) -> list[TraceFigure]:
    """The panels of a procedure, a figure for each quantity on an axis.

    kinds   of its recordings, for the line on the origin of the data
    """
    below = footer(result.figure, kinds)
    return [
        TraceFigure(
            _panels(group),
            title=result.title,
            below=below,
            axis=name_with_unit(*_name_and_unit(x_label, unit[0])),
        )
        for (x_label, unit), group in groupby(result.panels, key=lambda p: (p.x_label, p.x_unit))
    ]


def _panels(group: Iterable[Panel]) -> list[TracePanel]:
    """Panels over one quantity; a residual is the strip of the one before."""
    drawn = list[TracePanel]()
    for panel in group:
        (name, unit), lines = _name_and_unit(panel.y_label, panel.y_unit[0]), _lines(panel)
        if "residual" in f"{panel.title} {panel.y_label}".lower() and drawn and not drawn[-1].errors:
            drawn[-1] = replace(drawn[-1], errors=lines, error_label=name, error_unit=unit)
        else:
            label = ": ".join(filter(None, (panel.title, name)))
            drawn.append(TracePanel(unit, lines, label, log=panel.log, heights=(4.5, 2.0)))
    return drawn


def _name_and_unit(label: str, unit: str) -> tuple[str, str]:
    """The name of an axis, and the unit in a label such as "command [V]", else `unit`."""
    match = re.fullmatch(r"(.+) \[(.+)\]", label)
    return (match[1], match[2]) if match else (label, unit)


def _lines(panel: Panel) -> list[TraceLine]:
    """The curves of a panel, those on top last."""
    count, lines = Counter[str](), list[TraceLine]()
    several = sum(c.kind in ("measured", "masked") for c in panel.curves) > 1
    for curve in sorted(panel.curves, key=lambda c: DRAWING_ORDER.index(c.kind)):
        style = _style(curve, count[curve.kind], several=several)
        count[curve.kind] += 1
        x, y = curve.x / panel.x_unit[1], curve.y / panel.y_unit[1]
        error = None if curve.error is None else curve.error / panel.y_unit[1]
        lines.append(TraceLine(x, y, style, typeset(curve.label), error=error))
    return lines


def _style(curve: Curve, index: int, *, several: bool) -> dict[str, Any]:
    """Style of a curve with this index among those of its kind.

    several   whether there are several measured curves, so that a fit has the colour of its measurement
    """
    light, dark = PALETTE.pair(index)
    fitted, mark = dark if several else PALETTE.pair(0)[1], MARKS[index % len(MARKS)]
    # of a line its colour and width; of marks the mark, colour and face
    line, marks = {
        "measured": ((light, 2.6), (mark, light, light)),
        "masked": ((PALETTE.grid, 7.0), (mark, PALETTE.faint, "none")),
        "fit": ((fitted, 1.5), ("x", fitted, fitted)),
    }[curve.kind]
    names = ("color", "linewidth") if curve.line else ("marker", "color", "markerfacecolor")
    return dict(zip(names, line if curve.line else marks, strict=True))


# ---- a predicted recording

JOINT_FIGURES = {"swing": 10, "stick": 11, "boom": 0}  # number in the paper, which has none of the boom
KEY = ("measured", REFERENCE), ("predicted", SIMULATION)
CYLINDER = ("boom_stick", "flow into head", "head_flow", {"head_pressure": "head", "rod_pressure": "rod"})
# joint -> label of a panel -> signals and labels of its curves, as in the paper's Figs. 10 and 11
SIGNALS: Mapping[str, Mapping[str, Mapping[str, str]]] = {
    joint: {
        "command": {f"{part}.{joint}_command": ""},
        "angle": {f"manipulator.{joint}_angle": ""},
        "speed": {f"manipulator.{joint}_speed": ""},
        flow: {f"{part}.{joint}_{meter}": ""},
        "pressure": {f"{part}.{joint}_{port}": label for port, label in ports.items()},
    }
    for joint, part, flow, meter, ports in (
        ("swing", "swing", "flow into A", "flow_a", {"pressure_a": "line A", "pressure_b": "line B"}),
        ("boom", *CYLINDER),
        ("stick", *CYLINDER),
    )
}


def joint_figure(comparison: RecordingComparison, joint: str) -> TraceFigure:
    """Command, angle, speed, flow and pressures of a joint, if they were measured."""
    recording, time = comparison.recording, comparison.recording.time
    panels = [
        _trace_panel(label, measured, comparison)
        for label, curves in SIGNALS[joint].items()
        if (measured := {n: curve for n, curve in curves.items() if n in comparison.measured})
    ]
    return TraceFigure(
        panels,
        (float(time[0]), float(time[-1])),
        f"{joint.capitalize()}: {recording.title}",
        footer(JOINT_FIGURES[joint], [recording.kind]),
        KEY,
    )


def signal_figure(comparison: RecordingComparison, name: str) -> TraceFigure:
    """One signal with its prediction and residual."""
    panel = _trace_panel(name, {name: ""}, comparison)
    return TraceFigure([panel], below=footer(0, [comparison.recording.kind]), key=KEY)


def joint_caption(recording: Recording, joint: str) -> str:
    """What the figure of a joint shows."""
    use = "not used for fitting" if recording.use == "test" else "used for fitting"
    return sentences(
        f"Measured and predicted signals of the {joint} over {recording.title}, {use}",
        f"Speeds: both angles differentiated by one filter, {1000 * WINDOW:.0f} ms wide",
        "Flows in the dead zone of the meter are left out",
    )


def _trace_panel(label: str, curves: Mapping[str, str], comparison: RecordingComparison) -> TracePanel:
    """Signals of one quantity with their residuals and NRMSE; a command is an input and has none."""
    time, unit = comparison.recording.time, display_unit(comparison.units[next(iter(curves))])
    lines, residuals, areas = list[TraceLine](), list[TraceLine](), list[TraceArea]()
    remarks, errors = list[tuple[str, str]](), comparison.nrmse()
    for index, (signal, curve) in enumerate(curves.items()):
        light, dark = PALETTE.pair(index)
        measured = unit.factor * comparison.measured[signal]
        if signal not in comparison.predicted:
            lines.append(TraceLine(time, measured, {"color": dark, "linewidth": 1.2}))
            continue
        predicted = unit.factor * comparison.predicted[signal]
        broad, dotted = {"color": light, "linewidth": 2.6}, {**SIMULATION, "color": dark}
        lines.append(TraceLine(time, measured, broad, curve, "measured"))
        lines.append(TraceLine(time, predicted, dotted, curve, "predicted"))
        if signal in comparison.sd:
            low, high = (unit.factor * end for end in comparison.band(signal))
            areas.append(TraceArea(time, low, high, light, "95 % band"))
        residuals.append(TraceLine(time, measured - predicted, {"color": dark}, curve))
        if (error := errors.get(signal)) is not None:
            remarks.append((f"{curve}\nNRMSE {percentage(error)}".strip(), dark))
    return TracePanel(
        unit.display,
        lines,
        label,
        errors=residuals,
        error_label="residual",
        error_unit=unit.display,
        remarks=remarks,
        areas=areas,
        heights=(2.7 if residuals else 1.6, 1.2),
    )
