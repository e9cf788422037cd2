"""The two equations of a hose of one lump, filtered over windows of a recording.

    I dQ/dt = P_in - P_out - R Q - C_R Q|Q| - p_0        Q = Q_in + s (Q_out - Q_in)
    C dP/dt = Q_in - Q_out - q_0                         P = P_out + s (P_in - P_out)

where the machine (`fmus.components.cylinder_drive`) has the flow of the inlet and the capacitance at the
outlet, s = 0. A hose along which both are spread has s = 1/2: the mean of its ends. The share s, the friction
and the offsets p_0, q_0 between two instruments of one kind are estimated with I and C, so that none of them
is mistaken for these.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from fmus.identification.procedures.hose_dynamics.weak_form import Equation, Windows, windows
from fmus.identification.procedures.shared.given import noise_of
from fmus.identification.recordings.recording import Recording
from fmus.identification.recordings.signals import good_all, stretches, uniform_rate

Array = NDArray[np.float64]

SIGNALS = ("pressure_in", "pressure_out", "flow_in", "flow_out")


def cut(recording: Recording, half_width: float) -> Windows:
    """Windows [half width in s] in which all four signals are good throughout."""
    parts = stretches(good_all(recording, SIGNALS))
    return windows(parts, recording.time.size, 1 / uniform_rate(recording), half_width)


def inertance(recording: Recording, w: Windows, transition_flow: float) -> Equation:
    """P_in - P_out = I dQ/dt + R Q + C_R Q|Q| + p_0 at Q = Q_in + s (Q_out - Q_in), to the first order in s.

    |Q| is rounded as in `spool_valve.turbulent_drop`.
    """
    flow, more = (
        np.nan_to_num(x) for x in (recording["flow_in"], recording["flow_out"] - recording["flow_in"])
    )
    speed = np.hypot(flow, transition_flow)
    growth = speed + flow**2 / speed  # of Q|Q| with Q
    bend = flow / speed * (3 - (flow / speed) ** 2)  # of that with Q
    own, other = w.bump @ _diagonal(growth), w.bump @ _diagonal(bend * more)
    return Equation(
        windows=w,
        y=w.bump @ np.nan_to_num(recording["pressure_in"] - recording["pressure_out"]),
        columns={
            "I": w.slope @ flow,
            "I s": w.slope @ more,
            "R": w.bump @ flow,
            "R s": w.bump @ more,
            "C_R": w.bump @ (flow * speed),
            "C_R s": own @ more,
            "p_0": w.bump @ np.ones_like(flow),
        },
        noise=(
            (noise_of(recording, "pressure_in"), {"y": w.bump}),
            (noise_of(recording, "pressure_out"), {"y": w.bump}),
            (
                noise_of(recording, "flow_in"),
                {
                    "I": w.slope,
                    "I s": -w.slope,
                    "R": w.bump,
                    "R s": -w.bump,
                    "C_R": own,
                    "C_R s": other - own,
                },
            ),
            (noise_of(recording, "flow_out"), {"I s": w.slope, "R s": w.bump, "C_R s": own}),
        ),
        factors=lambda v: {
            **{name: v[name] for name in ("I", "R", "C_R", "p_0")},
            **{f"{name} s": v[name] * v["s"] for name in ("I", "R", "C_R")},
        },
    )


def capacitance(recording: Recording, w: Windows) -> Equation:
    """Q_in - Q_out = C dP/dt + q_0 at P = P_out + s (P_in - P_out)."""
    outlet, more = recording["pressure_out"], recording["pressure_in"] - recording["pressure_out"]
    return Equation(
        windows=w,
        y=w.bump @ np.nan_to_num(recording["flow_in"] - recording["flow_out"]),
        columns={
            "C": w.slope @ np.nan_to_num(outlet),
            "C s": w.slope @ np.nan_to_num(more),
            "q_0": w.bump @ np.ones_like(outlet),
        },
        noise=(
            (noise_of(recording, "flow_in"), {"y": w.bump}),
            (noise_of(recording, "flow_out"), {"y": w.bump}),
            (noise_of(recording, "pressure_in"), {"C s": w.slope}),
            (noise_of(recording, "pressure_out"), {"C": w.slope, "C s": -w.slope}),
        ),
        factors=lambda v: {"C": v["C"], "C s": v["C"] * v["s"], "q_0": v["q_0"]},
    )


def _diagonal(values: Array) -> sparse.dia_array:
    return sparse.diags_array(values)
