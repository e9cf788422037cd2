"""The paper's estimators of section 4(b) to (e): lines by least squares, and means of means.

    B = (x^T x)^-1 x^T y                   (13), y over x; also C_R of (1), R_in of (11) and R_ex of (12)
    I = (P_in - P_out - drop)/(dQ_in/dt)   C = (Q_in - Q_out)/(dP_out/dt)         definitions, section 4(c)

The paper prints no intervals. Two follow from its samples, if they are independent:

    sd(B)^2 = sum (y - B x)^2/((n - 1) sum x^2)       sd(I)^2 = sum_g s_g^2/n_g / k^2         by samples
    sd^2 = scatter of the values of k recordings / k, Student's t with k - 1 degrees of freedom    by groups

s_g is the scatter of the n_g samples of recording g. Signs: flows are positive into the hose and into port A.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache

import casadi as ca
import numpy as np

from fmus.components import hose
from fmus.components.chamber import Liquid
from fmus.identification.procedures import momentum_balance as momentum
from fmus.identification.procedures.hoses import HOSE_DYNAMICS, HOSE_RESISTANCE
from fmus.identification.procedures.motor_leakage import MOTOR_LEAKAGE
from fmus.identification.recordings.clock import SavitzkyGolay, uniform_rate
from fmus.identification.recordings.masks import good_all
from fmus.identification.results import Estimate
from fmus.parameters import Number
from orchestrator.data.recording import Recording
from orchestrator.data.table import Array

Known = Mapping[str, Number]
WINDOW = 0.055  # s, filter of the definitions: a third of the shortest change
CLEAR = 0.3  # derivatives above this fraction of the recording's largest one are used in the definitions
LENGTHS = (momentum.ORDER + 1, 9, 21)  # samples in the derivative filters of (13)
SQUARES = ("Q|Q| [m6/s2]", "drop along the hose [Pa]")
INNER, OUTER = ("internal leakage [m3/s]", "P_1 - P_2 [Pa]"), ("drain flow [m3/s]", "P_1 + P_2 [Pa]")


@dataclass(frozen=True)
class Printed:
    """A parameter as the paper estimates it.

    figure       in the paper
    by_samples   value with the interval of independent samples
    by_groups    value with the interval of the scatter of recordings; infinite with one recording
    groups       value and standard deviation by samples of each recording, shape (k, 2)
    labels       of x and y, or of group and value
    x, y         samples of the line y = B x, shape (n,); empty for means of means
    """

    figure: int
    by_samples: Estimate
    by_groups: Estimate
    groups: Array
    labels: tuple[str, str]
    x: Array = field(default_factory=lambda: np.empty(0))
    y: Array = field(default_factory=lambda: np.empty(0))


def line(
    name: str, figure: int, sets: Sequence[tuple[Array, Array]], unit: str, labels: tuple[str, str]
) -> Printed:
    """(13) over the samples x, y of all recordings."""
    x, y = np.concatenate(sets, axis=1)
    (value, sd), groups = slope(x, y), np.array([slope(*one) for one in sets])
    by_samples = Estimate.normal(name, value, unit, sd, "least squares over all samples", x.size - 1)
    by_groups = Estimate.normal(name, value, unit, *scatter(groups))
    return Printed(figure, by_samples, by_groups, groups, labels, x, y)


def slope(x: Array, y: Array) -> tuple[float, float]:
    """B of (13) and its standard deviation by samples."""
    value = float(x @ y / (x @ x))
    return value, float(np.linalg.norm(y - value * x) / math.sqrt((x.size - 1) * (x @ x)))


def mean_of_means(name: str, samples: Sequence[Array], unit: str) -> Printed:
    """The mean over recordings of the means over their samples, section 4(c), Fig. 7."""
    groups = np.array([(one.mean(), one.std(ddof=1) / math.sqrt(one.size)) for one in samples])
    value, sd = float(groups[:, 0].mean()), float(np.linalg.norm(groups[:, 1]) / len(groups))
    by_samples = Estimate.normal(name, value, unit, sd, "mean of the means of the recordings")
    by_groups = Estimate.normal(name, value, unit, *scatter(groups))
    return Printed(
        7, by_samples, by_groups, groups, ("group", f"{name.rpartition('_')[2]}, over the true one")
    )


def scatter(groups: Array) -> tuple[float, str, float]:
    """Standard deviation by the scatter of the recordings, a note, degrees of freedom."""
    k = len(groups)
    sd = float(groups[:, 0].std(ddof=1) / math.sqrt(k)) if k > 1 else math.inf
    return sd, f"scatter of {k} recordings", max(k - 1, 1)


def printed(recordings: Sequence[Recording], known: Known) -> Iterator[Printed]:
    """All parameters of Figs. 6 to 9 that have recordings; other parameters are known."""
    by_procedure = {r.procedure: [o for o in recordings if o.procedure == r.procedure] for r in recordings}
    if hoses := by_procedure.get("hose_resistance"):
        yield line("boom_stick.stick_hose_resistance", 6, [*map(squares, hoses)], "Pa.s2/m6", SQUARES)
    if hoses := by_procedure.get("hose_dynamics"):
        inertances, capacitances = zip(*(definitions(r, known) for r in hoses), strict=True)
        yield mean_of_means("boom_stick.stick_hose_inertance", inertances, "kg/m4")
        yield mean_of_means("boom_stick.stick_hose_capacitance", capacitances, "m3/Pa")
    if motors := by_procedure.get("motor_leakage"):
        yield from leakages([used(r, MOTOR_LEAKAGE.signals) for r in motors])
    joints = by_procedure.get("damping", [])
    for joint in momentum.JOINTS:
        if sets := [r for r in joints if r.conditions["joint"] == joint]:
            yield damping(joint, sets, known)


def used(recording: Recording, names: Mapping[str, str]) -> Array:
    """The samples at which no signal has a fault, a row for each signal."""
    usable = good_all(recording, names)
    return np.array([recording[n][usable] for n in names])


def squares(recording: Recording) -> tuple[Array, Array]:
    """Q|Q| and the drop of (1), Fig. 6; the flow is above the dead zone of the meter."""
    before, after, flow = used(recording, HOSE_RESISTANCE.signals)
    return flow * np.abs(flow), before - after


def definitions(recording: Recording, known: Known) -> tuple[Array, Array]:
    """Samples of I and of C, Fig. 7; `drop` is the friction of the flow at the inlet with the known C_R.

    One filter gives the derivatives and smooths the other signals. Ratios with a small derivative are left
    out. The noise of a derivative biases its ratio towards zero.
    """
    rate, usable = uniform_rate(recording), good_all(recording, HOSE_DYNAMICS.signals)
    smoothing = SavitzkyGolay(rate, max(WINDOW, 4.5 / rate))
    signal, derivative = (
        {n: smoothing.apply(np.where(usable, recording[n], np.nan), k) for n in HOSE_DYNAMICS.signals}
        for k in (0, 1)
    )
    length, bore = (recording.numeric_condition(n) for n in ("length", "diameter"))
    own, density, viscosity, its_length, its_bore = (
        known[f"boom_stick.{n}"].value
        for n in ("stick_hose_resistance", "density", "viscosity", "stick_hose_length", "stick_hose_bore")
    )
    resistance = hose.scaled_resistance(own, length / its_length, bore / its_bore)
    size, oil = hose.HoseSize(length=length, bore=bore), Liquid(density=density, viscosity=viscosity)
    friction = ca.DM(hose.Friction.of(size, resistance, oil).drop(ca.DM(signal["flow_in"]))).full()[:, 0]

    def ratio(numerator: Array, denominator: Array) -> Array:
        clear = np.abs(denominator) > CLEAR * np.nanmax(np.abs(denominator))
        return np.asarray(numerator[clear] / denominator[clear])

    return (
        ratio(signal["pressure_in"] - signal["pressure_out"] - friction, derivative["flow_in"]),
        ratio(signal["flow_in"] - signal["flow_out"], derivative["pressure_out"]),
    )


def leakages(sets: Sequence[Array]) -> Iterator[Printed]:
    """R_ex of P_1 + P_2 = R_ex Q_drain, (12), and R_in of P_1 - P_2 = R_in Q_in, (11), Fig. 8."""
    outer = [(drain, a + b) for a, b, _, drain in sets]
    external = line("swing.external_leakage_resistance", 8, outer, "Pa.s/m3", OUTER)
    inner = [(flow - a / external.by_samples.value, a - b) for a, b, flow, _ in sets]
    yield line("swing.internal_leakage_resistance", 8, inner, "Pa.s/m3", INNER)
    yield external


# ---- damping -------------------------------------------------------------------------------------------


@lru_cache(maxsize=1)
def equation_of_motion() -> ca.Function:
    """(q, q', q'', pressures, tank, p) -> f - dh/dt of (4), df_i/dq_i', x_i'/q_i', each (3, n)."""
    e, a = momentum.HARVESTER.equations, ca.SX.sym("a", 3)
    damping, ratio = ca.diag(ca.jacobian(e.force, e.w)), ca.vertcat(1, e.moment_arm)
    rate = ca.jtimes(e.momentum, e.q, e.w) + ca.jtimes(e.momentum, e.w, a)
    arguments = [e.q, e.w, a, e.pressures, e.tank, e.p]
    return ca.Function("equation_of_motion", arguments, [e.force - rate, damping, ratio])


def named(joint: str) -> str:
    """The parameter of Fig. 9."""
    return f"manipulator.{joint}_{'' if joint == 'swing' else 'piston_'}damping"


def damping(joint: str, recordings: Sequence[Recording], known: Known) -> Printed:
    """B of (13) with the shortest filter, Fig. 9."""
    speed, force = ("rad/s", "N.m") if joint == "swing" else ("m/s", "N")
    sets = [motion(r, joint, known, LENGTHS[0])[:2] for r in recordings]
    name = named(joint)
    return line(name, 9, sets, known[name].unit, (f"x' of the {joint} [{speed}]", f"a [{force}]"))


def motion(recording: Recording, joint: str, known: Known, length: int) -> tuple[Array, Array, Array]:
    """x' and a of (13), and what the noise of the speed adds to the sums of x' a and of x'^2.

    One Savitzky-Golay filter of some samples gives angles, their first and second derivatives, and pressures.
    x' is q' of the swing and J q' of a piston.
    """
    row, rate, p = momentum.JOINTS.index(joint), uniform_rate(recording), momentum.HARVESTER.vector(known)
    p[momentum.PARAMETERS.index(named(joint))] = 0.0
    kernel = SavitzkyGolay(rate, (length - 1) / rate, momentum.ORDER)
    raw, _, z, good = momentum.filtered(recording, joint, kernel)
    q, w, pressures = np.split(z[:, good], [3, 6])
    acceleration = np.array([np.correlate(angle, kernel.weights[2], "valid") for angle in raw[:3]])[:, good]
    tank = float(np.mean(recording["swing.tank_pressure"]))
    a, by_speed, ratio = (x.full()[row] for x in equation_of_motion()(q, w, acceleration, pressures, tank, p))
    variance = (kernel.gain(1) * recording.sensor(momentum.ANGLES[row]).sd) ** 2
    return ratio * w[row], a / ratio, variance * np.array([by_speed.sum(), np.sum(ratio**2)])


def over_filters(joint: str, recordings: Sequence[Recording], known: Known) -> Array:
    """A row for each of the filters: its length [s], B of (13), and B corrected for the noise of the speed.

        B = (sum x' a - sd(v)^2 sum df/dq') / (sum x'^2 - sd(v)^2 sum J^2)

    Fuller 1987, Measurement Error Models, section 1.2: the noise v of q' is in x' = J q' and by df/dq' in a.
    That of q'' is not correlated with v, because one kernel is even and the other is odd.
    """
    rows = []
    for length in LENGTHS:
        sets = [motion(r, joint, known, length) for r in recordings]
        sums = np.sum([(x @ a, x @ x) for x, a, _ in sets], axis=0)
        clean = sums - np.sum([noise for _, _, noise in sets], axis=0)
        seconds = length / uniform_rate(recordings[0])
        rows.append((seconds, sums[0] / sums[1], clean[0] / clean[1]))
    return np.array(rows)
