"""Weighing procedure: the payload of the head from pressures of the boom's cylinder and joint angles.

The boom moves slowly up and down, swing and stick at rest. Its momentum balance (`momentum_balance`) is
linear in the mass at the tip, empty head and payload together:

    phi * (J F - G) - phi' * h = - (m - m_0) dE/dm + phi * (J (B x' + F_c sign x'))

F is that of the pressures. G, h and J are those of the manipulator with the mass m_0 of the empty head. The
same friction, viscous B and dry F_c, counts in all recordings: it acts against the motion up and the motion
down, and thereby averages out. Where the boom is slower than `SLOW` of its rms speed, stiction holds forces
that nothing tells, so these samples are left out. The mass m of each recording, B and F_c follow by least
squares. The intervals are those of the residuals, which are correlated (Newey and West 1987), and not below
those of the sensors' noise.

payload = m - m_tare    with a recording of the empty head, whose condition `payload` is 0: errors of the
                        arm's masses and geometry, and of the sensors' zeros, then cancel nearly
payload = m - m_0       without one: the sensors' zeros are a further error in the interval, the other
                        parameters are taken as exact

Validity: slow motion that goes up and down about equally; a payload that does not change; friction
independent of load. The payload is a point mass at or below the tip, at the tip's distance from the boom.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fmus.identification.estimate import Estimate
from fmus.identification.procedure_result import Curve, Panel, ProcedureResult
from fmus.identification.procedures.experiment_data import training_recordings, zero_limit
from fmus.identification.procedures.momentum_balance import (
    ANGLES,
    JOINTS,
    PARAMETERS,
    PRESSURES,
    MomentumEquation,
    SmoothedRecording,
    all_good,
    equation_of_motion,
    momentum_equation,
    parameter_vector,
    smoothed_recording,
)
from fmus.identification.procedures.momentum_fit import WeightedBalance, normal_step
from fmus.identification.procedures.regression import misfit_warning
from fmus.parameters import Number
from orchestrator.base.errors import Problem
from orchestrator.data.recording import Recording
from orchestrator.data.table import Array

JOINT = "boom"
SIGNALS: Mapping[str, str] = dict.fromkeys(ANGLES, "rad") | dict.fromkeys(PRESSURES[JOINT], "Pa")
HEAD, DAMPING = "manipulator.head_mass", f"manipulator.{JOINT}_piston_damping"
CONDITION = "payload"
ROW = JOINTS.index(JOINT)
WINDOW = 0.6  # s: longer than by default, because the motion is slow
SIGN_ROUNDING = 0.05  # rms speeds over which the sign of the dry friction is rounded
SLOW = 0.2  # rms speeds below which a sample is left out
BOTH_WAYS = 0.2  # smallest share of the way up, and of the way down, in all of the way
POINT_STEP = 5  # samples per drawn point


@dataclass(frozen=True)
class Weighing:
    """One recording: its balance at the mass of the empty head and without friction, and its regressors.

    record     its smoothed signals
    equation   e [N.m] and de/d(m, B, F_c); zero for samples that are not used
    zero       change of the mass by the errors of zeros that the pressure sensors may have [kg]
    """

    recording: Recording
    record: SmoothedRecording
    equation: MomentumEquation
    zero: float

    @property
    def stated(self) -> float | None:
        """The payload [kg] that the recording states."""
        known = self.recording.conditions
        return self.recording.numeric_condition(CONDITION) if CONDITION in known else None

    @property
    def name(self) -> str:
        """Name of its estimate."""
        return f"payload[{self.recording.source.stem}]"

    def among(self, k: int, count: int) -> MomentumEquation:
        """The equation with the unknowns of all recordings: their masses, B, F_c; this is number k."""
        jacobian = np.zeros((count + 2, *self.equation.residual.shape))
        jacobian[[k, count, count + 1]] = self.equation.jacobian
        return MomentumEquation(self.equation.residual, jacobian)


@dataclass(frozen=True)
class Weighed:
    """Masses less that of the empty head in the file [kg], and friction.

    Covariances by the noise of the sensors and by the residuals.
    """

    weighings: tuple[Weighing, ...]
    values: Array
    noise_covariance: Array
    residual_covariance: Array

    @property
    def tares(self) -> list[int]:
        """The recordings of the empty head."""
        return [k for k, w in enumerate(self.weighings) if w.stated == 0.0]

    def payload(self, k: int) -> tuple[float, float]:
        """Payload [kg] of a recording and its standard deviation."""
        contrast = np.zeros(self.values.size)
        contrast[k] = 1.0
        for tare in self.tares:
            contrast[tare] -= 1.0 / len(self.tares)
        variance = max(contrast @ c @ contrast for c in (self.noise_covariance, self.residual_covariance))
        zero = 0.0 if self.tares else self.weighings[k].zero / 2
        return float(contrast @ self.values), math.hypot(math.sqrt(variance), zero)

    @property
    def times_noise(self) -> float:
        """Largest ratio of the standard deviation of a mass by the residuals to that by the noise."""
        count = len(self.weighings)
        by_residuals, by_noise = (
            np.diag(c)[:count] for c in (self.residual_covariance, self.noise_covariance)
        )
        ratio = np.divide(by_residuals, by_noise, out=np.zeros(count), where=by_noise > 0)
        return math.sqrt(float(ratio.max()))

    def residual(self, k: int) -> Array:
        """e of a recording with the estimates [N.m], shape (n,)."""
        equation = self.weighings[k].among(k, len(self.weighings)).shifted(self.values)
        return np.array(equation.residual[0])


def identify(recordings: Sequence[Recording], parameters: Mapping[str, Number]) -> ProcedureResult:
    """The payload of each recording that is not one of the empty head."""
    p = parameter_vector(parameters)
    weighed = weigh([weighing(r, p) for r in training_recordings(recordings, "weighing", SIGNALS)], p)
    loaded = [k for k, w in enumerate(weighed.weighings) if k not in weighed.tares]
    how = "moments of the boom's cylinder, " + (
        f"less the tare of {len(weighed.tares)} recording{'s' * (len(weighed.tares) > 1)}"
        if weighed.tares
        else "less the known mass of the head"
    )
    friction = zip(
        ("viscous friction, further unknown", "dry friction, further unknown"),
        ("N.s/m", "N"),
        weighed.values[-2:],
        np.sqrt(np.diag(weighed.residual_covariance))[-2:],
        strict=True,
    )
    return ProcedureResult(
        procedure="weighing",
        title="Payload from the pressures of the boom's cylinder",
        figure=0,
        estimates=(),
        panels=panels(weighed),
        remarks=tuple(_remarks(weighed, loaded)),
        warnings=misfit_warning(weighed.times_noise, "the balance of the boom"),
        others=(
            *(
                Estimate.normal(weighed.weighings[k].name, value, "kg", sd, how)
                for k, (value, sd) in ((k, weighed.payload(k)) for k in loaded)
            ),
            *(Estimate.normal(name, float(v), unit, float(sd), how) for name, unit, v, sd in friction),
        ),
    )


def weighing(recording: Recording, p: Array) -> Weighing:
    """The regressors of one recording; Problem if the boom does not move up and down."""
    s = smoothed_recording(recording, [JOINT], p, window=WINDOW)
    _check_motion(recording, s)
    ratio = np.array(equation_of_motion(()).pistons(s.q, p)[1].full())[0]
    speed = ratio * s.w[ROW]
    rms = float(np.sqrt(np.mean(speed**2)))
    s = replace(s, good=s.good & all_good(np.abs(speed) > SLOW * rms, s.filters.bump.size))
    _check_motion(recording, s)
    without = p.copy()
    without[PARAMETERS.index(DAMPING)] = 0.0
    equation = momentum_equation(s, [ROW], (HEAD, DAMPING), without)
    dry = -s.filtered((ratio * np.tanh(speed / (SIGN_ROUNDING * rms)))[None, :], np.zeros((1, s.q.shape[1])))
    moments = (a * zero_limit(recording, n) for a, n in zip(_areas(p), PRESSURES[JOINT], strict=True))
    by_mass = float(np.mean(np.abs(equation.jacobian[0, 0][s.good])))
    return Weighing(
        recording=recording,
        record=s,
        equation=MomentumEquation(equation.residual, np.concatenate([equation.jacobian, dry[None]])),
        zero=float(np.mean(np.abs(ratio))) * sum(moments) / by_mass,
    )


def _areas(p: Array) -> tuple[float, float]:
    """Areas of the head and the rod side [m2]."""
    bore, rod = (p[PARAMETERS.index(f"boom_stick.{JOINT}_{n}")] for n in ("bore", "rod"))
    return math.pi / 4 * bore**2, math.pi / 4 * (bore**2 - rod**2)


def _check_motion(recording: Recording, s: SmoothedRecording) -> None:
    speed = s.w[ROW][s.centres] * s.good
    up, down = float(np.sum(np.maximum(speed, 0.0))), float(np.sum(np.maximum(-speed, 0.0)))
    if min(up, down) < BOTH_WAYS * (up + down) or not up + down:
        raise Problem(
            f"{recording.source}: manipulator.{JOINT}_angle: expected a slow motion up and down, in which "
            f"friction averages out, got {100 * up / (up + down or 1.0):.0f} % of the way up"
        )


def weigh(weighings: Sequence[Weighing], p: Array) -> Weighed:
    """Least squares over all recordings: a mass for each, and one friction."""
    records, count, weights = [w.record for w in weighings], len(weighings), np.ones(1)
    names = (*(w.name for w in weighings), "B", "F_c")
    equations = [w.among(k, count) for k, w in enumerate(weighings)]
    normal, step = normal_step(equations, weights, names)
    fit = WeightedBalance(names, [ROW], weights, np.array(np.linalg.inv(normal), float), p)
    shifted = [e.shifted(step) for e in equations]
    return Weighed(
        weighings=tuple(weighings),
        values=step,
        noise_covariance=fit.noise(records, shifted)[0],
        residual_covariance=fit.residual_covariance(records, shifted),
    )


def _remarks(weighed: Weighed, loaded: Sequence[int]) -> Iterator[str]:
    if not loaded:
        yield f"All recordings are of the empty head ({CONDITION} = 0): there is no payload to weigh."
    for k in loaded:
        w, value = weighed.weighings[k], weighed.payload(k)[0]
        if w.stated is not None:
            off = 100 * (value / w.stated - 1)
            yield f"{w.name}: the recording states {w.stated:.6g} kg; the estimate differs by {off:+.2g} %."
        if not weighed.tares:
            yield (
                f"{w.name}: there is no recording of the empty head, so errors of the arm's masses "
                f"and of the pressure zeros are not compensated: {w.zero:.2g} kg from the zeros alone."
            )
    for k in weighed.tares:
        w = weighed.weighings[k]
        yield (
            f"{w.recording.source.name}: the empty head weighs {weighed.values[k]:+.3g} kg more "
            "than the known value."
        )


def panels(weighed: Weighed) -> tuple[Panel, ...]:
    """Moment of the mass above the empty head over time, and the residual, of each recording."""
    result: list[Panel] = []
    for k, w in enumerate(weighed.weighings):
        s = w.record
        t, by_mass, residual = (
            x[s.good][::POINT_STEP]
            for x in (s.time[s.centres], w.equation.jacobian[0, 0], weighed.residual(k))
        )
        fit = -by_mass * weighed.values[k]
        top = Panel(
            x_label="time",
            y_label="moment of the mass",
            curves=(
                Curve("measured, filtered, without friction", t, fit + residual),
                Curve("by the mass", t, fit, "fit"),
            ),
            title=w.recording.source.stem,
            x_unit=("s", 1.0),
            y_unit=("kN.m", 1e3),
        )
        curves = (Curve("measured - fit", t, residual),)
        result += [top, replace(top, y_label="residual", curves=curves, title="", y_unit=("N.m", 1.0))]
    return tuple(result)
