"""Small results and pages to draw."""

import numpy as np

from fmus.identification.recordings.quality import Quality, SignalQuality
from fmus.identification.report.attribution import EffectShare, Explanation
from fmus.identification.results import Curve, Estimate, Panel, ProcedureResult
from orchestrator.pages.figures import PALETTE, REFERENCE, SIMULATION, TraceFigure, TraceLine, TracePanel

LITRES, BAR = ("L/min", 1e-3 / 60), ("bar", 1e5)
AREA = Estimate("valve_area", 4.01e-5, "m2", 1e-7, 3.99e-5, 4.03e-5, "fit of 30 steps")
FLOW = np.linspace(2e-4, 2e-3, 30)


def panel(*, title: str = "Drop", log: bool = False) -> Panel:
    """Pressure drop over flow with every kind of curve."""
    drop = 1e11 * FLOW**2
    curves = (
        Curve("measured", FLOW, drop, error=0.03 * drop),
        Curve("masked: dead zone", FLOW[:3], drop[:3], "masked"),
        Curve("eq. (1)", FLOW, drop, "fit", line=True),
    )
    return Panel("flow", "pressure drop", curves, title, LITRES, BAR, log)


def traces() -> TraceFigure:
    """A measured and a predicted pressure over 5 s, with a gap in the measurement."""
    time = np.arange(0.0, 5.0, 0.005)
    measured = np.where((time > 2) & (time < 2.1), np.nan, 100 + 10 * np.sin(time))
    lines = (
        TraceLine(time, measured, {"color": PALETTE.pair(0)[0], "linewidth": 2.6}, "head", "measured"),
        TraceLine(time, 101 + 10 * np.sin(time), SIMULATION, "head", "predicted"),
    )
    error = TraceLine(time, measured - lines[1].values, {"color": PALETTE.pair(0)[1]}, "head")
    remarks = (("head\nNRMSE 5 %", PALETTE.pair(0)[1]),)
    panel = TracePanel("bar", lines, "pressure", errors=(error,), error_unit="bar", remarks=remarks)
    return TraceFigure((panel,), below="simulated", key=(("measured", REFERENCE), ("predicted", SIMULATION)))


def residual() -> Panel:
    """The residual below it."""
    return Panel("flow", "residual", (Curve("measured", FLOW, 1e3 * np.sin(1e4 * FLOW)),), "", LITRES, BAR)


def result(**more: object) -> ProcedureResult:
    """Result of a procedure for a hose."""
    remarks = ("1 of 30 steps is masked.", "A <b>remark</b> & more.")
    given = {"procedure": "hose_resistance", "title": "Hose resistance", "figure": 6, "remarks": remarks}
    return ProcedureResult(**{**given, "estimates": (AREA,), "panels": (panel(), residual()), **more})


def fit(signal: str, *numbers: float | None) -> dict[str, object]:
    """Goodness of fit of a signal."""
    names = ("train", "test", "noise", "memory")
    return {"signal": signal, **dict.fromkeys(names), **dict(zip(names, numbers, strict=False))}


def channel(signal: str, unit: str, *remarks: str, dead: float = 0.0) -> SignalQuality:
    """Data quality of a signal."""
    return SignalQuality(signal, unit, 0.0, 2e-3, 5e-6, "turbine", list(remarks), dead)


def quality(name: str, channels: tuple[SignalQuality, ...], *clock: str) -> Quality:
    """Data quality of a recording."""
    about = "A", "machine", "test", "simulation"
    return Quality(name, *about, 42.0, 200.0, list(clock), list(channels), [])


def page(**more: object) -> dict[str, object]:
    """A page with everything on it."""
    joint = {
        "names": ("valve_area", "swing.gear_ratio", "head_mass"),
        "correlation": np.array([[1.0, 0.9, 0.1], [0.9, 1.0, -0.4], [0.1, -0.4, 1.0]]),
        "condition": 123.4,
        "fits": (fit("manipulator.boom_angle", 0.004, 0.0061, 3.1, 0.4), fit("x", 0.01)),
        "unidentified": ("head_mass: the data leave it open by 80 %.",),
        "facts": {"search": "9 iterations"},
        "remarks": (),
    }
    shares = (EffectShare("swinging head", 0.5, 0.9, 0.8, 1.0, {"manipulator.swing_angle": 0.7}),)
    explanation = Explanation(
        shares, 0.6, 0.1, 0.05, ("manipulator.swing_angle",), ("quiet_one",), "One effect."
    )
    given = {
        "title": "Identification",
        "source": "recordings",
        "kinds": ("simulation",),
        "results": (result(),),
        "parameters": (
            {"estimate": AREA, "procedure": "hose_resistance", "prior": 4e-5, "prior_source": "assumed"}
            | {"text": "Area of all edges", "doubt": ""},
        ),
        "qualities": (quality("a.csv", (channel("flow", "m3/s", "1 sample clipped."),)),),
        "refinement": joint,
        "explanation": explanation,
        "commands": {"harvester build --parameters parameters.toml": "Build the machine:"},
    }
    empty = {"figures": (), "worst": (), "findings": (), "remarks": (), "warnings": (), "prediction": None}
    return {**empty, **given, **more}
