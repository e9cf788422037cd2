"""Inertance and capacitance of a hose (section 4(c), Fig. 7) from pressures and flows at both ends.

Two ways: by their definitions with filtered derivatives and means of groups, as the paper does
(`definition`), and by a regression that differentiates no noise (`weak_form`, `equations`), whose
result goes to the machine: I ~ l/A and C ~ A l for its other lines.

Validity: changes below the frequency of eq. (3), C_0/(2 pi l), above which a hose is no single lump: windows
of four of its periods to each side pass what is below a quarter of it. A clock with fewer than 2.5
samples in such a period is refused.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from fmus.components import hose
from fmus.contract import ModelError
from fmus.identification.finding import Estimate, Finding
from fmus.identification.procedures.hose_dynamics import equations
from fmus.identification.procedures.hose_dynamics.definition import ByDefinition, by_definition, mean_of_means
from fmus.identification.procedures.hose_dynamics.fits import Fits, capacitance_start, fits, inertance_start
from fmus.identification.procedures.hose_dynamics.panels import panels
from fmus.identification.procedures.hose_resistance.laws import scaled
from fmus.identification.procedures.shared.given import denser, hose_size, training, value
from fmus.identification.procedures.shared.regression import UNLIKELY, misfit_remark
from fmus.identification.recordings.recording import Recording
from fmus.identification.recordings.resampling import uniform_rate
from fmus.parameters import Number

SIGNALS: Mapping[str, str] = {
    "pressure_in": "Pa",
    "pressure_out": "Pa",
    "flow_in": "m3/s",
    "flow_out": "m3/s",
}
PERIODS = 4.0  # half width of the windows, in periods of eq. (3)
SAMPLES = 2.5  # in a period of eq. (3): above Nyquist's two
UNITS = {"I": "kg/m4", "C": "m3/Pa"}
INERTANCES = {
    "boom_stick.stick_hose_inertance": "boom_stick.stick_hose",
    "boom_stick.boom_hose_inertance": "boom_stick.boom_hose",
    "swing.line_inertance": "swing.line",
}
CAPACITANCES = {
    "boom_stick.stick_hose_capacitance": "boom_stick.stick_hose",
    "boom_stick.boom_hose_capacitance": "boom_stick.boom_hose",
}


def identify(recordings: Sequence[Recording], known: Mapping[str, Number]) -> Finding:
    """Inertance and capacitance of the stick's, the boom's and the swing's lines from the tested hose."""
    groups = training(recordings, "hose_dynamics", SIGNALS)
    length, bore = hose_size(groups)
    for group in groups:
        _check_flows(group)
    resistance = _resistance(known, length, bore)
    inertance, capacitance = _fits(groups, known, length, bore, resistance)
    defined = [by_definition(group, resistance) for group in groups]
    return Finding(
        procedure="hose_dynamics",
        title=f"Hose inertance and capacitance: {length:g} m, bore {bore * 1e3:.4g} mm",
        figure=7,
        estimates=(*_machines(inertance, groups, known), *_machines(capacitance, groups, known)),
        panels=panels(inertance, capacitance, defined),
        remarks=_remarks(inertance, capacitance),
        others=tuple(_others(inertance, capacitance, defined)),
    )


def _resistance(known: Mapping[str, Number], length: float, bore: float) -> float:
    """C_R of the tested hose from that of the stick's, eq. (10)."""
    own = (value(known, "boom_stick.stick_hose_length"), value(known, "boom_stick.stick_hose_bore"))
    return scaled(value(known, "boom_stick.stick_hose_resistance"), *own, length, bore)


def _fits(
    groups: Sequence[Recording], known: Mapping[str, Number], length: float, bore: float, resistance: float
) -> tuple[Fits, Fits]:
    density, modulus = value(known, "boom_stick.density"), value(known, "boom_stick.bulk_modulus")
    limit = float(hose.frequency_limit(length, density, modulus))
    for group in groups:
        _check_rate(group, limit)
    half_width = PERIODS / limit
    cuts = [equations.cut(group, half_width) for group in groups]
    transition = value(known, "boom_stick.valve_transition_flow")
    flow = max(float(np.nanstd(group["flow_in"])) for group in groups)
    files = [str(group.source) for group in groups]
    start = inertance_start(float(hose.inertance(length, bore, density)), resistance, flow)
    both = zip(groups, cuts, strict=True)
    inertance = fits("I", [equations.inertance(g, w, transition) for g, w in both], start, files)
    start = capacitance_start(float(hose.capacitance(length, bore, modulus)), flow)
    both = zip(groups, cuts, strict=True)
    return inertance, fits("C", [equations.capacitance(g, w) for g, w in both], start, files)


