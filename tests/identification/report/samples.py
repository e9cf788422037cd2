"""Small findings and pages to draw."""

from __future__ import annotations

import numpy as np

from fmus.identification.known import Curve, Estimate, Finding, Panel
from fmus.identification.report.attribution import Explanation, Share
from fmus.identification.report.content import (
    Channel,
    Fit,
    Page,
    Parameter,
    Quality,
    Refinement,
    Start,
)

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
        Curve("eq. (10)", FLOW, 1.1 * drop, "compared", line=True),
        Curve("corrected", FLOW, 0.9 * drop, "corrected", line=True),
    )
    return Panel("flow", "pressure drop", curves, title, LITRES, BAR, log)


def residual() -> Panel:
    """The residual below it."""
    return Panel("flow", "residual", (Curve("measured", FLOW, 1e3 * np.sin(1e4 * FLOW)),), "", LITRES, BAR)


def finding(**more: object) -> Finding:
    """What a procedure found about a hose."""
    said = ("1 of 30 steps is masked.", "A <b>remark</b> & more.")
    given = {"procedure": "hose_resistance", "title": "Hose resistance", "figure": 6, "remarks": said}
    return Finding(**{**given, "estimates": (AREA,), "panels": (panel(), residual()), **more})


def page(**more: object) -> Page:
    """A page with everything on it."""
    joint = Refinement(
        names=("valve_area", "swing.gear_ratio", "head_mass"),
        correlation=np.array([[1.0, 0.9, 0.1], [0.9, 1.0, -0.4], [0.1, -0.4, 1.0]]),
        condition=123.4,
        fits=(Fit("manipulator.boom_angle", 0.004, 0.0061, 3.1, 0.4, 1e-12, 0.02), Fit("x", 0.01, None)),
        unidentified=("head_mass: the data leave it open by 80 %.",),
        starts=(Start("random 1", 0.2, 0.01, 3.1, 9), Start("random 2", 0.3, 7.0, 3.9, 14)),
        facts={"search": "9 iterations"},
    )
    shares = (Share("swinging head", 0.5, 0.4, 0.9, 0.8, 1.0, {"manipulator.swing_angle": 0.7}),)
    seen = Explanation(shares, 0.6, 0.1, 0.05, ("manipulator.swing_angle",), ("quiet_one",), "One effect.")
    channel = Channel("flow", "m3/s", 0.0, 2e-3, 5e-6, "turbine", ("1 sample clipped.",))
    quality = Quality("a.csv", "A", "machine", "test", "simulation", 42.0, 200.0, (channel,))
    given = {
        "title": "Identification",
        "source": "recordings",
        "kinds": ("simulation",),
        "findings": (finding(),),
        "parameters": (Parameter(AREA, "hose_resistance", 4e-5, "assumed", "Area of <all> edges"),),
        "qualities": (quality,),
        "refinement": joint,
        "explanation": seen,
        "commands": {"harvester build --parameters parameters.toml": "Build the machine:"},
    }
    return Page(**{**given, **more})


__all__ = ["AREA", "finding", "page", "panel", "residual"]
