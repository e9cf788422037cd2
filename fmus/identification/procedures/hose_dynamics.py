"""Hose dynamics procedure (section 4(c), Fig. 7): inertance and capacitance of one hose, with moving flows.

    I dQ/dt = P_in - P_out - R Q - dp(Q)           Q = Q_in + s (Q_out - Q_in)
    C dP/dt = Q_in - Q_out                         P = P_out + r (P_in - P_out)

dp is the friction of `tested_hose`; R takes what the small flows add to it. In the machine s = r = 0;
distributed along the hose, both are 1/2. The zeros of the instruments are unknowns, and so is the delay of a
logger if it is clear: 1 ms between the flows is half of C. The machine's lines have I ~ rho l/A, C ~ A l.

Validity: changes below the frequency of eq. (3), C_0/(2 pi l), above which a hose is not a single lump.
Windows of four periods of this frequency to each side pass what is below a quarter of it.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np

from fmus.components import hose
from fmus.identification.procedures import experiment_data as data
from fmus.identification.procedures.experiment_data import parameter_value
from fmus.identification.procedures.fit import Fit, Quantity
from fmus.identification.procedures.procedure import (
    Parameters,
    Parts,
    Procedure,
    Recordings,
    law_of,
    window_samples,
)
from fmus.identification.procedures.tested_hose import AXES, TestedHose, friction
from fmus.identification.recordings.clock import uniform_rate
from fmus.identification.results import BAR, LITRES_PER_MINUTE, Estimate, Panel
from orchestrator.base.errors import Problem

SIGNALS = {"pressure_in": "Pa", "pressure_out": "Pa", "flow_in": "m3/s", "flow_out": "m3/s"}
PAIRS = ("pressure_in", "pressure_out"), ("pressure_out", "flow_out")  # that may share a logger
UNKNOWNS = ("I", "C", "C_R", "R", "s", "r")
UNITS = {"C_R": "Pa.s2/m6", "I": "kg/m4", "C": "m3/Pa"}
EQUAL = ("I", "C")  # in all recordings of a hose
PERIODS = 4.0  # half width of the windows, in periods of the frequency of eq. (3)
SAMPLES_PER_PERIOD = 2.5  # minimum, above Nyquist's two
MIN_WINDOWS = 20  # per recording: fewer do not determine six unknowns
POSITION = 1.0  # standard deviation of the prior of s and r, which are between 0 and 1


def lump(p_in: Any, p_out: Any, q_in: Any, q_out: Any, u: Any, *known: Any) -> Any:
    """Both equations, and what they store."""
    flow, pressure = q_in + u.s * (q_out - q_in), p_out + u.r * (p_in - p_out)
    drop = p_in - p_out - u.R * flow - friction(u.C_R, known).drop(flow)
    return (drop, q_in - q_out), (u.I * flow, u.C * pressure)


def known(tests: Recordings, parameters: Parameters) -> TestedHose:
    """The hose, if all recordings have fast changes, meters of one sign and enough samples."""
    tested = TestedHose.of(tests, parameters)
    for test in tests:
        inlet, outlet = np.array([test[n] for n in ("flow_in", "flow_out")])
        usable, rate, limit = np.isfinite(inlet + outlet), uniform_rate(test), tested.frequency
        windows = samples([test], tested)[0][0].starts.size
        constant, opposite = (
            usable.any() and not np.ptp(inlet[usable]) > 0,
            inlet[usable] @ outlet[usable] < 0,
        )
        least, aliased = (
            SAMPLES_PER_PERIOD * limit,
            f"oscillates at up to {limit:.0f} Hz, which would be aliased",
        )
        few = f"{windows} windows without a bad sample (gap, clipped, dead zone)"
        wrong = {
            "flow_in: expected fast changes of flow and pressure, got a constant": constant,
            "flow_in, flow_out: expected both positive from inlet to outlet, got opposite signs": opposite,
            f"sampling rate: expected {least:.0f} Hz or more, got {rate:.0f} Hz: the hose {aliased}": rate
            < least,
            f"{few}, expected at least {MIN_WINDOWS}": windows < MIN_WINDOWS,
        }
        if texts := [text for text, true in wrong.items() if true]:
            raise Problem(f"{test.source}: {texts[0]}")
    return tested


def samples(tests: Recordings, tested: TestedHose) -> Parts:
    """Windows of each recording."""
    law = law_of(lump, len(SIGNALS), UNKNOWNS, len(tested.constants))
    width = PERIODS / tested.frequency
    return [window_samples(test, SIGNALS, law, width, tested.constants) for test in tests]


def _start(tested: TestedHose) -> dict[str, float]:
    """From the machine's hose and the known bulk modulus."""
    own, length, bore, modulus = (
        parameter_value(tested.parameters, f"boom_stick.{n}")
        for n in ("stick_hose_resistance", "stick_hose_length", "stick_hose_bore", "bulk_modulus")
    )
    return {
        "I": float(hose.inertance(tested.length, tested.bore, tested.density)),
        "C": float(hose.capacitance(tested.length, tested.bore, modulus)),
        "C_R": float(hose.scaled_resistance(own, tested.length / length, tested.bore / bore)),
        **dict.fromkeys(("R", "s", "r"), 0.0),
    }


def _estimates(fit: Fit) -> list[Quantity]:
    """The machine's lines."""
    tested: TestedHose = fit.known
    about = "regression over windows, section 4(c)", ", times {ratio:.4g} for {size} and the machine's oil"
    inertance = "inertance", UNITS["I"], "I", (*AXES, "swing.line")
    capacitance = "capacitance", UNITS["C"], "C", AXES
    return [
        *tested.scaled(*inertance, lambda length, bore: tested.to_density * length / bore**2, *about),
        *tested.scaled(*capacitance, lambda length, bore: length * bore**2, *about),
    ]


def _others(fit: Fit) -> Iterator[Estimate]:
    yield from (fit.estimate(Quantity(n, unit, n, "the tested hose")) for n, unit in UNITS.items())
    for name, end, what in (("s", "outlet", "flow"), ("r", "inlet", "pressure")):
        note = "0 lumped, 1/2 distributed"
        yield fit.estimate(Quantity(f"weight of the {end}'s {what}", "1", name, note))


def _panels(fit: Fit) -> Iterator[Panel]:
    sides = (
        ("dQ/dt [m3/s2]", "drop without friction", BAR),
        ("dP/dt [Pa/s]", "flow stored", LITRES_PER_MINUTE),
    )
    for row, (name, (x, y, unit)) in enumerate(zip(EQUAL, sides, strict=True)):
        yield from fit.line(Panel(x, y, (), "Filtered equation", y_unit=unit), name, row)


HOSE_DYNAMICS = Procedure(
    name="hose_dynamics",
    title="Hose dynamics: {0.size}",
    figure=7,
    signals=SIGNALS,
    law="The hose's law",
    known=known,
    samples=samples,
    start=_start,
    limits=lambda tests: data.zero_limits(tests, SIGNALS),
    priors=dict.fromkeys(("s", "r"), POSITION),
    loggers=(*PAIRS, *((name,) for name in SIGNALS)),
    check=lambda fit: fit.expect_positive(
        ((n, fit[n], fit.sd(n)) for n in EQUAL), "change the sign of the flows, or exchange the two pressures"
    ),
    estimates=_estimates,
    others=_others,
    panels=_panels,
    remarks=lambda fit: [fit.known.remark()],
    drift={"C_R": "the resistance"},
    equal=EQUAL,
)