def _check_flows(group: Recording) -> None:
    """Refuse flows that stand, and meters at the two ends that count against each other."""
    ends = [group[name] for name in ("flow_in", "flow_out")]
    there = np.isfinite(ends[0]) & np.isfinite(ends[1])
    inlet, outlet = (flow[there] for flow in ends)
    if inlet.size and not np.ptp(inlet) > 0:
        raise ModelError(
            f"{group.source}: flow_in does not change, expected fast changes of flow and pressure"
        )
    if inlet @ outlet < 0:
        raise ModelError(
            f"{group.source}: flow_in and flow_out have opposite signs, expected both positive from inlet to "
            "outlet"
        )


def _check_rate(group: Recording, limit: float) -> None:
    rate = uniform_rate(group)
    if rate < SAMPLES * limit:
        raise ModelError(
            f"{group.source}: {rate:.0f} samples per second, expected {SAMPLES * limit:.0f} or more: the "
            f"hose itself swings at up to {limit:.0f} Hz, which would be folded into what is slow"
        )


def _machines(of: Fits, groups: Sequence[Recording], known: Mapping[str, Number]) -> list[Estimate]:
    """The machine's lines by I ~ rho l/A, C ~ A l: the same kind of hose. None if the data do not tell it."""
    if not of.told:
        return []
    lines, denser_by = (INERTANCES, denser(groups, known)) if of.name == "I" else (CAPACITANCES, 1.0)
    return [_machine(of, name, at, known, hose_size(groups), denser_by) for name, at in lines.items()]


def _machine(
    of: Fits, name: str, line: str, known: Mapping[str, Number], size: tuple[float, float], denser_by: float
) -> Estimate:
    longer = value(known, f"{line}_length") / size[0]
    wider = float(hose.area(value(known, f"{line}_bore")) / hose.area(size[1]))
    factor = denser_by * (longer / wider if of.name == "I" else longer * wider)
    note = "regression over windows, section 4(c)"
    if abs(factor - 1) > 1e-9:
        note += f", times {factor:.4g} for {longer * size[0]:g} m instead of {size[0]:g} m"
        note += "" if abs(wider - 1) < 1e-9 else f" and {wider:.4g} times the area"
        note += "" if abs(denser_by - 1) < 1e-9 else f" and {denser_by:.4g} times the density"
    return of.pooled.estimate(name, UNITS[of.name], note, of.name, factor)


def _others(inertance: Fits, capacitance: Fits, defined: Sequence[ByDefinition]) -> list[Estimate]:
    note = "regression, the tested hose"
    return [
        inertance.pooled.estimate("I", UNITS["I"], note),
        mean_of_means("I by definition", UNITS["I"], [one.inertance for one in defined]),
        capacitance.pooled.estimate("C", UNITS["C"], note),
        mean_of_means("C by definition", UNITS["C"], [one.capacitance for one in defined]),
        inertance.pooled.estimate(
            "share of the outlet's flow", "1", "s of the flow; 0 lumped, 1/2 spread", "s"
        ),
        capacitance.pooled.estimate(
            "share of the inlet's pressure", "1", "s of the pressure; 0 lumped, 1/2 spread", "s"
        ),
    ]


def _remarks(inertance: Fits, capacitance: Fits) -> tuple[str, ...]:
    count = sum(e.y.size for e in inertance.equations)
    found = [
        f"The regression uses {count} windows of {len(inertance.groups)} groups, none with a sample in the "
        "dead zone of a meter. It accounts for the noise of every signal, also of those beside I and C.",
        "The values by definition are the paper's way: their scatter is that of the groups' means, and the "
        "noise of the derivatives and the place where the flow is measured are in them.",
    ]
    for of, what in ((inertance, "inertance"), (capacitance, "capacitance")):
        if not of.told:
            found.append(
                f"These recordings do not tell the {what}: {of.pooled[of.name]:.2g} +- "
                f"{of.pooled.sd(of.name):.1g} {UNITS[of.name]}. It stays as it is known; faster changes "
                "would tell more."
            )
        elif of.differ < UNLIKELY:
            each = ", ".join(f"{one[of.name]:.4g}" for one in of.groups)
            found.append(
                f"The {what} differs between the groups ({each} {UNITS[of.name]}), more than noise explains: "
                "one number cannot describe this hose. The interval is widened to their scatter."
            )
    share = inertance.pooled
    if inertance.told and share.seen("s"):
        found.append(
            f"The inertia goes with a flow {share['s']:.2f} of the way from the inlet's to the outlet's "
            "(1/2: it is spread evenly along the hose). The lumped hose takes that of the inlet."
        )
    return (
        *found,
        *misfit_remark(inertance.pooled, "The equation of the inertance"),
        *misfit_remark(capacitance.pooled, "The equation of the capacitance"),
    )
